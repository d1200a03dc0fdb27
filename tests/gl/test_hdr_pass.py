"""The radiance shaders against the CPU function: any number of exposures, both bit depths, grey and colour."""

import moderngl
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.gl import exposure_sums
from counterlight.gl.exposure_sums import BATCH, TEXELS, GlSums
from counterlight.response import Response
from counterlight.tools.choices import MERGES
from counterlight.tools.hdr.camera_response import exposure_table
from counterlight.tools.hdr.estimators import SLACK, CpuSums, Estimator, ExposureSums, make_estimator, weight_table

RTOL = 1e-5  # ln E as a float32 sum of up to 17 terms of size 10, then its exponential: 2e-6 measured


def estimator_of(method: str, levels: int, channels: int) -> Estimator:
    curve = Response("table", table=((0, 0, 0), (0.1, 0.2, 0.3), (1, 1, 1))) if channels == 3 else Response("srgb")
    return make_estimator(method, exposure_table(curve, levels, channels), weight_table("gaussian", levels))


def codes_with_ends(rng: np.random.Generator, shape: tuple[int, ...], levels: int) -> np.ndarray:
    """Return random codes, a third of them black or clipped."""
    codes = rng.integers(0, levels, shape)
    ends = rng.uniform(size=shape)
    codes[ends < 0.15], codes[ends > 0.85] = 0, levels - 1
    return codes.astype(np.uint8 if levels == 256 else np.uint16)


def add_all(sums: ExposureSums, estimator: Estimator, codes: np.ndarray, times: np.ndarray) -> np.ndarray:
    for picture, t in zip(codes, times, strict=True):
        sums.add(picture, estimator.coefficients(float(t)), float(t))
    return sums.estimate()


@pytest.mark.parametrize("method", MERGES)
@pytest.mark.parametrize(
    ("levels", "shape"),
    [(256, (5, 7, 3)), (256, (11, 3, 1)), (65536, (5, 7, 3)), (65536, (3, 2, 1)), (256, (61, 90, 3))],
)
def test_the_gpu_sums_as_the_cpu_does(
    gl_context: moderngl.Context,
    rng: np.random.Generator,
    method: str,
    levels: int,
    shape: tuple[int, int, int],
) -> None:
    """A picture of (61, 90, 3) fills a row of texels and begins a second row."""
    estimator = estimator_of(method, levels, shape[2])
    with GlSums(gl_context, estimator.table, shape, estimator.exponential, SLACK) as sums:
        for count in (2, BATCH, BATCH + 1):  # the same object restarts
            times = 10 ** rng.uniform(-4, 1, count)
            codes = codes_with_ends(rng, (count, *shape), levels)
            codes[:, 0, 0] = levels - 1  # a lower bound that must be kept from batch to batch
            codes[: count // 2, 0, 1] = 0
            codes[count // 2 :, 0, 1] = levels - 1
            expected = add_all(CpuSums(estimator, shape), estimator, codes, times)
            found = add_all(sums, estimator, codes, times)
            assert (expected < 0).any()
            np.testing.assert_allclose(found, expected, rtol=RTOL)


def test_an_opengl_of_few_uniforms_reads_the_curve_from_a_texture(
    gl_context: moderngl.Context, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exposure_sums, "SPARE_UNIFORMS", 1 << 30)
    test_the_gpu_sums_as_the_cpu_does(gl_context, rng, "debevec", 256, (5, 7, 3))


def test_large_pictures_wait_in_smaller_batches(
    gl_context: moderngl.Context, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exposure_sums, "BATCH_BYTES", 1)
    test_the_gpu_sums_as_the_cpu_does(gl_context, rng, "robertson", 256, (61, 90, 3))


def test_black_everywhere_is_zero(gl_context: moderngl.Context) -> None:
    estimator = estimator_of("debevec", 256, 3)
    with GlSums(gl_context, estimator.table, (2, 3, 3), estimator.exponential, SLACK) as sums:
        assert not add_all(sums, estimator, np.zeros((3, 2, 3, 3), np.uint8), np.array([0.1, 1, 10])).any()


def test_pictures_beyond_the_largest_texture(gl_context: moderngl.Context) -> None:
    rows = gl_context.info["GL_MAX_TEXTURE_SIZE"]
    estimator = estimator_of("debevec", 256, 1)
    with pytest.raises(InputError, match="exceed this GPU's textures"):
        GlSums(gl_context, estimator.table, (rows + 1, 4 * TEXELS, 1), estimator.exponential, SLACK)
