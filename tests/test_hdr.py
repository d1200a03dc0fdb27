"""Radiance maps and camera responses: closed forms, truth by construction, OpenCV and colour-hdri as oracles."""

import math
import tracemalloc
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.hdr.bracket import open_bracket
from counterlight.tools.hdr.camera_response import exposure_table
from counterlight.tools.hdr.estimators import CpuSums, make_estimator, weight_table
from counterlight.tools.hdr.radiance import MergeOptions, merge
from counterlight.tools.hdr.recovery import debevec_log_response, recover_response, robertson_response
from tests.brackets import CURVES, codes_of, random_scene
from tests.studies.recovery import recovered, samples_of

with warnings.catch_warnings(record=True):  # colour-hdri imports colour, which warns that matplotlib is missing
    warnings.simplefilter("ignore")
    import colour_hdri

LINEAR = CURVES["linear"]
FLOAT32_RTOL = 3e-7  # the result is rounded to float32, relative 6e-8; the sums are float64


def estimate(
    codes: list[np.ndarray], times: list[float], method: str, exposure: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    estimator = make_estimator(method, exposure, weights, margin=0)
    sums = CpuSums(estimator, codes[0].shape)
    for picture, t in zip(codes, times, strict=True):
        sums.add(picture, estimator.coefficients(t), t)
    return sums.estimate()


def test_weights_are_those_of_the_thesis() -> None:
    z = np.arange(256)
    hat = np.where(z <= 127.5, z, 255 - z)  # eq. 3.5
    np.testing.assert_allclose(weight_table("hat", 256) * 127.5, hat, atol=1e-12)
    bell = np.exp(-4 * (z - 127.5) ** 2 / 127.5**2)  # eq. 3.7, then shifted and scaled
    gaussian = weight_table("gaussian", 256)
    np.testing.assert_allclose(gaussian, (bell - bell[0]) / (1 - bell[0]), atol=1e-12)
    assert gaussian[[0, 255]].tolist() == [0, 0]
    for weighting in ("hat", "gaussian"):
        deep = weight_table(weighting, 65536)
        np.testing.assert_allclose(deep[z * 257], weight_table(weighting, 256), atol=1e-12)


def by_hand(z: list[int], times: list[float], method: str, weighting: str, f: np.ndarray, w: np.ndarray) -> float:
    """Estimate one pixel and channel with equations 3.4 and 3.6."""
    terms = [(float(w[code]), float(f[code]), t) for code, t in zip(z, times, strict=True) if w[code] > 0]
    bound = max((1 / t for code, t in zip(z, times, strict=True) if code == len(f) - 1), default=0.0)
    if not terms:
        return -bound
    if method == "debevec":
        E = math.exp(sum(w * (math.log(f) - math.log(t)) for w, f, t in terms) / sum(w for w, _, _ in terms))
    else:
        E = sum(w * t * f for w, f, t in terms) / sum(w * t**2 for w, _, t in terms)
    return E if 0.9 * bound <= E else -bound


@pytest.mark.parametrize("weighting", ["hat", "gaussian"])
@pytest.mark.parametrize("method", ["debevec", "robertson"])
@pytest.mark.parametrize(("top", "channels"), [(255, 3), (255, 1), (65535, 3)])
def test_each_pixel_follows_the_equations(
    rng: np.random.Generator, method: str, weighting: str, top: int, channels: int
) -> None:
    times = [0.004, 0.1, 0.1, 2.0]
    response = Response("srgb") if channels == 1 else Response("table", table=((0, 0, 0), (0.2, 0.3, 0.4), (1, 1, 1)))
    dtype = np.uint8 if top == 255 else np.uint16
    codes = [rng.choice([0, top, top // 3, top // 2, top - 1], (5, 7, channels)).astype(dtype) for _ in times]
    f, w = exposure_table(response, top + 1, channels), weight_table(weighting, top + 1)
    found = estimate(codes, times, method, f, w)
    for at in np.ndindex(found.shape):
        expected = by_hand([int(z[at]) for z in codes], times, method, weighting, f[:, at[2]], w)
        assert found[at] == pytest.approx(expected, rel=FLOAT32_RTOL)


@pytest.mark.parametrize("name", list(CURVES))
@pytest.mark.parametrize("method", ["debevec", "robertson"])
@pytest.mark.parametrize("top", [255, 65535])
def test_the_light_comes_back_within_the_quantisation(
    rng: np.random.Generator, method: str, name: str, top: int
) -> None:
    """A weighted mean lies between its terms, each of which is off by at most half a code."""
    light = random_scene(rng, (40, 56, 3))
    times = [0.5, 4.0, 32.0, 256.0]
    response = CURVES[name]
    codes = [codes_of(light, t, response, top) for t in times]
    merged = merge(zip(codes, times, strict=True), response, MergeOptions(method))
    low, high = np.full(light.shape, np.inf), np.zeros(light.shape)
    for z, t in zip(codes, times, strict=True):
        used = (z > 0) & (z < 0.98 * top)
        # the factor 0.01 is for the grid
        bounds = [response.to_linear(np.clip((z + step) / top, 0, 1)) / t for step in (-0.51, 0.51)]
        low = np.where(used, np.minimum(low, bounds[0]), low)
        high = np.where(used, np.maximum(high, bounds[1]), high)
    known = ~(merged.saturated | merged.black)
    assert known.mean() > 0.99
    assert np.all(low[known] <= merged.radiance[known] * (1 + FLOAT32_RTOL))
    assert np.all(merged.radiance[known] <= high[known] * (1 + FLOAT32_RTOL))


@pytest.mark.parametrize("method", ["debevec", "robertson"])
def test_what_no_picture_measured_is_bounded(method: str) -> None:
    # the codes of the fifth pixel contradict each other
    codes = np.array([[255, 0, 0, 128, 255, 0], [255, 0, 251, 255, 240, 1]], np.uint8)
    times = [0.5, 4.0]
    for order in (slice(None), slice(None, None, -1)):  # the bound does not depend on the order
        shots = [(z.reshape(2, 3, 1), t) for z, t in list(zip(codes, times, strict=True))[order]]
        merged = merge(shots, LINEAR, MergeOptions(method))
        np.testing.assert_allclose(
            merged.radiance.ravel(),
            [250 / 255 / 0.5, 0, 250 / 255 / 4, 128 / 255 / 0.5, 250 / 255 / 0.5, 1 / 255 / 4],
            rtol=FLOAT32_RTOL,
        )
        assert merged.saturated.ravel().tolist() == [True, False, True, False, True, False]
        assert merged.black.ravel().tolist() == [False, True, False, False, False, False]


def test_averages_are_means_of_the_light(rng: np.random.Generator) -> None:
    shots = [rng.integers(0, 250, (9, 4, 3), dtype=np.uint8) for _ in range(5)]
    merged = merge(((shot, 0.02) for shot in shots), Response("srgb"), MergeOptions("average"))
    expected = np.mean([Response("srgb").to_linear(shot / 255.0) for shot in shots], axis=0) / 0.02
    np.testing.assert_allclose(merged.radiance, expected, rtol=FLOAT32_RTOL)


def test_a_hundred_pictures_need_no_more_memory_than_ten(rng: np.random.Generator) -> None:
    codes = rng.integers(0, 256, (300, 400, 3), dtype=np.uint8)

    def peak(count: int) -> int:
        tracemalloc.start()
        merge(((codes.copy(), 0.1 * 1.2**i) for i in range(count)), LINEAR, MergeOptions())
        result = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return result

    few = peak(10)
    # per pixel: 20 bytes of sums, 4 bytes of the result, and masks; the memory of a chunk is fixed
    assert few < 40 * codes.size
    assert peak(100) < few + codes.size / 2  # a stored picture would take codes.size


def random_bracket(rng: np.random.Generator, shape: tuple[int, int, int]) -> tuple[list[np.ndarray], np.ndarray]:
    """13 exposures, one stop apart, as in the thesis' figure 3.2."""
    times = (0.01 * 2.0 ** np.arange(13)).astype(np.float32)
    light = np.exp(rng.normal(0, 1.5, shape))
    return [codes_of(light, float(t), CURVES["film"]).repeat(3 // shape[2], axis=2) for t in times], times


@pytest.mark.parametrize(("method", "channels"), [("robertson", 3), ("debevec", 1)])
def test_opencv_merges_alike(rng: np.random.Generator, method: str, channels: int) -> None:
    """Debevec on neutral pictures only, because OpenCV weighs each channel by the mean of all channels' weights."""
    codes, times = random_bracket(rng, (60, 80, channels))
    f = exposure_table(CURVES["film"], 256, 3)
    opencv = cv2.createMergeRobertson() if method == "robertson" else cv2.createMergeDebevec()
    # OpenCV's logarithm of 0 has a weight of 0
    for_opencv = np.maximum(f, f[1] / 2).astype(np.float32).reshape(256, 1, 3)
    theirs = opencv.process(codes, times, for_opencv)
    weights = weight_table("gaussian" if method == "robertson" else "hat", 256)
    ours = estimate(codes, [float(t) for t in times], method, for_opencv[:, 0].astype(np.float64), weights)
    known = np.any([(z > 0) & (z < 255) for z in codes], axis=0)
    assert known.mean() > 0.99
    np.testing.assert_allclose(
        ours[known], theirs[known], rtol=1e-5
    )  # OpenCV sums 13 logarithms of up to 10 in float32


def test_each_channel_is_weighed_by_itself(rng: np.random.Generator) -> None:
    """Where a colour clips in one channel, OpenCV's mean weight of the channels still includes it."""
    codes, times = random_bracket(rng, (60, 80, 3))
    truth = np.exp(np.random.default_rng(20060504).normal(0, 1.5, (60, 80, 3)))
    f = exposure_table(CURVES["film"], 256, 3)
    ours = estimate(codes, [float(t) for t in times], "debevec", f, weight_table("hat", 256))
    theirs = cv2.createMergeDebevec().process(
        codes, times, np.maximum(f, f[1] / 2).astype(np.float32).reshape(256, 1, 3)
    )
    well = np.sum([(z > 20) & (z < 235) for z in codes], axis=0) >= 2
    errors = [np.percentile(np.abs(picture / truth - 1)[well], 99) for picture in (ours, theirs)]
    assert errors[0] < 0.02  # half a code of 20 with a steep curve, averaged over several codes
    assert errors[1] > 5 * errors[0]


@pytest.mark.parametrize("name", list(CURVES))
@pytest.mark.parametrize(
    ("method", "stops", "pictures", "tolerance"),
    # Debevec smooths ln f⁻¹, which is most curved for a straight line: 3 % there, 1 % elsewhere. Robertson needs small
    # steps: a ripple in ln E with the period of the exposure ratio is invisible to it.
    [("debevec", 2, 5, 0.05), ("debevec", 1, 13, 0.02), ("robertson", 1, 13, 0.05)],
)
def test_the_response_is_recovered(
    rng: np.random.Generator, method: str, stops: int, pictures: int, tolerance: float, name: str
) -> None:
    ratio = recovered(rng, name, method, pictures, stops)
    assert np.std(np.log(ratio)) < tolerance / 2
    np.testing.assert_allclose(ratio / ratio[112], 1, atol=tolerance)


def test_debevecs_system_is_the_papers(rng: np.random.Generator) -> None:
    """colour-hdri solves the printed system with one unknown per pixel; the product eliminates these unknowns."""
    times = [0.1, 0.8, 3.2]
    codes = (samples_of(rng, CURVES["srgb"], times, 60, 0.02)[..., 0] * 255).round().astype(int)
    weights = weight_table("hat", 256)
    theirs, _ = colour_hdri.g_solve(codes.T, np.log(times), 30, lambda z: 1 - np.abs(2 * z - 1), 256)
    ours = debevec_log_response(codes / 255, np.log(times), weights, 30)
    inside = slice(1, 255)
    np.testing.assert_allclose(ours[inside], theirs[inside], atol=1e-6)  # normal equations square the condition, 1e5


def test_opencv_recovers_the_same_response_by_robertson(rng: np.random.Generator) -> None:
    """Every pixel is compared after equal rounds; codes near the ends differ, because OpenCV counts clipped codes."""
    times = [2.0**i for i in range(-8, 3)]
    light = random_scene(rng, (96, 96, 1))
    codes = [codes_of(light, t, CURVES["film"]).repeat(3, axis=2) for t in times]
    theirs = cv2.createCalibrateRobertson(30, 1e-9).process(codes, np.array(times, np.float32))[:, 0, 0]
    stack = np.stack(codes)[..., 0].reshape(len(times), -1) / 255
    ours, _ = robertson_response(stack, np.array(times), weight_table("gaussian", 256), max_rounds=30, settled=0)
    inside = slice(16, 240)
    np.testing.assert_allclose((ours / ours[128])[inside], (theirs / theirs[128])[inside], rtol=1e-3)


def test_recovery_says_what_a_bracket_lacks(rng: np.random.Generator) -> None:
    flat = np.full((2, 400, 1), 0.5)
    flat[1] = 0.6
    with pytest.raises(InputError, match=r"shows 2 code values .* expected at least 32 .*--response"):
        recover_response(flat, np.array([1.0, 2.0]), "debevec")


@pytest.fixture
def real_bracket(shared_data: Path) -> tuple[Path, list[np.ndarray], list[float]]:
    folder = shared_data / "hdr-bracket-frobisher"
    if not folder.is_dir():
        pytest.skip("no shared data beside this checkout")
    codes = [cv2.imread(str(folder / f"IMG_260{i}.jpg"))[..., ::-1] for i in range(3)]
    return folder, codes, [0.125, 1.0, 8.0]


def well_exposed(codes: list[np.ndarray]) -> np.ndarray:
    """Pixels neither black nor clipped in any picture, of every second row and column like the references."""
    return np.all([np.all((z > 5) & (z < 250), axis=-1) for z in codes], axis=0)[::2, ::2]


@pytest.mark.parametrize(("method", "stops"), [("debevec", 0.2), ("robertson", 0.15)])
def test_a_real_bracket_merges_as_colour_hdri_merges_it(
    real_bracket: tuple[Path, list[np.ndarray], list[float]], method: str, stops: float
) -> None:
    """The given response is sRGB. The tolerance is in stops, because the reference averages E without weights."""
    folder, codes, times = real_bracket
    with np.load(folder / "reference_colour_hdri_0.2.6.npz") as reference:
        theirs = reference["hdr_srgb_decoded_rgb"]
    merged = merge(zip(codes, times, strict=True), CURVES["srgb"], MergeOptions(method))
    well = well_exposed(codes)
    assert well.sum() > 3000
    assert np.std(np.log2(merged.radiance[::2, ::2] / theirs)[well]) < stops


def test_a_real_bracket_merges_as_opencv_merges_it(real_bracket: tuple[Path, list[np.ndarray], list[float]]) -> None:
    folder, codes, times = real_bracket
    well = well_exposed(codes)
    with np.load(folder / "reference_opencv.npz") as reference:
        f = reference["response_robertson_bgr"][:, 0, ::-1].astype(np.float64)
        theirs = reference["hdr_robertson_bgr"][..., ::-1]
    ours = estimate(codes, times, "robertson", f, weight_table("gaussian", 256))
    np.testing.assert_allclose(ours[::2, ::2][well], theirs[well], rtol=1e-6)  # float32 sums of three terms


def test_the_response_of_a_real_camera(real_bracket: tuple[Path, list[np.ndarray], list[float]]) -> None:
    """With the reference's samples, the answer is equal; with the product's samples, the curve is close."""
    folder, _, times = real_bracket
    weights = colour_hdri.weighting_function_Debevec1997(np.linspace(0, 1, 256))
    samples = np.load(folder / "upstream_test_samples_Grossberg2003.npy")
    paths = [folder / f"IMG_260{i}.jpg" for i in range(3)]
    recovered = recover_response(open_bracket(paths, None).samples(), np.array(times), "debevec")
    curves = exposure_table(recovered, 256, 3)
    with np.load(folder / "reference_colour_hdri_0.2.6.npz") as reference:
        theirs = reference["crf_rgb"]
    for channel in range(3):
        g = np.load(folder / f"upstream_test_g_solve_g_{channel}.npy")
        ours = debevec_log_response(samples[..., channel].T / 255, np.log(times), weights, 30)
        np.testing.assert_allclose(ours[weights > 0], g[weights > 0], atol=1e-6)
        ratio = curves[10:250, channel] / theirs[10:250, channel]
        assert np.std(np.log(ratio)) < 0.1  # three exposures three stops apart, other pixels, other smoothness
