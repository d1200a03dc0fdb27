"""Sentences on the quality and cost of acquisitions."""

from collections.abc import Sequence
from itertools import starmap
from operator import sub

from tests.figures.claims import Table, ends, said, tabled

HEAD = "room | camera, projector | scheme"
SMALL, LARGE = (tabled("docs/tables/schemes.md", HEAD, f"--camera {camera}") for camera in ("96x72", "256x192"))
FIRST = tabled("docs/schemes.md", "room | fault")
NOISE = tabled("docs/schemes.md", "room | electrons")
FINE, SMOOTH = "fine, dB", "smooth, dB"
ONE, COARSE, MANY = "hierarchical, τ = 4 σ", "hierarchical, τ = 16 σ", "hierarchical, τ = 4 σ, 16 shots"
CODED, CODED_MANY = "multiplexed", "multiplexed, 16 shots"
TRUTH = r"\(the truth\)"
ALL, EDGES = r"\w+", "folded_cards|glass|skull|statuette"


def lost(t: Table, column: str, scheme: str, rooms: str = ALL, than: str = TRUTH) -> list[float]:
    """Returns the loss in dB per room, compared with another scheme or the truth."""
    best, found = (t(rf": (?:{rooms}) \| .* \| {each}$", column) for each in (than, scheme))
    return list(starmap(sub, zip(best, found, strict=True)))


def largest(t: Table, column: str, *schemes: str, rooms: str = ALL, than: str = TRUTH) -> float:
    return max(max(lost(t, column, scheme, rooms, than)) for scheme in schemes)


def pictures(t: Table, scheme: str, rooms: str = ALL) -> list[float]:
    return t(rf": (?:{rooms}) \| .* \| {scheme}$", "pictures")


def ratios(numbers: Sequence[float], others: Sequence[float]) -> list[float]:
    return [number / other for number, other in zip(numbers, others, strict=True)]


def short(t: Table, room: str, *counts: int) -> list[float]:
    """Returns how many dB acquisitions with each count of pictures are below `hierarchical`."""
    whole = t.one(rf": {room}", "hierarchical")
    return [whole - t.one(rf": {room}", f"{count} pictures") for count in counts]


PROSE = (
    said(
        "docs/schemes.md",
        SMALL,
        (
            "4 σ and one shot: fine pictures are at most {} dB worse than with the true T",
            lambda t: (largest(t, FINE, ONE),),
        ),
        ("({} to {} dB with the true T)", lambda t: ends(t(TRUTH, SMOOTH))),
        (
            "are at most {} dB worse in `corner`, `glass`, `skull` and `two_planes`",
            lambda t: (largest(t, SMOOTH, ONE, rooms="corner|glass|skull|two_planes"),),
        ),
        (
            "from one shot, smooth pictures would be {} dB better in `folded_cards`, {} dB in `statuette` and "
            "{} dB in `wall`.",
            lambda t: lost(t, SMOOTH, ONE, rooms="folded_cards|statuette|wall"),
        ),
        (
            "16 shots: fine and smooth pictures are at most {} dB worse than with the true T",
            lambda t: (max(largest(t, each, MANY) for each in (FINE, SMOOTH)),),
        ),
        (
            "`hierarchical` takes up to {} times as many pictures",
            lambda t: (max(ratios(pictures(t, MANY), pictures(t, ONE))),),
        ),
        (
            "pictures after `multiplexed` are at most {} dB worse than with the true T in `wall` and",
            lambda t: (max(largest(t, each, CODED_MANY, rooms="wall|two_planes") for each in (FINE, SMOOTH)),),
        ),
        ("and {} dB in `corner`.", lambda t: lost(t, SMOOTH, CODED_MANY, "corner")),
        (
            "smooth pictures after `multiplexed` are {} to {} dB worse than with the true T, and fine pictures {} to "
            "{} dB.",
            lambda t: [n for column in (SMOOTH, FINE) for n in ends(lost(t, column, CODED_MANY, EDGES))],
        ),
        (
            "A threshold of 16 σ** saves up to {} % of the pictures",
            lambda t: (100 - 100 * min(ratios(pictures(t, COARSE), pictures(t, ONE))),),
        ),
        (
            "fine pictures are up to {} dB worse than with 4 σ, and smooth pictures up to {} dB.",
            lambda t: [largest(t, column, COARSE, than=ONE) for column in (FINE, SMOOTH)],
        ),
        (
            "In `corner`, a T acquired pixel by pixel would have an error of {} %.",
            lambda t: t("corner .* pixel by pixel", "error of T"),
        ),
    ),
    said(
        "docs/schemes.md",
        LARGE,
        (
            "`hierarchical` with one shot, fine pictures are at most {} dB worse than with the true T",
            lambda t: (largest(t, FINE, ONE),),
        ),
        (
            "one shot, smooth pictures are at most {} dB worse than with the true T, except in `wall`",
            lambda t: (largest(t, SMOOTH, ONE, rooms="corner|two_planes"),),
        ),
        (
            "one shot, the PSNR of smooth pictures is {} dB below the {} dB that the true T gives.",
            lambda t: (*lost(t, SMOOTH, ONE, "wall"), *t(rf"wall .* {TRUTH}", SMOOTH)),
        ),
        (
            "pixels and 16 shots, pictures in every room are at most {} dB worse",
            lambda t: (max(largest(t, each, MANY) for each in (FINE, SMOOTH)),),
        ),
    ),
    said(
        "docs/schemes.md",
        FIRST,
        ("with a PSNR {} dB below `hierarchical`", lambda t: short(t, "wall", 9)),
        ("With 48 or 128 pictures, the PSNR is {} dB below `hierarchical`", lambda t: short(t, "glass", 128)),
        (
            "The PSNR is {} dB below `hierarchical` with nine pictures, {} dB with sixteen, {} dB with 48, and {} dB "
            "with 128 pictures.",
            lambda t: short(t, "defocus", 9, 16, 48, 128),
        ),
    ),
)
