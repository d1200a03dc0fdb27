"""Savings and losses from factoring a dense T: python -m tests.studies.factoring prints a table.

The room is the corner of the rig with every bounce of its light, entry by entry. It is also tried with
the noise of a path tracer with PATHS paths per camera pixel, and with measurement noise. The given T judges the drives.
"""

import time

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.pipeline.content import camera_psnr, reachable_white
from counterlight.tools.factoring.factoring import factored
from counterlight.tools.factoring.losses import asked
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.transport import Transport, channels
from tests.dense_rooms import radiosity_corner

PATHS, NOISE, SHARP = 500, 0.5, 50.0  # paths per camera pixel; share of faint entries' mean; multiple of a row's mean


def traced(T: Transport, rng: np.random.Generator) -> Transport:
    """Replace faint entries by what PATHS paths per camera pixel find: 0, or multiples of a path's light."""
    made = []
    for matrix in channels(T.near):
        faint = _faint(matrix)
        light = np.bincount(_rows(matrix)[faint], matrix.data[faint], matrix.shape[0]) / PATHS
        unit = light[_rows(matrix)[faint]]
        matrix.data[faint] = unit * rng.poisson(matrix.data[faint] / np.maximum(unit, 1e-30))
        matrix.eliminate_zeros()
        made.append(matrix)
    return Transport.from_matrices(made, camera=T.camera, projector=T.projector)


def noisy(T: Transport, rng: np.random.Generator) -> Transport:
    """Add measurement noise to every entry, cut at 0."""
    made = []
    for matrix in channels(T.near):
        level = NOISE * matrix.data[_faint(matrix)].mean()
        matrix.data = np.maximum(matrix.data + level * rng.standard_normal(matrix.nnz, np.float32), 0)
        matrix.eliminate_zeros()
        made.append(matrix)
    return Transport.from_matrices(made, camera=T.camera, projector=T.projector)


def losses(T: Transport, found: Transport) -> FloatArray:
    """Returns dB below T's optimum for each picture of losses.py, by the drives of `found`."""
    assert T.camera is not None
    assert T.projector is not None
    mask = directly_lit(T, np.zeros((*T.camera, 3)), T.projector)
    desired, white = asked(T, mask).desired, reachable_white(T.composition().reshape(*T.camera, 3), mask)
    below = []
    for picture in desired.transpose(2, 0, 1).reshape(-1, *T.camera, 3):
        best, ours = (
            camera_psnr(
                picture, T.apply(prepare("box", each, mask).solve(picture).drive).reshape(picture.shape), mask, white
            )
            for each in (T, found)
        )
        below.append(best - ours)
    return np.array(below)


def _rows(matrix: sparse.csr_array) -> np.ndarray:
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))


def _faint(matrix: sparse.csr_array) -> np.ndarray:
    mean = matrix.sum(axis=1) / matrix.shape[1]
    return np.asarray(matrix.data < SHARP * mean[_rows(matrix)])


def main() -> None:
    rng = np.random.default_rng(15)
    whole = radiosity_corner(0.5)
    rooms = {
        "radiosity": whole,
        "radiosity, noisy": noisy(whole, rng),
        f"{PATHS} paths a pixel": traced(whole, rng),
    }
    print(
        "| corner | camera, projector | entries | near | far | CPU s "
        "| below the optimum, dB: photograph, half, spots, soft |"
    )
    print("|---|---|---|---|---|---|---|")
    factored(radiosity_corner(0.2), np.zeros((24, 32, 3)))  # compiles the loops before the timing
    for name, T in rooms.items():
        assert T.camera is not None
        assert T.projector is not None
        start = time.process_time()
        found, done = factored(T, np.zeros((*T.camera, 3)))
        seconds = time.process_time() - start
        sizes = ", ".join(f"{width}x{height}" for height, width in (T.camera, T.projector))
        below = ", ".join(f"{loss:.3f}" for loss in losses(T, found)) if done.losses else done.reason
        far = done.after - done.near if done.losses else 0
        print(f"| {name} | {sizes} | {done.before} | {done.near} | {far} | {seconds:.1f} | {below} |", flush=True)


if __name__ == "__main__":
    main()
