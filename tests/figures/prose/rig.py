"""Sentences of the rig on rooms, and on drift."""

from itertools import combinations

from tests.figures.claims import Table, ends, said, tabled

HEAD = "room | fault | optimum, dB | captured, dB | below, dB | inside (optimum), dB | ΔE2000 (optimum)"
RIG, ALONE = tabled("docs/rig.md", f"{HEAD} | light"), tabled("docs/tables/rig.md", f"{HEAD} | inside")
REAL = tabled("docs/tables/rig.md", f"{HEAD.removesuffix(' | ΔE2000 (optimum)')} | blurred")
ROOMS = "wall", "corner", "glass", "defocus"
SHOWN = "astronaut, dB, 0, 4, 16, 64 steps"
INSIDE, CHECKED = "inside (optimum), dB", "inside after one check, dB"


def inside(t: Table, room: str, fault: str, column: str = INSIDE) -> float:
    return t.one(rf": {room} \| {fault}$", column)


def below_inside(t: Table) -> float:
    """Returns the largest distance in dB of `home` below the optimum inside the border; 0 if it is never below."""
    return max(0.0, *(best - found for found, best in zip(t("home", INSIDE), t("home", INSIDE, 1), strict=True)))


def by_drift(t: Table) -> tuple[float, float]:
    """Returns the cost in dB of a pixel of drift, in the rooms that lose least and most."""
    return ends([inside(t, room, "known") - inside(t, room, "drift") for room in ROOMS])


def checked(t: Table, room: str) -> tuple[float, float]:
    """Returns the quality before a drift, and after the drift and one check."""
    return inside(t, room, "known"), inside(t, room, "drift", CHECKED)


def fallen(t: Table, rows: str, column: str) -> float:
    """Returns the largest loss of a picture from fewer to more steps."""
    pairs = combinations([t(rows, column, step) for step in range(4)], 2)
    return max(before - after for earlier, later in pairs for before, after in zip(earlier, later, strict=True))


def most_below(t: Table) -> float:
    """Returns the largest distance in dB below the optimum inside the border."""
    return max(best - found for found, best in zip(t(".*", INSIDE), t(".*", INSIDE, 1), strict=True))


PROSE = (
    said(
        "README.md",
        RIG,
        ("the default settings reach {} to {} dB PSNR inside the", lambda t: ends(t("home", INSIDE))),
        ("picture is at most {} dB better there", lambda t: (below_inside(t),)),
        ("and {} dB better over all lit pixels", lambda t: ends(t("home", "below, dB"))[1:]),
    ),
    said(
        "docs/rig.md",
        RIG,
        (
            "pictures in `home` are {} to {} dB below the best that any drive could show",
            lambda t: ends(t("home", "below, dB")),
        ),
        ("Inside the border, pictures in `home` are at most {} dB below", lambda t: (below_inside(t),)),
        (
            "**Light outside** the picture is at most {} % of white",
            lambda t: (max(t("home", "light outside (plain)")),),
        ),
        (
            "Between 0 and 64 steps of refinement, additional steps lower the PSNR by at most {} dB",
            lambda t: (fallen(t, r"\| (?!drift)\w+$", SHOWN),),
        ),
        (
            "after a drift and one check, a picture has a PSNR of {} to {} dB",
            lambda t: ends([after for _, after in (checked(t, room) for room in ROOMS)]),
        ),
        ("A drift of one projector pixel reduces PSNR by {} to {} dB", by_drift),
    ),
    said(
        "docs/rig.md",
        ALONE,
        (
            "inside the border is at least {} dB after one check. In `quiet`, the PSNR inside the border is {} dB",
            lambda t: [
                min(inside(t, "wall", fault, CHECKED) for fault in ("lamp", "daylight")),
                inside(t, "wall", "quiet"),
            ],
        ),
        (
            "Pictures in `believed` are {} dB worse than with the true response",
            lambda t: (inside(t, "wall", "quiet") - inside(t, "wall", "believed"),),
        ),
        (
            "fades to nine tenths lowers PSNR by {} dB. Tripled light in the room lowers PSNR by {} dB.",
            lambda t: [inside(t, "wall", "quiet") - inside(t, "wall", fault) for fault in ("lamp", "daylight")],
        ),
    ),
    said("docs/rig.md", REAL, ("a picture is at most {} dB below the optimum", lambda t: (most_below(t),))),
    said(
        "docs/drift.md",
        RIG,
        (
            "A shift of one projector pixel lowers PSNR by [{} to {} dB]",
            by_drift,
        ),
        (
            "On the wall, PSNR falls from {} to {} dB. In the corner, PSNR falls from {} to {} dB. On the wall behind "
            "glass, PSNR falls from {} to {} dB. In the room out of focus, PSNR falls from {} to {} dB.",
            lambda t: [each for room in ROOMS for each in checked(t, room)],
        ),
    ),
    said(
        "docs/first-rig.md",
        RIG,
        (
            "A drift of one projector pixel lowers PSNR by {} to {} dB",
            by_drift,
        ),
    ),
)
