"""Sentences of simulated rooms on cutting, colour, adaptation, views, and the simulator itself."""

from tests.figures.cells import Cells
from tests.figures.claims import Table, counted, ends, said, tabled, told

DECOMPOSED = tabled("docs/decomposition.md", "room | allowed")
RADII = tabled("docs/tables/radii.md", "entries from")
COLOUR = tabled("docs/colour.md", "room | fault | colour")
ADAPTED = tabled("docs/content.md", "white | adapt")
FLICKER = tabled("docs/content.md", "flicker | noise")
CAMERAS = tabled("docs/cameras.md", "projectors, cameras | camera pixels")
VIEWS = tabled("docs/viewpoints.md", "views | nearest view")
WORTH = tabled("docs/simulation.md", "scene | camera")
BLURRED = tabled("docs/tables/blurring.md", "limit | near | blurred")
PICTURES = "photograph", "letters", "ramp"
ASKED, BEFORE = "PSNR to what was asked, dB (worst)", "PSNR to the picture before adaptation, dB"
ALL_RANKS, HUNDREDTH, THIRTIETH = "σ above 1e-06 σ₁", "σ above 0.01 σ₁", "σ above 0.03 σ₁"
SHARES = HUNDREDTH, THIRTIETH
WAY = (
    "x {} to {}, y {} to {} and {} more: {} % of the view cannot be compensated because {} % of its light bounced "
    "off other surfaces (red / green / blue {} / {} / {} %)"
)
GREY = "grey off: first camera's part, both's, second's"


def cut(t: Table, rooms: str, allowed: int) -> list[float]:
    """Returns the loss from clusters of at most `allowed` pixels."""
    pairs = (zip(t(f"({rooms}) .*any", p), t(rf"({rooms}) .*\| {allowed}$", p), strict=True) for p in PICTURES)
    return [before - after for pair in pairs for before, after in pair]


def off(t: Table, adapt: str, column: str) -> list[float]:
    """Returns the gain of a picture by adaptation, per white."""
    return [
        t.one(rf": {white} \| ({adapt})$", column) - t.one(rf": {white} \| off", column) for white in (0.416, 0.624)
    ]


def by_pixel(t: Table, room: str) -> float:
    """Returns the gain of a mixing per camera pixel over a mixing per room, under a colour wheel."""
    one, each = (t.one(rf"{room} \| wheel \| {tier}", "inside (optimum), dB") for tier in ("global", "pixel"))
    return each - one


def judged_away(text: str) -> Cells:
    """Read windows of film from the study's last table, which has no header."""
    _, _, last = text.partition("judged by another T:")
    rows = [[cell.strip() for cell in line.strip("| ").split("|")] for line in last.splitlines() if line[:1] == "|"]
    return {f"{row[0]}: window {k}, film": cell for row in rows for k, cell in enumerate(row[-3:])}


def more(t: Table) -> tuple[float, float]:
    """Returns the cost of blocks for windows of film, compared with T itself."""
    return ends([blocks - own for own, blocks in zip(t("^T:", "film"), t("^0.0014:", "film"), strict=True)])


PROSE = (
    said(
        "docs/decomposition.md",
        DECOMPOSED,
        (
            "clusters of up to 1000 pixels makes pictures {} to {} dB worse. In focus, a cut to clusters of up to 50 "
            "pixels makes pictures {} to {} dB worse.",
            lambda t: (*ends(cut(t, "wall|corner", 1000)), *ends(cut(t, "wall|corner", 50))),
        ),
        (
            "the cut makes the photograph and the letters {} to {} dB worse",
            lambda t: ends([t.one("focus .*any", p) - t.one("focus .*1000", p) for p in PICTURES[:2]]),
        ),
    ),
    said(
        "docs/decomposition.md",
        RADII,
        (
            "a photograph is {} dB below the best. If the inverse drops singular values below a hundredth of the "
            "largest, pictures are {} to {} dB below the best.",
            lambda t: (
                t.one(r"0 \| uncut", ALL_RANKS),
                *ends([t.one(r": 0 \| uncut", HUNDREDTH, at) for at in range(3)]),
            ),
        ),
        (
            "a photograph is {} dB below the best at every tested threshold of singular values.",
            lambda t: ends(t(r": 0.001 \| all, 1$", ALL_RANKS))[:1],
        ),
        (
            "the cut keeps {} to {} % of all light",
            lambda t: ends(t(r"\| all, 0.1$", "light kept")),
        ),
        (
            "leaves larger clusters, of up to {} pixels in `folded_cards`",
            lambda t: (max(t(r"\| all, 0.1$", "largest")),),
        ),
        (
            "If the inverse drops small singular values, a photograph is {} to {} dB below the best. If the inverse "
            "uses all singular values, a photograph is {} to {} dB below the best.",
            lambda t: (
                *ends([n for share in SHARES for n in t(r"\| all, 0.1$", share)]),
                *ends(t(r"\| all, 0.1$", ALL_RANKS)),
            ),
        ),
    ),
    said(
        "docs/colour.md",
        COLOUR,
        (
            "`pixel` gains {} dB on the wall and {} dB in the corner",
            lambda t: [by_pixel(t, room) for room in ("wall", "corner")],
        ),
    ),
    said(
        "docs/content.md",
        ADAPTED,
        (
            "`adapt` raises the PSNR relative to the adapted target by up to {} dB",
            lambda t: (max(off(t, "1 %", ASKED)),),
        ),
        (
            "lowers the PSNR relative to the original picture by {} to {} dB",
            lambda t: ends([-n for adapt in ("1 %", "3 %") for n in off(t, adapt, BEFORE)]),
        ),
    ),
    said(
        "docs/content.md",
        FLICKER,
        (
            "0.3` removes two fifths of the noise and makes moving film {} dB worse",
            lambda t: (t.one("off", "film: likewise (worst)") - t.one("0.3", "film: likewise (worst)"),),
        ),
    ),
    said(
        "docs/cameras.md",
        CAMERAS,
        ("{} code values off is nearly black", lambda t: (-t.one(": 1, 1$", GREY, 2),)),
    ),
    told(
        "docs/viewpoints.md",
        VIEWS.commands,
        VIEWS.minutes,
        *(
            (
                f"**{what}.** Viewpoints lie within ...viewpoints reach {{}} to {{}} dB",
                f"{what[2:]}, from ...best: {{}} to {{}} dB",
            )
            for what in ("A glossy brick wall", "A bust before a wall", "A wine glass before wallpaper")
        ),
        (
            "have a median error of {} pixels (95th percentile: {}). With the bust, the screen positions have a "
            "median error of {} pixels (95th percentile: {})",
            "placed {} pixels from where they look (median; 95 %: {})...placed {} pixels from where they look (median; "
            "95 %: {})",
        ),
    ),
    told(
        "docs/ways.md",
        (
            "counterlight simulate corner --camera 120x68 --projector 96x54 -o corner",
            "counterlight build corner --inverse none --no-refine --report report",
        ),
        1,
        (WAY, WAY),
        files=("report/report.json",),
    ),
    said(
        "docs/simulation.md",
        WORTH,
        (
            "the error is at most {} dB",
            lambda t: (max(t(".", "off by, dB")),),
        ),
    ),
    said(
        "docs/mathematics.md",
        BLURRED,
        ("projector pixels: {} in the far half of `two_planes`", lambda t: (t.one("another T", "near"),)),
    ),
    said(
        "docs/size.md",
        BLURRED,
        ("the square with the widest blur has {} entries per camera pixel", lambda t: (t.one("another T", "near"),)),
    ),
    counted(
        "docs/size.md",
        BLURRED,
        judged_away,
        ("blocks make films {} to {} dB worse", more),
    ),
)
