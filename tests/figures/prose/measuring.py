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
            "one shot, 4 σ.** In every room, *fine* pictures are at most {} dB worse than with the true T",
            lambda t: (largest(t, FINE, ONE),),
        ),
        (
            "In four rooms, *smooth* pictures are at most {} dB worse than with the true T",
            lambda t: (largest(t, SMOOTH, ONE, rooms="corner|glass|skull|two_planes"),),
        ),
        (
            "In `folded_cards`, `statuette` and `wall`, *smooth* pictures are {} to {} dB worse than with the true T.",
            lambda t: ends(lost(t, SMOOTH, ONE, rooms="folded_cards|statuette|wall")),
        ),
        (
            "16 shots, 4 σ.** In every room, pictures are at most {} dB worse than with the true T",
            lambda t: (max(largest(t, each, MANY) for each in (FINE, SMOOTH)),),
        ),
        (
            "`hierarchical` takes up to {} times as many pictures",
            lambda t: (max(ratios(pictures(t, MANY), pictures(t, ONE))),),
        ),
        (
            "pictures after `multiplexed` with 16 shots are at most {} dB worse",
            lambda t: (max(largest(t, each, CODED_MANY, rooms="wall|two_planes") for each in (FINE, SMOOTH)),),
        ),
        (
            "*smooth* pictures after `multiplexed` are {} to {} dB worse than with the true T.",
            lambda t: ends(lost(t, SMOOTH, CODED_MANY, EDGES)),
        ),
        (
            "A threshold of 16 σ** saves up to {} % of the pictures",
            lambda t: (100 - 100 * min(ratios(pictures(t, COARSE), pictures(t, ONE))),),
        ),
        (
            "*smooth* pictures are up to {} dB worse than with 4 σ.",
            lambda t: (largest(t, SMOOTH, COARSE, than=ONE),),
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
            "16 shots by `hierarchical` make pictures at most {} dB worse than with the true T.",
            lambda t: (max(largest(t, each, MANY) for each in (FINE, SMOOTH)),),
        ),
    ),
    said(
        "docs/schemes.md",
        FIRST,
        ("for a wall: the PSNR is {} dB lower than with `hierarchical`", lambda t: short(t, "wall", 9)),
        ("With 48 or 128 pictures, the PSNR is {} dB lower than with `hierarchical`", lambda t: short(t, "glass", 128)),
        (
            "the PSNR of a blurred room is {} dB lower than with `hierarchical`. With 128 pictures, the PSNR is {} dB "
            "lower.",
            lambda t: short(t, "defocus", 9, 128),
        ),
    ),
)
