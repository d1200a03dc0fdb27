"""Rooms × faults as a table, and the figures of every picture as CSV."""

import csv
import io
from collections.abc import Mapping, Sequence
from operator import attrgetter

import numpy as np

from tests.rig.judge import Figures
from tests.rig.trial import SWEPT, Verdict

COLUMNS = {
    "optimum, dB": "{optimum_psnr:.1f}",
    "captured, dB": "{product_psnr:.1f}",
    "below, dB": "{below:.1f}",
    "inside (optimum), dB": "{product_inside:.1f} ({optimum_inside:.1f})",
    "blurred, dB": "{product_smooth:.1f}",
    "ΔE2000 (optimum)": "{product_delta_e:.1f} ({optimum_delta_e:.1f})",
    "everywhere, dB": "{product_everywhere:.1f}",
    "light outside (plain)": "{outside_mean:.1%} ({plain_outside_mean:.1%})",
    "flare (plain)": "{outside_flare:.0%} ({plain_outside_flare:.0%})",
}
BY_STEPS = {"dB": "psnr_{}", "everywhere": "everywhere_{}", "flare, %": "flare_{}"}


def rows(verdicts: Sequence[Verdict]) -> list[dict[str, str]]:
    """Returns a row per room, fault and colour option of the build: means over its pictures."""
    of = attrgetter("room", "fault", "colour")
    return [_row([each for each in verdicts if of(each) == key]) for key in dict.fromkeys(map(of, verdicts))]


def _row(verdicts: Sequence[Verdict]) -> dict[str, str]:
    every = [_figures(verdict) for verdict in verdicts]
    means = {name: float(np.mean([figures[name] for figures in every if name in figures])) for name in every[0]}
    row = _named(verdicts[0])
    row |= {heading: form.format_map(means) for heading, form in COLUMNS.items()}
    row["inside after one check, dB"] = f"{means['checked_inside']:.1f}" if "checked_inside" in means else ""
    for verdict, figures in zip(verdicts, every, strict=True):
        if verdict.by_steps:
            counts = ", ".join(map(str, verdict.by_steps))
            row |= {f"{SWEPT}, {what}, {counts} steps": _series(verdict, figures, what) for what in BY_STEPS}
    return row


def _named(verdict: Verdict) -> dict[str, str]:
    return {"room": verdict.room, "fault": verdict.fault} | ({"colour": verdict.colour} if verdict.colour else {})


def _series(verdict: Verdict, figures: Mapping[str, float], what: str) -> str:
    values = [figures[BY_STEPS[what].format(count)] for count in verdict.by_steps]
    return " ".join(f"{100 * value:.0f}" if "%" in what else f"{value:.1f}" for value in values)


def markdown(verdicts: Sequence[Verdict]) -> str:
    """Returns the table of verdicts."""
    return aligned(rows(verdicts))


def aligned(table: Sequence[Mapping[str, str]]) -> str:
    """Returns a table with aligned columns."""
    head = list(table[0])
    widths = [max(len(name), *(len(row[name]) for row in table)) for name in head]
    lines = [head, ["-" * width for width in widths], *([row[name] for name in head] for row in table)]
    padded = (" | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)
    return "\n".join(f"| {line} |" for line in padded)


def text_of_csv(verdicts: Sequence[Verdict]) -> str:
    """Returns one line per room, fault and picture; decibels, ΔE2000, and shares of white."""
    fields = [
        _named(verdict)
        | {"picture": verdict.picture}
        | {name: f"{value:.4f}" for name, value in _figures(verdict).items()}
        for verdict in verdicts
    ]
    content = io.StringIO()
    # the picture with most fields was shown with several step counts
    writer = csv.DictWriter(content, max(fields, key=len), lineterminator="\n")
    writer.writeheader()
    writer.writerows(fields)
    return content.getvalue()


def _figures(verdict: Verdict) -> dict[str, float]:
    """Returns all numbers of a verdict by name."""
    found = {"below": verdict.distance}
    parts: tuple[tuple[str, Figures], ...] = ("product", verdict.product), ("optimum", verdict.optimum)
    parts += (("checked", verdict.checked),) if verdict.checked is not None else ()
    lights = ("outside", verdict.beside), ("plain_outside", verdict.plain_beside)
    for name, part in (*parts, *lights):
        found |= {f"{name}_{field}": value for field, value in vars(part).items()}
    for count, shown in verdict.by_steps.items():
        numbers = shown.psnr, shown.everywhere, verdict.beside_by_steps[count].flare
        found |= {form.format(count): value for form, value in zip(BY_STEPS.values(), numbers, strict=True)}
    return found
