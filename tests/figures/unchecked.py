"""Tables of figures that no row of rows.py reproduces, and why; tests/test_figures.py holds this list to the pages."""

EARLIER = "of versions that are gone: why something is as it is"
TIMES = "times and machines alone: make bench"
LARGE = "gigabytes and hours of rooms at real size: the page has the commands"
TRIED = "tried once, while it was made"

UNCHECKED = (  # page, beginning of the table's header, why
    ("README.md", "| | 16 entries a pixel", TIMES),
    ("docs/colour.md", "| wall | captured", EARLIER),
    ("docs/colour.md", "| | independent", TRIED),
    ("docs/displays.md", "| | first", "five commands of the page, a sed among them"),
    ("docs/drift.md", "| what it says", "limits, not measured"),
    ("docs/drift.md", "| | wall", TRIED),
    ("docs/drift.md", "| beyond the raster", TRIED),
    ("docs/gpu.md", "| | 16 entries, ms", TIMES),
    ("docs/gpu.md", "| | OpenGL, processor time", TIMES),
    ("docs/hdr.md", "| recovered from", TRIED),
    ("docs/mathematics.md", "| | as it is", TRIED),
    ("docs/player.md", "| captures | decode", TIMES),
    ("docs/refinement.md", "| start | 64 ms", "the steps that fit depend on the machine's times"),
    ("docs/refinement.md", "| start | 102 ms", "likewise"),
    ("docs/refinement.md", "| start | 266 ms", "likewise"),
    ("docs/refinement.md", "| start | 88 ms", "likewise"),
    ("docs/reliability.md", "| campaign | tried | refused", "hours: make fuzz, with the seeds of the page"),
    ("docs/rig.md", "| dB, 64 steps", EARLIER),
    ("docs/size.md", "| room | chosen", LARGE),
    ("docs/size.md", "| room, steps | 0", TRIED),
    ("docs/size.md", "| | at most", "limits, not measured"),
    ("docs/size.md", "| 1920x1080 | before", EARLIER),
    ("docs/size.md", "| acquired `corner`", LARGE),
    ("docs/size.md", "| large | memory", LARGE),
    ("docs/size.md", "| `two_planes` | processor", LARGE),
    ("docs/size.md", "| | before | now", EARLIER),
)
