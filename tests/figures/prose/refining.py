"""Sentences of refinement's studies on steps and on estimates."""

import re
from collections.abc import Iterator
from statistics import mean

from tests.figures.cells import Cells
from tests.figures.claims import Table, counted, ends, said, tabled, told

STILLS = tabled("docs/tables/refinement.md", "start | 1 step")
STUDIED = "wall", "corner", "two_planes", "out of focus"


def denser(t: Table) -> tuple[float, float]:
    """Returns the entries of T⁺ per entry of T, out of focus."""
    return ends([t.one(room, "T⁺") / t.one(room, "T") for room in STUDIED[2:]])


def held(text: str) -> Cells:
    """Read the numbers of entries that the study of refinement prints, by room."""
    found = re.findall(r"\*\*([\w ]+)\*\*, optimum .* entries: T⁺ (\d+), T (\d+)", text)
    return {
        f"{room}, {name}": count for room, *counts in found for name, count in zip(("T⁺", "T"), counts, strict=True)
    }


def estimated(t: Table) -> list[float]:
    """Returns estimates relative to the truth, where the truth is above a thousandth of a decibel."""
    pairs = zip(t(".", "estimated"), t(".", "in truth"), strict=True)
    return [estimate / truth for estimate, truth in pairs if truth > 0.001]


def entries() -> Iterator[tuple[str, str]]:
    """Yield the sentence of each room before its tables, on the page and in the study's output."""
    page = "the PSNR of the optimum is {} dB, and T⁺ alone is {} dB below the optimum."
    printed = "optimum {} dB, T⁺ alone {} dB below; entries: T⁺ {}, T {}"
    names = {
        "the wall": "wall",
        "the corner": "corner",
        "`two_planes`": "two_planes",
        "the room out of focus": "out of focus",
    }
    for room, name in names.items():
        yield f"For {room}, {page} For {room}, T⁺ has {{}} entries, and T has {{}}", f"**{name}**, {printed}"


PROSE = (
    said(
        "docs/refinement.md",
        STILLS,
        (
            "With the start `map`, pictures in every room are within {} dB of the optimum after eight steps. After "
            "sixteen steps from `map`, pictures are within {} dB of the optimum.",
            lambda t: (max(t(r": map$", "8 steps")), max(t(r": map$", "16 steps"))),
        ),
    ),
    said(
        "docs/tables/refinement.md",
        STILLS,
        (
            "the weights and priors still cost {} to {} dB",
            lambda t: ends(t(r": map$", "64 steps")),
        ),
    ),
    said(
        "docs/refinement.md",
        STILLS,
        (
            "film stays within {} dB of the optimum with four steps per frame. With eight steps per frame, film stays "
            "within {} dB of the optimum.",
            lambda t: [max(t(": previous$", f"{steps} steps")) for steps in (4, 8)],
        ),
    ),
    said(
        "docs/tables/refinement.md",
        STILLS,
        (
            "includes about {} ms for decoding, placing and encoding",
            lambda t: (mean(t(": direct$", "before a step, ms")),),
        ),
    ),
    counted("docs/refinement.md", STILLS, held, ("T⁺ has {} to {} times the entries of T", denser)),
    told(
        "docs/tables/refinement.md",
        STILLS.commands,
        STILLS.minutes,
        ("A step of refinement that keeps far light constant takes {} ms", "as it is in the start, {} ms a"),
    ),
    told("docs/tables/refinement.md", STILLS.commands, STILLS.minutes, *entries()),
    said(
        "docs/refinement.md",
        tabled("docs/tables/standing.md", "room, picture | start, steps"),
        ("All estimates are within a factor of {} of the true distance", lambda t: (1 / min(estimated(t)),)),
    ),
)
