"""Hard cases of compensation: `python -m tests.hard_cases` prints case × method; tests/test_hard_cases.py uses them.

A case is one system T p ≈ b. Methods are the correction map (plain, damped, chosen) and the CPU solvers. Three figures:
error, the largest ‖T clamp(p) − b‖ / ‖b‖ when b carries 1 % of noise; amplification, the largest σ₁ ‖Δp‖ / ‖Δb‖ for
that noise, p unclamped (it is 1 for an orthogonal T); and seconds. `--output FOLDER` also writes hard_cases.csv and
hard_cases.png, the first two against the condition number.
"""

import argparse
import csv
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tests.rooms import blurred_transport
from tools.clusters.blocks import ClusterBlocks
from tools.clusters.components import find_clusters
from tools.clusters.search import decompose_to
from tools.inverse.inverse import InverseOptions, invert_near_light
from tools.solve.registry import SOLVERS, solve
from tools.solve.system import linear_system

FloatArray = NDArray[np.float64]
Apply = Callable[[FloatArray], FloatArray]
NOISE_TRIALS, NOISE = 5, 0.01
CONDITIONS = tuple(10.0**k for k in range(2, 15, 2))
TARGETS = ("black", "white", "one pixel", "checkerboard", "random", "darker than ambient light")
SIDE = (40, 60), (48, 64)  # projector and camera of the cluster of thousands


@dataclass(frozen=True)
class Case:
    """T (camera pixels, projector pixels) and b (camera pixels,)."""

    name: str
    T: FloatArray | sparse.csr_array
    b: FloatArray


def invert(T: FloatArray | sparse.csr_array, options: InverseOptions) -> sparse.csr_array:
    """T⁺ (projector pixels, camera pixels) as build-correction-map makes it."""
    near = sparse.csr_array(T).astype(np.float32)
    large = near.shape == (SIDE[1][0] * SIDE[1][1], SIDE[0][0] * SIDE[0][1])
    camera, projector = (SIDE[1], SIDE[0]) if large else ((1, near.shape[0]), (1, near.shape[1]))
    flood = near @ np.ones(near.shape[1])
    white = float(np.percentile(flood[flood > 0], 10))
    reach = np.full((near.shape[0], 3), white)
    inverse = invert_near_light((near,) * 3, np.ones(camera, bool), projector, reach, white, options)
    return inverse.matrices(near.shape[0])[0]


def of_map(damping: float | None) -> Callable[[Case], Apply]:
    def prepare(case: Case) -> Apply:
        inverse = invert(case.T, InverseOptions(damping, 0.0))
        return lambda b: inverse @ b

    return prepare


def of_solver(name: str) -> Callable[[Case], Apply]:
    return lambda case: lambda b: solve(name, linear_system(case.T, b)).unclamped


METHODS: dict[str, Callable[[Case], Apply]] = {
    "map, plain": of_map(0.0),
    "map, λ 0.1": of_map(0.1),
    "map, auto": of_map(None),
    **{name: of_solver(name) for name in SOLVERS},
}


def conditioned(rng: np.random.Generator, condition: float, shape: tuple[int, int] = (24, 12)) -> FloatArray:
    """A non-negative matrix whose last two columns differ so little that its condition is about `condition`."""
    T = rng.uniform(0.2, 1.0, shape) * (rng.uniform(size=shape) < 0.5) + 2 * np.eye(*shape)
    T[:, -1] = T[:, -2] * (1 + np.linalg.norm(T, 2) / np.linalg.norm(T[:, -2]) / condition * rng.normal(size=shape[0]))
    return np.maximum(T, 0)


def reachable(rng: np.random.Generator, T: FloatArray | sparse.csr_array) -> FloatArray:
    """What a drive of 0.1 to 0.9 gives."""
    return np.asarray(T @ rng.uniform(0.1, 0.9, T.shape[1]))


@cache
def cases() -> list[Case]:
    """The list; always the same."""
    rng = np.random.default_rng(2006)
    found = []

    def add(name: str, T: FloatArray | sparse.csr_array, b: FloatArray | None = None) -> None:
        found.append(Case(name, T, reachable(rng, T) if b is None else b))

    well = rng.uniform(0.1, 0.4, (24, 12)) + 2 * np.eye(24, 12)
    add("well-conditioned", well)
    doubled = np.concatenate([well, well])
    add("duplicate rows, conflicting targets", doubled, np.concatenate([reachable(rng, well), reachable(rng, well)]))
    for condition in CONDITIONS:
        add(f"nearly parallel columns, condition {condition:.0e}", conditioned(rng, condition))
    add("exactly parallel columns", np.repeat(well, 2, axis=1))
    low = rng.uniform(size=(12, 5))
    add("rank 5 of 12, square", low @ rng.uniform(size=(5, 12)))
    add("rank 5 of 12, wide", low @ rng.uniform(size=(5, 20)))
    add("rank 5 of 12, tall", rng.uniform(size=(20, 5)) @ rng.uniform(size=(5, 12)))
    holed = well.copy()
    holed[3:6] = 0
    holed[:, 4:6] = 0
    add("zero rows and columns", holed)
    add("one-entry clusters", np.diag(rng.uniform(0.01, 1, 40)))
    add("one cluster of 2400 pixels", blurred_transport(rng, SIDE[1], SIDE[0], 0.7))
    spread = np.eye(16, 12) + 0.3 * rng.uniform(size=(16, 12))
    add("weights 1e-7 to 1e3", spread * 10.0 ** np.linspace(-7, 3, 12))
    add("weights of 1e-30", 1e-30 * well)
    add("T at the noise floor", np.maximum(1e-3 * rng.normal(size=(24, 12)), 0) + 1e-6)
    for share in (0.01, 0.05):
        noisy = np.maximum(well + share * rng.normal(size=well.shape) * well, 0)
        add(f"capture noise of {share:.0%} in T and b", noisy, reachable(rng, well) * (1 + share * rng.normal(size=24)))
    blur = blurred_transport(rng, (16, 20), (14, 18), 0.6)
    white = float(np.min(blur @ np.ones(blur.shape[1])))
    y, x = np.mgrid[:16, :20]
    pictures = (0 * x, 1 + 0 * x, (x == 9) & (y == 7), (x + y) % 2, rng.uniform(size=x.shape), -0.3 + 0 * x)
    for name, picture in zip(TARGETS, pictures, strict=True):
        add(f"target {name}", blur, white * picture.astype(float).ravel())
    for scale in (1e-6, 1e6):
        add(f"T and b times {scale:.0e}", scale * well, scale * reachable(rng, well))
    return found


@dataclass(frozen=True)
class Figures:
    error: float
    amplification: float
    seconds: float


def measure(case: Case, method: Callable[[Case], Apply]) -> Figures:
    """Error, amplification and seconds of one method on one case, for its own b."""
    T = sparse.csr_array(case.T)
    start = time.perf_counter()
    apply = method(case)
    p = apply(case.b)
    seconds = time.perf_counter() - start
    size = float(np.linalg.norm(case.b) or np.linalg.norm(T @ np.ones(T.shape[1])))  # black: relative to white
    rng, error, amplification = np.random.default_rng(1), 0.0, 0.0
    sigma = float(np.linalg.norm(T.toarray(), 2)) if T.shape[1] < 1000 else float(sparse.linalg.svds(T, 1)[1][0])
    for _ in range(NOISE_TRIALS):
        change = rng.normal(size=case.b.size)
        change *= NOISE * size / np.linalg.norm(change)
        noisy = apply(case.b + change)
        error = max(error, float(np.linalg.norm(T @ np.clip(noisy, 0, 1) - case.b)) / size)
        amplification = max(amplification, sigma * float(np.linalg.norm(noisy - p)) / (NOISE * size))
    return Figures(error, amplification, seconds)


def print_decomposition() -> None:
    """What cutting clusters does to their condition and to the inverse: the thesis' open question (4.2.2)."""
    camera, projector = (38, 50), (30, 40)
    print("allowed  clusters  largest condition  median  amplification plain  λ 0.1   error plain  λ 0.1")
    for name, sigma in (("in focus, σ 0.4", 0.4), ("out of focus, σ 0.8", 0.8)):
        rng = np.random.default_rng(7)
        T = blurred_transport(rng, camera, projector, sigma)
        smooth = cv2.GaussianBlur(rng.uniform(size=camera), (0, 0), 2)
        b = (T @ np.ones(T.shape[1])) * np.interp(smooth, (smooth.min(), smooth.max()), (0.05, 0.9)).ravel()
        print(name)
        for allowed in (None, 300, 100, 30):
            cut = T if allowed is None else decompose_to((T,) * 3, camera, projector, allowed)[1].matrices[0]
            clusters = find_clusters(cut)
            blocks = ClusterBlocks(clusters, np.ones(clusters.count, bool))
            entries = blocks.entries(cut)
            sigmas = [
                np.linalg.svd(blocks.dense(entries, batch), compute_uv=False) for batch in blocks.batches(1 << 20)
            ]
            conditions = np.concatenate([values[:, 0] / np.maximum(values[:, -1], 1e-12) for values in sigmas])
            largest = max(float(values.max()) for values in sigmas)
            noisy, error = [], []
            for options in (InverseOptions(0.0, 0.0), InverseOptions(0.1, 0.0)):
                flood = float(np.percentile(T @ np.ones(T.shape[1]), 10))
                reach = np.full((T.shape[0], 3), flood)
                inverse = invert_near_light((cut,) * 3, np.ones(camera, bool), projector, reach, flood, options)
                plus = inverse.matrices(T.shape[0])[0]
                noisy.append(largest * float(sparse.linalg.svds(plus, 1, return_singular_vectors=False)[0]))
                error.append(float(np.linalg.norm(T @ np.clip(plus @ b, 0, 1) - b) / np.linalg.norm(b)))
            print(
                f"{allowed or 'all':>7} {clusters.count:9} {conditions.max():18.3g} {np.median(conditions):7.3g} "
                f"{noisy[0]:20.3g} {noisy[1]:6.2g} {error[0]:13.4f} {error[1]:6.4f}",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="also write the table as CSV, and a plot")
    output = parser.parse_args().output
    print_decomposition()
    rows = []
    width = max(len(case.name) for case in cases())
    print(
        f"error of the clamped drive under 1 % of noise / amplification of noise\n{'':{width}}",
        *(f"{m:>17}" for m in METHODS),
    )
    for case in cases():
        figures = {name: measure(case, method) for name, method in METHODS.items()}
        print(
            f"{case.name:{width}}",
            *(f"{f.error:8.4f} /{f.amplification:7.2g}" for f in figures.values()),
            flush=True,
        )
        rows += [(case.name, name, f.error, f.amplification, f.seconds) for name, f in figures.items()]
    for name in METHODS:
        print(f"{name}: {sum(row[4] for row in rows if row[1] == name):.1f} s for all cases")
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        with (output / "hard_cases.csv").open("w", newline="") as file:
            csv.writer(file).writerows([("case", "method", "error", "amplification", "seconds"), *rows])
        plot(rows, output / "hard_cases.png")


def plot(rows: list[tuple[str, str, float, float, float]], path: Path) -> None:
    """Error and amplification of every method against the condition number."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.2), layout="constrained")
    axes = figure.subplots(1, 2)
    for name, style in zip(METHODS, ("-o", "-s", "-D", ":x", "--v", "--^", "-.<", "-.>"), strict=True):
        of_method = [row for row in rows if row[1] == name and row[0].startswith("nearly parallel")]
        for axis, column in zip(axes, (2, 3), strict=True):
            axis.loglog(CONDITIONS, [row[column] for row in of_method], style, label=name, markersize=5)
    axes[0].set_ylim(bottom=1e-3)
    axes[0].set(
        title="Error of the clamped drive, 1 % of noise in b", ylabel="‖T p − b‖ / ‖b‖", xlabel="condition number of T"
    )
    axes[1].set(title="Amplification of noise", ylabel="σ₁ ‖Δp‖ / ‖Δb‖", xlabel="condition number of T")
    axes[1].legend(fontsize=8)
    for axis in axes:
        axis.set_xlabel("condition number of T")
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
