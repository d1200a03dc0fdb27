"""Figures that no row of rows.py reproduces, with the reason; tests/test_figures.py compares them with pages."""

TIMES = "times and machines alone: make bench"
LARGE = "gigabytes and hours of rooms at real size: the page has the commands"
ONCE = "seconds, measured once, as the page says how"
OUTSIDE = "of measurements or devices that are not in the repository"
TESTED = "bounds that a test holds, which the page names"

UNCHECKED = (  # page, beginning of a table's header, reason
    ("docs/costs.md", "| | 16 entries a pixel", TIMES),
    ("docs/drift.md", "| what it says", "limits, not measured"),
    ("docs/size.md", "| | at most", "limits, not measured"),
    ("docs/watch.md", "| change | without", "84 minutes of film: docs/tables/watching.md has the rows"),
    ("docs/player.md", "| room, frame rate, other load", TIMES),
    ("docs/unattended.md", "| event | black for at most", TIMES),
    ("docs/pairs.md", "| directly lit pixels of held-out captures", OUTSIDE),
    ("docs/pairs.md", "| pairs | held out |", OUTSIDE),
)
SENTENCES = (  # page, words of prose, reason
    ("docs/cameras.md", "positions on the screen have a median error of a twentieth", TESTED),
    ("docs/displays.md", "reduces the extra light in the overlap from 4 %", TESTED),
    ("docs/drift.md", "measures shifts of up to 11 pixels to within 0.02", TESTED),
    ("docs/drift.md", "a movement by (0.8, −0.5) pixels to within 0.1 pixels", TESTED),
    ("docs/acquisition.md", "has an error of at most 0.3 % of white", TESTED),
    ("docs/colour.md", "(on even paint) and `pixel` are within 0.05 dB", TESTED),
    ("docs/hdr.md", "Measured DLP projector", OUTSIDE),
    ("docs/in_step.md", "with three players on 2 cores", TESTED),
    ("docs/reliability.md", "an hour with 20 clients", "hours: make fuzz, with the seeds of the page"),
    ("docs/size.md", "at 1920x1080 takes 43 s", LARGE),
    ("docs/size.md", "581.7 million entries became 34.9", LARGE),
    ("docs/size.md", "14.8 s of wall time in one process", ONCE),
    ("docs/size.md", "A local cluster takes 2 s to start", ONCE),
    ("docs/ways.md", "differs from the true share by at most 8 %", TESTED),
)
