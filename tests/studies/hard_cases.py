"""Results of every method on the hard cases: python -m tests.studies.hard_cases prints three tables, case × method.

tests/hard_systems.py defines the cases and the methods. tests/test_hard_cases.py and tests/test_hard_noise.py test what
is known or proven of each. The figures do not depend on T's unit:

- error: RMS of T·clamp(p) − b through the true T, in per cent of the RMS of the floodlit room T·1;
- amplification: σ₁ ‖Δp‖ / ‖Δb‖ before the clamp, the worst of four directions of 1 % noise, one of them T's weakest
  left singular vector where an SVD is cheap: 1 for an orthogonal T, up to the condition number for a plain inverse;
- seconds: of a solver for one channel and one picture, of a map for three channels and any picture.

A fourth table shows the effect of cutting clusters on all figures. `--output FOLDER` also writes CSV, JSON and the
plot.
"""

import argparse
import csv
import json
import re
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight.command import track
from counterlight.errors import InputError
from counterlight.tools.clusters.components import Clusters, find_clusters
from counterlight.tools.clusters.search import decompose_to
from counterlight.tools.transport.transport import Csr, channel, stacked
from tests.hard_systems import (
    CONDITIONS,
    CUT,
    METHODS,
    NOISE,
    REFINED,
    SPLIT,
    Apply,
    HardCase,
    all_cases,
    defocus,
    defocused_wall,
    rng,
)

FloatArray = NDArray[np.float64]
TRIED = METHODS | REFINED | SPLIT
CUT_CONDITIONS = (4.0, 1e2, 1e4, 1e8)
CUT_COLUMNS = "focus", "allowed", "clusters", "worst condition", "‖ΔT‖ / ‖T‖", "plain inverse", "λ = 0.1 σ₁"


@dataclass(frozen=True)
class Figures:
    """One method on one case; NaN and a reason if it refused."""

    case: str
    method: str
    error: float
    amplification: float
    seconds: float
    refused: str = ""


def measure(case: HardCase, method: str) -> Figures:
    start = time.perf_counter()
    try:
        apply = TRIED[method](case)
        p = apply(case.target)
    except InputError as error:
        return Figures(case.name, method, np.nan, np.nan, time.perf_counter() - start, str(error))
    seconds = time.perf_counter() - start
    return Figures(case.name, method, case.error(p), amplification(case, apply, p), seconds)


def amplification(case: HardCase, apply: Apply, p: FloatArray) -> float:
    """Returns σ₁ ‖Δp‖ / ‖Δb‖, the worst of a few directions Δb of NOISE times the floodlit room."""
    size = NOISE * float(np.linalg.norm(case.floodlight))
    return max(
        case.largest_singular_value * float(np.linalg.norm(apply(case.target + size * d) - p)) / size
        for d in directions(case)
    )


def directions(case: HardCase) -> list[FloatArray]:
    """Returns unit vectors over the camera pixels."""
    random = [rng(20 + i).normal(size=case.T.shape[0]) for i in range(3)]
    weakest = [] if case.singular is None else [case.singular[0][:, -1]]
    return [d / np.linalg.norm(d) for d in random] + weakest


def measure_all() -> list[Figures]:
    """Measure every method on every case and on the walls of every condition, and print the three tables row by row."""
    cases = [*all_cases(), *(defocused_wall(condition) for condition in CONDITIONS)]
    found: list[Figures] = []
    for case in track(cases, "hard cases", len(cases)):
        found += [measure(case, method) for method in TRIED]
    for title, cell in TABLES.items():
        print(f"\n{title}\n{'':34}", *(f"{method:>12}" for method in TRIED))
        for case in cases:
            row = [figures for figures in found if figures.case == case.name]
            print(f"{case.name:34}", *(f"{'refused' if f.refused else cell(f):>12}" for f in row))
    print(f"\n{markdown(found)}\n\n{far_light_table(found)}\n")
    for reason in sorted({f"{f.case}, {f.method}: {f.refused}" for f in found if f.refused}):
        print(reason)
    return found


TABLES: dict[str, Callable[[Figures], str]] = {
    "camera error after the clamp, % of the floodlit room": lambda f: f"{100 * f.error:.3g}",
    "amplification of noise, σ₁ ‖Δp‖ / ‖Δb‖": lambda f: f"{f.amplification:.2g}",
    "seconds": lambda f: f"{f.seconds:.2f}",
}


SHOWN = {  # column of docs/hard_cases.md -> method
    "plain map, `svd`": "map none",
    "`qr`": "qr",
    "`nnls`": "nnls",
    "map, λ 0.01": "map 0.01",
    "map, λ 0.1": "map 0.1",
    "map, auto": "map auto",
    "`direct`": "direct",
    "4 steps": "refined 4",
    "64 steps": "refined 64",
    "`box`": "box",
}
LISTED = {  # case -> name of its row on the page
    "wall, condition 1e+02": "wall, condition 1e2",
    "wall, condition 1e+04": "wall, condition 1e4",
    "wall, condition 1e+08": "wall, condition 1e8",
    "wall, condition 1e+14": "wall, condition 1e14",
    "capture noise 1%": "T measured with 1 % noise (1e4)",
    "capture noise 5%": "T measured with 5 % noise (1e4)",
    "target one pixel": "target: one bright pixel",
    "target random": "target: random",
    "target ambient above": "ambient above the target",
    "noise floor": "half the wall at the noise floor",
    "rank-deficient, wide": "rank-deficient, wide",
    "misaligned by 0.25 pixels": "moved by 0.25 projector pixels since (1e4)",
    "misaligned by 1 pixels": "moved by 1 projector pixel since (1e4)",
    "far light, 1 times the near": "as much far light as near (1e2)",
    "far light, 10 times the near": "ten times as much (1e2)",
    "two projectors, 0.1 pixels apart": "two projectors, 0.1 pixels apart",
    "conflicting rows": "two rows that disagree",
    "weights 1e-7 to 1e3": "weights 1e-7 to 1e3",
    "cluster of 2048": "one cluster of 2048",
}
FAR_LIGHT_CASE = "dark paint, far light 0.3"
FAR_LIGHT = {  # row of the page's last table -> method
    "plain inverse of the near light, far light of its drive undone": "split none",
    "plain inverse of near and far light in one T, uncut": "map none",
    "the first, far light of the *clamped* drive undone, twice": "split none, clamped",
    "near and far light in one T, cut to 40 pixels, energy fitted, plain: the thesis' way": "thesis",
    "λ = 0.1 σ₁ of the near light, far light of its drive undone": "split 0.1",
    "the same, of the clamped drive": "split 0.1, clamped",
    "`refine`, 4 steps from the default map": "refined 4",
    "`box`": "box",
}


def far_light_table(found: list[Figures]) -> str:
    """Returns error and amplification if the subtracted far light belongs to a drive that is not shown."""
    by_method = {figures.method: figures for figures in found if figures.case == FAR_LIGHT_CASE}
    cells = {name: _cell(by_method[method]).split(" / ") for name, method in FAR_LIGHT.items()}
    lines = [f"| {name} | {' | '.join(both)} |" for name, both in cells.items()]
    return "\n".join(["| far light and dark paint | error, % | amplification |", "|---|---|---|", *lines])


def markdown(found: list[Figures]) -> str:
    """Returns the page's table: error and amplification of the cases LISTED by the methods of SHOWN."""
    by_name = {(figures.case, figures.method): figures for figures in found}
    lines = [["error, % / amplification", *SHOWN], ["---"] * (1 + len(SHOWN))]
    lines += [[name, *(_cell(by_name[case, method]) for method in SHOWN.values())] for case, name in LISTED.items()]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cell(figures: Figures) -> str:
    if figures.refused:
        return "refused"
    return _error_and_gain(figures.error, figures.amplification)


def _error_and_gain(error: float, gain: float) -> str:
    """Format in per cent, with a decimal for tenths, and gains from 10 to 1000 without exponent."""
    per_cent = f"{100 * error:.1f}" if 0.1 <= error < 1 else f"{100 * error:.2g}"
    return _short_exponent(f"{per_cent} / {gain:.0f}" if 10 <= gain < 1000 else f"{per_cent} / {gain:.2g}")


def _short_exponent(text: str) -> str:
    """Write 1e4 for 1e+04."""
    return re.sub(r"e([+-])0*(\d)", lambda sign: f"e{sign[1].strip('+')}{sign[2]}", text)


# Stability of the decomposition (thesis 4.2.2, 6.3)


@dataclass(frozen=True)
class CutFigures:
    """A wall whose T is cut to clusters of at most `allowed` projector pixels (None: uncut), seen through the whole T.

    condition : condition of the worst cluster.
    change : ‖T_cut − T‖ / ‖T‖.
    plain, damped : (error, amplification) of the plain inverse and of λ = 0.1 σ₁.
    """

    defocus: float
    allowed: int | None
    clusters: int
    condition: float
    change: float
    plain: tuple[float, float]
    damped: tuple[float, float]


def decomposition(condition: float, allowed: int | None) -> CutFigures:
    wall = defocused_wall(condition)
    T = wall.T
    if allowed is not None:
        T = Csr(
            channel(decompose_to(stacked((wall.T,) * 3), wall.camera, wall.projector, allowed)[1].near, 0).astype(
                np.float64
            )
        )
    clusters = find_clusters(T)
    worst = max(_condition(T, clusters, label) for label in range(clusters.count)) if allowed else condition
    cut = replace(wall, T=T, truth=wall.T)
    plain, damped = (measure(cut, method) for method in ("map none", "map 0.1"))
    return CutFigures(
        defocus(condition),
        allowed,
        clusters.count,
        worst,
        float(np.linalg.norm((T - wall.T).toarray(), 2)) / wall.largest_singular_value,
        (plain.error, plain.amplification),
        (damped.error, damped.amplification),
    )


def _condition(T: Csr, clusters: Clusters, label: int) -> float:
    block = T[clusters.camera == label][:, clusters.projector == label].toarray()
    return float(np.linalg.cond(block))


def measure_decomposition() -> list[CutFigures]:
    """Measure the page's second table, and print each row as soon as it is known."""
    found = []
    print(f"| {' | '.join(CUT_COLUMNS)} |\n{'|---' * len(CUT_COLUMNS)}|", flush=True)
    for condition in CUT_CONDITIONS:
        for allowed in (None, CUT, CUT // 4):
            found.append(decomposition(condition, allowed))
            print(f"| {' | '.join(_cut_cells(found[-1]))} |", flush=True)
    return found


def _cut_cells(figures: CutFigures) -> list[str]:
    both = [_error_and_gain(*each) for each in (figures.plain, figures.damped)]
    condition = _short_exponent(f"{figures.condition:.2g}")
    sizes = f"{figures.allowed or 'any'}", f"{figures.clusters}", condition, f"{figures.change:.2f}"
    return [f"σ {figures.defocus:.2f} pixels", *sizes, *both]


# Output


def write(found: list[Figures], cuts: list[CutFigures], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "hard_cases.csv").open("w", newline="") as file:
        rows = csv.DictWriter(file, [field.name for field in fields(Figures)])
        rows.writeheader()
        rows.writerows(asdict(figures) for figures in found)
    everything = {"cases": [asdict(f) for f in found], "decomposition": [asdict(f) for f in cuts]}
    (folder / "hard_cases.json").write_text(json.dumps(everything, indent=1, ensure_ascii=False))
    plot(found, folder / "hard_cases.png")


STYLES = {
    "direct": ("tab:gray", ":", "x"),
    "qr": ("tab:red", "-", "o"),
    "svd": ("tab:orange", "-", "s"),
    "map none": ("tab:brown", "--", "^"),
    "nnls": ("tab:purple", "-", "v"),
    "map 0.01": ("tab:cyan", "-", "d"),
    "map 0.1": ("tab:blue", "-", "D"),
    "map auto": ("tab:green", "--", "P"),
    "map auto cut": ("tab:olive", ":", "h"),
    "refined 4": ("tab:pink", "--", "<"),
    "refined 64": ("tab:pink", "-", ">"),
    "box": ("black", "-", "*"),
}


def plot(found: list[Figures], path: Path) -> None:
    """Draw error and amplification of every method against the condition number of a wall out of focus."""
    from matplotlib.figure import Figure

    by_wall = {(f.case, f.method): f for f in found}
    figure = Figure(figsize=(12, 5.4), layout="constrained")
    error, gain = figure.subplots(1, 2)
    for method, (colour, line, marker) in STYLES.items():
        of_method = [by_wall[f"wall, condition {condition:.0e}", method] for condition in CONDITIONS]
        style = {"color": colour, "linestyle": line, "marker": marker, "label": method}
        error.loglog(CONDITIONS, [100 * f.error for f in of_method], **style)
        gain.loglog(CONDITIONS, [f.amplification for f in of_method], **style)
    gain.loglog(CONDITIONS, CONDITIONS, color="lightgray", linewidth=6, zorder=0, label="condition number")
    for fraction in (0.01, 0.1):
        gain.axhline(1 / (2 * fraction), color="tab:blue", linewidth=0.8, alpha=0.6)
        gain.annotate(f"proven for λ = {fraction:g} σ₁", (CONDITIONS[-1], 1.1 / (2 * fraction)), ha="right", fontsize=8)
    error.axhline(100 * NOISE, color="lightgray", linewidth=6, zorder=0)
    error.annotate("the noise in b", (1e5, 95 * NOISE), ha="center", va="top", fontsize=8)
    error.set_yticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
    error.set_title("What the camera misses, after the clamp")
    error.set_ylabel("RMS error, % of the floodlit room")
    gain.set_title("What becomes of noise in b, before the clamp")
    gain.set_ylabel("σ₁ ‖Δp‖ / ‖Δb‖, worst of four directions")
    for axes in (error, gain):
        axes.set_xlabel("condition number of T (above: defocus in projector pixels)")
        axes.grid(alpha=0.3)
        above = axes.secondary_xaxis("top")
        above.set_xticks(CONDITIONS, [f"σ {defocus(condition):.1f}" for condition in CONDITIONS])
    gain.set_ylim(0.3, 1e9)
    figure.legend(*gain.get_legend_handles_labels(), loc="outside right center")
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="also write CSV, JSON and the plot here")
    output = parser.parse_args().output
    start = time.perf_counter()
    found, cuts = measure_all(), measure_decomposition()
    print(f"\n{time.perf_counter() - start:.0f} s")
    if output is not None:
        write(found, cuts, output)


if __name__ == "__main__":
    main()
