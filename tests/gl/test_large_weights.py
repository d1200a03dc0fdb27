"""Rows whose large weights nearly cancel: the shader stays within what float32 sums allow."""

import moderngl
import numpy as np
import pytest

from counterlight.gl.gpu_maps import MapTextures
from counterlight.gl.passes import float_texture
from counterlight.maps.row_map import SparseRows, pack

OUTPUT, SOURCE = (6, 9), (15, 20)
UNIT_ROUNDOFF = 2.0**-24


@pytest.mark.parametrize("size", [1e3, 1e6, 1e12])
@pytest.mark.parametrize("longest", [4, 60, 250])
def test_large_cancelling_weights_stay_within_the_rows_l1_bound(
    gl_context: moderngl.Context, rng: np.random.Generator, longest: int, size: float
) -> None:
    """|fl(Σ w s) − Σ w s| ≤ γ_n Σ |w s|, γ_n = n u / (1 − n u), for any order of summation (Higham 2002, 3.1)."""
    lengths = 2 * rng.integers(1, longest // 2 + 1, OUTPUT[0] * OUTPUT[1])
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    indices = np.concatenate([rng.permutation(SOURCE[0] * SOURCE[1])[:n] for n in lengths])
    half = size * rng.uniform(0.5, 1, (indptr[-1] // 2, 3))
    weights = np.stack([half, -half + rng.uniform(-1, 1, half.shape)], axis=1).reshape(-1, 3).astype(np.float32)
    smooth = (0.5 + 1e-4 * rng.uniform(size=(*SOURCE, 3))).astype(np.float32)

    textures = MapTextures(
        gl_context, pack(SparseRows(indptr, indices, weights, SOURCE[0] * SOURCE[1]), OUTPUT, SOURCE)
    )
    rgba = np.concatenate([smooth, np.ones((*SOURCE, 1), np.float32)], axis=2)
    source, step = float_texture(gl_context, SOURCE, rgba), textures.product()
    shown = np.frombuffer(step.run(source).read(), np.float32).reshape(-1, 4)[:, :3]
    for resource in (step, source, textures):
        resource.release()

    products = weights.astype(np.float64) * smooth.reshape(-1, 3)[indices]
    exact = np.add.reduceat(products, indptr[:-1])
    l1 = np.add.reduceat(np.abs(products), indptr[:-1])
    n = (lengths + 1)[:, None]  # each product is rounded once as well
    assert np.all(np.abs(shown - exact) <= n * UNIT_ROUNDOFF / (1 - n * UNIT_ROUNDOFF) * l1)
    assert np.abs(exact).max() < 0.01 * l1.max()  # the weights do cancel
