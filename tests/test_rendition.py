"""HDR and wide primaries on the screen, against colour-science, a scipy spline, and clips as encoders tag them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import colour
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from counterlight.errors import InputError
from counterlight.media.frames import Frame, PixelFormat, PlaneShape
from counterlight.media.video import MediaReader
from counterlight.passes.colour import LUMINANCE, to_screen
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.signal import eetf, signal_of
from tests.ffmpeg_frames import Planes
from tests.media import next_frame, write_video
from tests.oracles.formulas import planes_to_linear, within_gamut

SPACES = {"bt2020": "ITU-R BT.2020", "p3": "Display P3"}
TAGS = {"color_primaries": 9, "colorspace": 9, "color_range": 1}
X265 = "lossless=1:log-level=none:bframes=0"


def colours(rng: np.random.Generator, transfer: str, **more: Any) -> Frame:
    """Return 16-bit codes, R'G'B' at full range."""
    shape = 12, 17
    plane = PlaneShape(shape[1], shape[0], shape[1])
    pixels = PixelFormat(17, 12, "rgb", 16, (plane,) * 3, "identity", True, transfer, "center", 0, 1.0, **more)
    planes = tuple(rng.integers(0, 1 << 16, shape).astype(np.uint16) for _ in range(3))
    return Frame(0, 0.0, 0.04, 0.0, pixels, planes, (0, 0))


def codes_of(frame: Frame) -> np.ndarray:
    return np.stack(frame.planes, axis=-1) / 65535


def shown(frame: Frame, adjustments: Adjustments = NEUTRAL) -> np.ndarray:
    return planes_to_linear(frame.planes, frame.format, signal_of(frame.format, adjustments))


def by_colour_science(nits: np.ndarray, target: float, primaries: str = "bt2020") -> np.ndarray:
    """Return the light of a BT.2020 display on a BT.709 screen whose white is `target`, before gamut mapping."""
    spaces = colour.RGB_COLOURSPACES[SPACES[primaries]], colour.RGB_COLOURSPACES["ITU-R BT.709"]
    return np.asarray(colour.RGB_to_RGB(nits / target, *spaces, chromatic_adaptation_transform=None))


@pytest.mark.parametrize("primaries", SPACES)
def test_primaries_are_those_of_colour_science(primaries: str) -> None:
    spaces = colour.RGB_COLOURSPACES[SPACES[primaries]], colour.RGB_COLOURSPACES["ITU-R BT.709"]
    expected = colour.matrix_RGB_to_RGB(*spaces, chromatic_adaptation_transform=None)
    # colour-science uses the rounded matrices of the standards
    np.testing.assert_allclose(to_screen(primaries), expected, atol=5e-4)
    np.testing.assert_allclose(to_screen(primaries).sum(axis=1), 1, atol=1e-12)


@pytest.mark.parametrize("transfer", ["pq", "hlg"])
def test_light_below_the_knee_is_colour_science_s(rng: np.random.Generator, transfer: str) -> None:
    """On a screen as bright as the medium, no tone is bent. Colours within BT.709 are only converted."""
    frame = colours(rng, transfer, primaries="bt2020", peak_nits=10_000.0)
    for plane in frame.planes[1:]:
        plane[...] = frame.planes[0] + 0.15 * (plane - frame.planes[0].astype(float))  # colours near grey
    codes = codes_of(frame)
    nits = colour.models.eotf_ST2084(codes) if transfer == "pq" else colour.models.eotf_BT2100_HLG(codes, L_W=1000)
    target = 10_000.0 if transfer == "pq" else 1000.0
    expected = by_colour_science(nits, target)
    inside = np.all((expected >= 0) & (expected <= 1), axis=-1)
    assert 0.1 < inside.mean() < 0.9
    found = shown(frame, Adjustments(target_peak=target))
    np.testing.assert_allclose(found[inside], expected[inside], rtol=5e-3, atol=2e-4)  # the rounded matrix, the tables


@pytest.mark.parametrize(("code", "nits"), [(0.5081, 100), (0.5806, 203), (0.7518, 1000)])
def test_grey_of_pq_has_the_light_that_bt_2408_lists(rng: np.random.Generator, code: float, nits: float) -> None:
    frame = colours(rng, "pq", primaries="bt2020", peak_nits=10_000.0)
    for plane in frame.planes:
        plane[...] = round(65535 * code)
    np.testing.assert_allclose(shown(frame, Adjustments(target_peak=10_000)), nits / 10_000, rtol=2e-3)  # four digits


def test_graphics_white_of_hlg_is_that_of_pq(rng: np.random.Generator) -> None:
    """A code of 75 % in HLG on a display of 1000 cd/m² is 203 cd/m² (BT.2408)."""
    frame = colours(rng, "hlg", primaries="bt2020")
    for plane in frame.planes:
        plane[...] = round(65535 * 0.75)
    np.testing.assert_allclose(shown(frame, Adjustments(target_peak=1000)), 0.203, rtol=2e-3)


@pytest.mark.parametrize(("peak", "target"), [(1000, 203), (4000, 203), (10_000, 50), (600, 400)])
def test_the_curve_is_bt_2390_s(peak: float, target: float) -> None:
    """The curve is the Hermite spline of BT.2390, drawn by scipy from value and slope at both ends."""
    whole, most = (float(colour.models.eotf_inverse_ST2084(nits)) for nits in (peak, target))
    knee = 1.5 * most / whole - 0.5
    spline = CubicHermiteSpline([knee, 1], [knee, most / whole], [1, 0])
    codes = np.linspace(0, 1, 201)
    bent = colour.models.eotf_ST2084(np.where(codes < knee, codes, spline(np.maximum(codes, knee))) * whole)
    np.testing.assert_allclose(eetf(colour.models.eotf_ST2084(codes * whole), peak, target), bent, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("tone_mapping", ["bt.2390", "clip"])
def test_grey_rises_to_white_and_no_further(rng: np.random.Generator, tone_mapping: str) -> None:
    frame = colours(rng, "pq", primaries="bt2020", peak_nits=1000.0)
    for plane in frame.planes:
        plane[...] = np.linspace(0, 65535, plane.size).reshape(plane.shape).round()
    grey = shown(frame, Adjustments(tone_mapping=tone_mapping)).reshape(-1, 3)
    np.testing.assert_allclose(grey, grey[:, :1] * [[1, 1, 1]], atol=1e-6)  # rounding of the matrix
    assert np.all(np.diff(grey[:, 0]) >= -1e-6)
    nits = colour.models.eotf_ST2084(codes_of(frame).reshape(-1, 3)[:, 0])
    np.testing.assert_allclose(grey[nits >= 1000], 1, atol=1e-6)
    # rounding of the tables near black
    np.testing.assert_allclose(grey[nits < 80, 0], nits[nits < 80] / 203, rtol=2e-3, atol=1e-5)
    if tone_mapping == "clip":
        np.testing.assert_allclose(grey[nits < 200, 0], nits[nits < 200] / 203, rtol=2e-3, atol=1e-5)


def test_what_the_screen_cannot_show_keeps_its_luminance_and_hue(rng: np.random.Generator) -> None:
    wide = rng.uniform(0, 1, (500, 3)) @ to_screen("bt2020").T
    found, grey = within_gamut(wide), wide @ LUMINANCE
    assert np.any(wide < 0)
    np.testing.assert_allclose(found @ LUMINANCE, grey, atol=1e-9)
    assert found.min() >= 0
    assert found.max() <= 1
    ratio = (found - grey[:, None]) / (wide - grey[:, None])
    np.testing.assert_allclose(ratio, ratio[:, :1] * [[1, 1, 1]], rtol=1e-6)  # the colour stays on the line to grey
    inside = np.all((wide >= 0) & (wide <= 1), axis=1)
    np.testing.assert_allclose(found[inside], wide[inside], atol=1e-12)


def test_wide_primaries_of_an_ordinary_video_are_the_screen_s(rng: np.random.Generator) -> None:
    frame = colours(rng, "srgb", primaries="p3")
    expected = by_colour_science(colour.models.eotf_sRGB(codes_of(frame)), 1, "p3")
    inside = np.all((expected >= 0) & (expected <= 1), axis=-1)
    np.testing.assert_allclose(shown(frame)[inside], expected[inside], atol=6e-4)  # rounding of the matrix
    same = replace(frame, format=replace(frame.format, primaries="bt709"))
    np.testing.assert_allclose(shown(same), colour.models.eotf_sRGB(codes_of(frame)), atol=1e-6)


@pytest.mark.parametrize("wanted", [49.9, 10_001, float("nan"), "bright"])
def test_peaks_out_of_range_are_refused(wanted: Any) -> None:
    with pytest.raises(InputError, match="hdr-peak: expected auto or cd/m² from 50 to 10000"):
        Adjustments(hdr_peak=wanted)


# Clips, as encoders tag them.


def even(code: int, depth: int = 10) -> list[Planes]:
    """Return a grey of limited range as yuv420p10."""
    luma = np.full((64, 96), code, np.uint16)
    return [(luma, *(np.full((32, 48), 1 << (depth - 1), np.uint16) for _ in range(2)))] * 2


def hevc(path: Path, code: int, transfer: int, more: str = "") -> Path:
    return write_video(
        path,
        even(code),
        pixel_format="yuv420p10le",
        codec="libx265",
        tags=TAGS | {"color_trc": transfer},
        options={"x265-params": X265 + more},
    )


MASTERED = ":hdr10=1:master-display=G(8500,39850)B(6550,2300)R(35400,14600)WP(15635,16450)L(40000000,50)"


@pytest.mark.parametrize(("more", "peak"), [("", 0), (MASTERED, 4000), (f"{MASTERED}:max-cll=600,200", 600)])
def test_how_bright_it_gets_is_what_an_hevc_clip_says(more: str, peak: float, tmp_path: Path) -> None:
    path = hevc(tmp_path / "clip.hevc.mkv", 500, 16, more)
    with MediaReader.open(path) as reader:
        pixels, notices = reader.info.format, reader.notices()
    assert (pixels.transfer, pixels.primaries, pixels.matrix, pixels.depth) == ("pq", "bt2020", "bt2020", 10)
    assert pixels.peak_nits == peak
    assert [("1000 cd/m²" in line, "--hdr-peak" in line) for line in notices] == ([] if peak else [(True, True)])


@pytest.mark.parametrize("name", ["clip.mkv", "clip.hevc.mkv"])
@pytest.mark.parametrize(("transfer", "kind"), [(16, "pq"), (18, "hlg")])
def test_a_clip_s_graphics_white_is_the_same_light(name: str, transfer: int, kind: str, tmp_path: Path) -> None:
    """PQ 58.06 % and HLG 75 %, limited range, 10 bits: 203 cd/m², the room's white unless a tone is bent."""
    code = round(64 + 876 * {"pq": 0.5806, "hlg": 0.75}[kind])
    if name == "clip.hevc.mkv":
        path = hevc(tmp_path / name, code, transfer)
    else:
        tags = TAGS | {"color_trc": transfer}
        path = write_video(tmp_path / name, even(code), pixel_format="yuv420p10le", tags=tags)
    with MediaReader.open(path) as reader:
        frame = next_frame(reader)
        assert (frame.format.transfer, frame.format.primaries) == (kind, "bt2020")
        for adjustments, light in ((Adjustments(tone_mapping="clip"), 1.0), (Adjustments(target_peak=406), 0.5)):
            clipped = replace(adjustments, tone_mapping="clip")
            np.testing.assert_allclose(shown(frame, clipped), light, rtol=0.01)  # a 10-bit code is 1 % of the light
        reader.release(frame)
