"""Tables of figures that no row of rows.py reproduces, and why; tests/test_figures.py holds this list to the pages."""

TIMES = "times and machines alone: make bench"
LARGE = "gigabytes and hours of rooms at real size: the page has the commands"

UNCHECKED = (  # page, beginning of the table's header, why
    ("README.md", "| | 16 entries a pixel", TIMES),
    ("docs/drift.md", "| what it says", "limits, not measured"),
    ("docs/gpu.md", "| | 16 entries, ms", TIMES),
    ("docs/gpu.md", "| | OpenGL, processor time", TIMES),
    ("docs/reliability.md", "| campaign | tried | refused", "hours: make fuzz, with the seeds of the page"),
    ("docs/size.md", "| | at most", "limits, not measured"),
    ("docs/size.md", "| acquired `corner`", LARGE),
)
