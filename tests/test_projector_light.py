"""The measured response and primaries of a projector, and the warnings about unusual light."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from counterlight import calibration
from counterlight.arrays import FloatArray
from counterlight.passes.encode import encoded
from counterlight.response import Response
from counterlight.tools import acquire_transport
from counterlight.tools.acquisition import store
from counterlight.tools.acquisition.acquire import Acquisition
from counterlight.tools.acquisition.cameras.camera import Exposures
from counterlight.tools.acquisition.cameras.live import LiveCamera
from counterlight.tools.acquisition.cameras.simulated import (
    CameraSettings,
    MemoryScreen,
    SimulatedDevice,
    SimulatedRoom,
)
from counterlight.tools.acquisition.plan import Codes
from counterlight.tools.acquisition.ramps import CODES, smoothed
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme
from counterlight.tools.acquisition.store import Wanted
from counterlight.tools.acquisition.summary import Coverage, ProjectorReport
from counterlight.tools.factoring.factoring import Factoring
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.transport.transport import Transport, channels
from tests.acquired_rooms import CAMERA, NOISY, PROJECTOR, room_of, run, sharp_wall
from tests.rooms import write_blurred_room
from tests.test_acquisition import unfinished

Light = Callable[[FloatArray], FloatArray]  # codes 0..1, (projector pixels, 3), to the drive of each primary
GREY = np.linspace(0, 1, 256)[:, None].repeat(3, axis=1)
BLACK = 0.002  # light at code 0, as a share of full drive
MIXED = np.array([[0.88, 0.12, 0], [0.06, 0.88, 0.06], [0, 0.12, 0.88]])


class OddDevice(SimulatedDevice):
    """Sees a projector with any function from codes to light. Each camera channel sees a mixture of the primaries."""

    def __init__(self, room: SimulatedRoom, settings: CameraSettings, light: Light, mixing: FloatArray) -> None:
        self.screen = MemoryScreen(PROJECTOR)
        super().__init__(room, settings, self.screen)
        self._light, self._mixing = light, mixing

    def radiance(self, codes: Codes) -> FloatArray:
        drive = BLACK + (1 - BLACK) * self._light(codes.reshape(-1, 3) / 255.0)
        T = self._room.transport
        own = [T.apply(drive[:, [primary] * 3]) * self._mixing[:, primary] for primary in range(3)]
        return np.asarray(sum(own)).reshape(self._room.ambient.shape) + self._room.ambient


def acquired(
    rng: np.random.Generator, light: Light, *, mixing: FloatArray | None = None, settings: CameraSettings = NOISY,
    transport: Transport | None = None, given: Response | None = None,
) -> Acquisition:  # fmt: skip
    """Return a noisy acquisition of a wall whose brightest pixel is at 70 % of full scale."""
    room = room_of(transport or sharp_wall(rng))
    eye = OddDevice(room, settings, light, np.eye(3) if mixing is None else mixing)
    time = 0.7 / float(eye.radiance(np.full((*PROJECTOR, 3), 255, np.uint8)).max())
    return run(room, HierarchicalScheme(), camera=LiveCamera(eye.screen, eye, Exposures((time,))), given=given)


def report_on(done: Acquisition, given: Response | None = None) -> ProjectorReport:
    entries = int(done.measured.transport.near.indices.size)
    whole = Coverage(np.ones(PROJECTOR, np.bool_))
    return ProjectorReport(done, given, Factoring(entries, entries, entries), whole)


def gammas(*exponents: float) -> Light:
    return lambda codes: np.asarray(codes ** np.array(exponents))


def srgb(codes: FloatArray) -> FloatArray:
    return Response("srgb").to_linear(codes)


def lcd(codes: FloatArray) -> FloatArray:
    """Return S-shaped curves, one per channel."""
    steep, middle = np.array([6.0, 7.0, 9.0]), np.array([0.55, 0.6, 0.5])
    low, high, here = (1 / (1 + np.exp(-steep * (code - middle))) for code in (0.0, 1.0, codes))
    return np.asarray((here - low) / (high - low))


def of_limited_range(codes: FloatArray) -> FloatArray:
    """Return the drive through a cable that carries codes 16 to 235."""
    return np.asarray(np.clip((255 * codes - 16) / 219, 0, 1) ** 2.2)


@pytest.mark.parametrize(
    "curve",
    [
        lambda c: c**2.2,
        lambda c: np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4),
        lambda c: (c**2.2 + 3 * c**2 - 2 * c**3) / 2,
        lambda c: 0.3 * c + 0.7 * c**2.4,
        lambda c: (1 - np.exp(-2 * c**2.2)) / (1 - np.exp(-2)),
    ],
    ids=["gamma", "srgb", "S", "raised", "bounded"],
)
def test_a_smoothed_ramp_is_closer_to_the_curve_though_gains_wander(
    rng: np.random.Generator, curve: Callable[[FloatArray], FloatArray]
) -> None:
    spread, noise, true = 0.024, 1e-4, curve(CODES[1:] / 255)
    gains = 1 + spread * rng.normal(size=(50, len(true))) / np.append(np.ones(len(true) - 1), 4)
    ramps = true * gains + noise * rng.normal(size=gains.shape)
    done = np.stack([smoothed(ramp, spread, noise) for ramp in ramps])
    before, after = (np.sqrt(np.mean((each / each[:, -1:] - true) ** 2)) for each in (ramps, done))
    assert after < 0.7 * before


@pytest.mark.parametrize(
    ("light", "atol"),
    [
        # The bound of a reading's noise is 0.05 % of white (five sigmas). The larger bounds include interpolation
        # between 17 levels:
        (gammas(2.1, 2.2, 2.35), 0.003),
        (gammas(1.0, 1.8, 2.8), 0.003),
        (srgb, 0.003),
        (lcd, 0.005),
        (of_limited_range, 0.015),  # the corner at code 235 lies between two levels
    ],
)
@pytest.mark.parametrize("mixing", [np.eye(3), MIXED], ids=["separate", "mixed"])
def test_each_channels_response_comes_back(
    rng: np.random.Generator, light: Light, atol: float, mixing: FloatArray
) -> None:
    done = acquired(rng, light, mixing=mixing)
    assert done.light is not None
    np.testing.assert_allclose(done.light.response.to_linear(GREY), light(GREY), atol=atol)
    assert done.light.noise < 0.002
    assert done.light.adds_up
    assert done.light.crosstalk == pytest.approx(1 - np.trace(mixing) / 3, abs=0.005)
    assert report_on(done).warnings == []


def test_the_primaries_are_what_the_camera_sees_of_each(rng: np.random.Generator) -> None:
    wall = sharp_wall(rng)
    done = acquired(rng, gammas(2.1, 2.2, 2.35), mixing=MIXED, transport=wall)
    assert done.light is not None
    whole = wall.composition()
    for primary, found in enumerate(done.light.primaries.reshape(3, -1, 3)):
        sigma = done.room.rise_noise + done.room.noise.sigma(whole) / 4  # mean of sixteen captures
        np.testing.assert_array_less(
            np.abs(found - (1 - BLACK) * whole * MIXED[:, primary]), 6 * sigma[:, None].max() + 0 * found
        )


def test_noise_does_not_break_the_rise(rng: np.random.Generator) -> None:
    """With sixty electrons, dark levels are lost in noise. The table still rises strictly, as Response demands."""
    done = acquired(rng, gammas(2.1, 2.2, 2.35), settings=CameraSettings(Sensor(60, 2, 8)))
    assert done.light is not None
    error = done.light.response.to_linear(GREY) - gammas(2.1, 2.2, 2.35)(GREY)
    assert 0.001 < done.light.noise < 0.02
    assert np.abs(error).max() < 6 * done.light.noise


def dimmed(codes: FloatArray) -> FloatArray:
    """Model dynamic contrast: a dark picture closes the iris."""
    return np.asarray(srgb(codes) * (0.5 + 0.5 * codes.mean()))


def with_white_segment(codes: FloatArray) -> FloatArray:
    """Model a warm white segment: s = (0.5, 0.4, 0.3) m², m the darkest primary. Full white is 1."""
    light = srgb(codes)
    return np.asarray((light + np.array([0.5, 0.4, 0.3]) * light.min(axis=1, keepdims=True) ** 2) / 1.5)


@pytest.mark.parametrize("mixing", [np.eye(3), MIXED], ids=["separate", "mixed"])
def test_a_white_segment_is_measured_and_taken_out(rng: np.random.Generator, mixing: FloatArray) -> None:
    """T then describes only red, green and blue. Codes for any light within their range give that light."""
    wall = sharp_wall(rng)
    done = acquired(rng, with_white_segment, mixing=mixing, transport=wall)
    assert done.light is not None
    assert report_on(done).warnings == []
    response = done.light.response
    np.testing.assert_allclose(response.to_linear(GREY), 1.5 * with_white_segment(GREY), atol=0.01)
    ratio = done.measured.transport.composition().sum() / wall.composition().sum()
    assert ratio == pytest.approx((1 - BLACK) / 1.5, rel=0.01)
    drive = rng.random((16, 64, 3))
    codes = encoded(drive, response.over(drive.shape[:2]))
    shown = 1.5 * with_white_segment(codes.reshape(-1, 3) / 255).reshape(drive.shape)
    assert np.abs(shown - drive).mean() < 0.004  # half a code is 0.2 % of white, and s is known equally well
    assert np.abs(shown - drive).max() < 0.02


def vivid(codes: FloatArray) -> FloatArray:
    """Model a vivid mode: a primary alone is 15 to 25 % brighter than in white."""
    others = np.array([0.7, 0.4, 0.6]) * np.roll(codes, -1, axis=1) + [0.3, 0.6, 0.4] * np.roll(codes, -2, axis=1)
    return np.asarray(srgb(codes) * (1 + [0.25, 0.2, 0.15] * (1 - others)))


@pytest.mark.parametrize("mixing", [np.eye(3), MIXED], ids=["separate", "mixed"])
def test_colour_processing_is_measured_and_taken_out(rng: np.random.Generator, mixing: FloatArray) -> None:
    """T is the light of white. Codes for any light up to white give that light."""
    wall = sharp_wall(rng)
    done = acquired(rng, vivid, mixing=mixing, transport=wall)
    assert done.light is not None
    assert done.coloured is not None
    assert report_on(done).warnings == []
    assert re.search(r"from (99|100) to 12[456] % of its share of white", report_on(done).light[-1])
    assert done.coloured.excess < 0.01
    response, codes = done.light.response, rng.random((500, 3))
    assert response.to_linear(codes) == pytest.approx(vivid(codes), abs=0.01)
    drive = rng.random((16, 64, 3))
    codes = encoded(drive, response.over(drive.shape[:2]))
    shown = vivid(codes.reshape(-1, 3) / 255).reshape(drive.shape)
    assert np.abs(shown - drive).mean() < 0.004  # half a code is 0.2 % of white, and B is known equally well
    whole = (1 - BLACK) * wall.composition()
    together = done.light.primaries.reshape(3, -1, 3).sum(axis=0)
    assert np.abs(together - whole @ np.diag(mixing.sum(axis=1))).mean() < 0.01 * whole.mean()


def dull(codes: FloatArray) -> FloatArray:
    """Model a mode for white: a primary alone has 80 % of its share of white."""
    others = (np.roll(codes, 1, axis=1) + np.roll(codes, 2, axis=1)) / 2
    return np.asarray(codes**2.2 * (1 - 0.2 * (1 - others)))


def test_colours_beyond_the_projector_are_reported(rng: np.random.Generator) -> None:
    light = report_on(acquired(rng, dull)).light
    found = re.fullmatch(
        r"unreachable: (\S+) % of a picture's colours need more light than the projector gives them; full "
        r"(red|green|blue) arrives at (\d+) %; all colours arrive with --white at (\d+) % of the room's white level",
        light[-1],
    )
    assert found, light
    wanted = srgb(np.stack(np.meshgrid(*[np.linspace(0, 1, 17)] * 3), axis=-1).reshape(-1, 3))
    codes = np.ones_like(wanted)
    for _ in range(60):  # a round corrects each code by itself
        codes = np.minimum(codes * (wanted / np.maximum(dull(codes), 1e-9)) ** (1 / 2.2), 1)
    beyond = np.any(dull(codes) < wanted - 0.02, axis=1)
    assert float(found[1]) == pytest.approx(100 * beyond.mean(), abs=1)  # B is measured within a hundredth
    assert int(found[3]) == pytest.approx(80, abs=1)
    assert int(found[4]) == pytest.approx(82, abs=1)  # a loss of 2 % of white is ignored


def test_whether_colours_are_captured_is_chosen_once_and_not_for_captures_of_older_versions(tmp_path: Path) -> None:
    wanted = Wanted(tmp_path / "room")
    with store.open_store(tmp_path / "captures", {}, Exposures((1.0,)), wanted) as first:
        assert first.includes("colours", 1, lambda: True)
    with store.open_store(tmp_path / "captures", {}, Exposures((1.0,)), wanted) as again:
        assert again.includes("colours", 1, lambda: False)
        again.finish()
        assert not again.includes("colours", 2, lambda: True)


def test_light_that_does_not_add_up_is_reported_with_what_to_switch_off(rng: np.random.Generator) -> None:
    done = acquired(rng, dimmed)
    assert done.light is not None
    assert not done.light.adds_up
    warnings = " ".join(report_on(done).warnings)
    assert "the projector's light does not add up: grey of code " in warnings
    assert "% of white brighter than red, green and blue of that code together" in warnings
    assert "white segment" in warnings
    assert "dynamic contrast" in warnings


def uneven(codes: FloatArray) -> FloatArray:
    """Model an LCD whose response differs between the two sides of the raster because of the viewing angle."""
    across = np.tile(np.linspace(1.4, 3.2, PROJECTOR[1]), PROJECTOR[0])
    return np.asarray(codes ** (across[:, None] if len(codes) == across.size else 2.2))


def test_colours_that_are_predicted_worse_than_black_and_white_are_reported(rng: np.random.Generator) -> None:
    done = acquired(rng, uneven)
    report = report_on(done)
    assert not report.suspect
    assert report.off_colour
    assert len(report.warnings) == 1
    assert "greys and colours are predicted clearly worse than black and white" in report.warnings[0]


def test_a_given_response_counts_and_is_compared(rng: np.random.Generator) -> None:
    true, wrong = Response("gamma", gamma=2.2), Response("linear")
    done = acquired(rng, gammas(2.2, 2.2, 2.2), given=true)
    assert report_on(done, true).warnings == []
    done = acquired(rng, gammas(2.2, 2.2, 2.2), given=wrong)
    assert done.coloured is not None
    assert done.by_measured is not None
    assert done.coloured.error > 0.3
    assert done.by_measured.error < 2 * done.by_measured.noise + 0.01
    (warning,) = report_on(done, wrong).warnings
    assert warning.startswith("the given response is up to 28 % of white")  # the largest difference is at code 132
    assert "leave out --response" in warning


def test_a_primary_that_is_not_seen_has_the_curve_of_grey(rng: np.random.Generator) -> None:
    """With a red filter on the camera, or a laser that is off, blue cannot be measured. The acquisition continues."""
    T = list(channels(sharp_wall(rng).near))
    T[2] = T[2] * 0
    done = acquired(rng, gammas(2.2, 2.2, 2.2), transport=Transport.from_matrices(T))
    assert done.light is not None
    np.testing.assert_allclose(done.light.response.to_linear(GREY), gammas(2.2)(GREY), atol=0.003)


def arguments(room: Path, output: Path, *words: str) -> list[str]:
    return ["--camera", f"simulated:{room}", "--scheme", "graycode", "-o", str(output), *words]


def table_of(folder: Path) -> NDArray[np.float64]:
    response = calibration.read(folder).calibration.projector.response
    return np.asarray(response.to_linear(GREY))


def test_the_room_has_what_was_measured(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    write_blurred_room(tmp_path / "room", rng, CAMERA, PROJECTOR)
    assert acquire_transport.main(arguments(tmp_path / "room", tmp_path / "out")) == 0
    said = capsys.readouterr()
    for words in (
        "response: measured at 17 levels a channel, about gamma 2.2",
        "contrast: white is ",
        "colour: red, green and blue add up to grey within ",
        "check: random greys and colours are predicted to ",
    ):
        assert words in said.out
    room = calibration.read(tmp_path / "out").calibration
    assert room.primaries is not None
    assert "response measured at 17 levels" in room.provenance
    np.testing.assert_allclose(table_of(tmp_path / "out"), srgb(GREY), atol=0.003)
    again = arguments(tmp_path / "room", tmp_path / "out", "--response", "2.2", "--force", "--reuse-captures")
    assert acquire_transport.main(again) == 0
    assert "response: as given" in capsys.readouterr().out
    assert calibration.read(tmp_path / "out").calibration.projector.response == Response("gamma", gamma=2.2)


def acquired_by_an_older_version(
    its_format: int, folder: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """Prepare an acquisition of an older version, and return the words of the command."""
    write_blurred_room(folder / "room", rng, CAMERA, PROJECTOR)
    words = arguments(folder / "room", folder / "out")
    with monkeypatch.context() as patch:
        patch.setattr(store, "FORMAT", its_format)
        assert acquire_transport.main(words) == 0
    return words


def test_captures_from_before_response_was_measured_are_gone_on_with(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = acquired_by_an_older_version(store.COLOURLESS, tmp_path, rng, monkeypatch)
    assert "54 pictures" in capsys.readouterr().out
    kept = tmp_path / "out.captures"
    for path in sorted((kept / "captures").iterdir())[40:]:
        path.unlink()
    unfinished(kept)
    assert acquire_transport.main([*words, "--force"]) == 0
    said = capsys.readouterr().out
    assert "54 pictures, 54 exposures, 40 of them from before" in said
    assert "response: sRGB assumed; measure it with counterlight fit-response" in said
    room = calibration.read(tmp_path / "out").calibration
    assert room.primaries is None
    assert room.projector.response == Response("srgb")


def test_captures_from_before_the_linearity_of_the_camera_was_checked_are_gone_on_with(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = acquired_by_an_older_version(store.UNHALVED, tmp_path, rng, monkeypatch)
    assert "163 pictures" in capsys.readouterr().out
    unfinished(tmp_path / "out.captures")
    assert acquire_transport.main([*words, "--force"]) == 0
    assert "163 pictures, 163 exposures, 163 of them from before" in capsys.readouterr().out
    assert calibration.read(tmp_path / "out").calibration.primaries is not None
