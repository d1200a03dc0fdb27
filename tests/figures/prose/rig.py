"""What the rig says of rooms, and of drift."""

from itertools import combinations

from tests.figures.claims import Table, ends, said, tabled

RIG = tabled("docs/rig.md", "room | fault | optimum, dB | captured, dB | below, dB | inside (optimum), dB | blurred")
ALONE = tabled("docs/rig.md", "room | fault | optimum, dB | captured, dB | below, dB | inside (optimum), dB | ΔE")
ROOMS = "wall", "corner", "glass", "defocus"
SHOWN = "astronaut, dB, 0, 4, 16, 64 steps", "astronaut, everywhere, 0, 4, 16, 64 steps"


def captured(t: Table, room: str, fault: str, column: str = "captured, dB") -> float:
    return t.one(rf": {room} \| {fault}$", column)


def by_drift(t: Table) -> tuple[float, float]:
    """What a pixel of it costs, decibels, in the rooms that lose least and most."""
    return ends([captured(t, room, "known") - captured(t, room, "drift") for room in ROOMS])


def checked(t: Table, room: str) -> tuple[float, float]:
    """Before a drift, and after it and one check."""
    return captured(t, room, "known"), captured(t, room, "drift", "after one check, dB")


def fallen(t: Table, rows: str, column: str) -> float:
    """What steps take away from an earlier picture at most."""
    pairs = combinations([t(rows, column, step) for step in range(4)], 2)
    return max(before - after for earlier, later in pairs for before, after in zip(earlier, later, strict=True))


PROSE = (
    said(
        "README.md",
        RIG,
        (
            "defaults end {} to {} dB below the best that any drive could show",
            lambda t: ends(t("home", "below, dB")),
        ),
        ("could show, at {} to {} dB", lambda t: ends(t("home", "captured, dB"))),
    ),
    said(
        "docs/rig.md",
        RIG,
        (
            "measured is {} to {} dB below the best",
            lambda t: ends(t("home", "below, dB")),
        ),
        ("ΔE2000 is at most the optimum's {}.", lambda t: (max(t("home", "ΔE2000 (optimum)")),)),
        (
            "With steps PSNR falls by {} dB at most, by {} everywhere",
            lambda t: [fallen(t, r"\| (?!drift)\w+$", column) for column in SHOWN],
        ),
        ("where the room has drifted by {}.", lambda t: (fallen(t, "drift", SHOWN[0]),)),
        (
            "one check it is {} dB below before in the corner, {} on the wall, {} behind glass and out of focus",
            lambda t: [before - after for before, after in (checked(t, room) for room in ("corner", "wall", "glass"))],
        ),
        ("dB of `known`'s {}.", lambda t: (captured(t, "wall", "known"),)),
        ("A pixel costs {} to {} dB", by_drift),
        ("*Everywhere* falls by {} dB at most", lambda t: (fallen(t, r"\| (?!drift)\w+$", SHOWN[1]),)),
    ),
    said(
        "docs/rig.md",
        ALONE,
        (
            "three times the room's light cost: {} and {} dB of",
            lambda t: [captured(t, "wall", fault, "after one check, dB") for fault in ("lamp", "daylight")],
        ),
        ("for sRGB costs {} dB (`believed`)", lambda t: (captured(t, "wall", "believed", "below, dB"),)),
        (
            "a lamp at nine tenths {}; three times the room's light {}.",
            lambda t: [captured(t, "wall", "quiet") - captured(t, "wall", fault) for fault in ("lamp", "daylight")],
        ),
    ),
    said(
        "docs/drift.md",
        RIG,
        (
            "A shift of one projector pixel costs [{} to {} dB]",
            by_drift,
        ),
        (
            "on the wall {} and {} dB, in the corner {} and {}, behind glass {} and {}, out of focus {} and {}.",
            lambda t: [each for room in ROOMS for each in checked(t, room)],
        ),
    ),
    said(
        "docs/first-rig.md",
        RIG,
        (
            "a pixel of drift costs {} to {} dB",
            by_drift,
        ),
    ),
)
