"""The checks before an acquisition: a rig without faults passes, and each fault gets its own advice."""

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from scipy import sparse

from counterlight.errors import InputError
from counterlight.tools.acquisition.cameras.camera import LINEAR, Shot
from counterlight.tools.acquisition.cameras.simulated import SimulatedCamera, SimulatedRoom
from counterlight.tools.acquisition.cameras.tethered import open_tethered_device, shutter_time
from counterlight.tools.acquisition.cameras.video import VideoDevice
from counterlight.tools.acquisition.cameras.window import projector_monitor
from counterlight.tools.acquisition.plan import Codes
from counterlight.tools.acquisition.preflight import CHECKS, Finding, preflight
from counterlight.tools.transport.transport import Transport
from tests.acquired_rooms import CAMERA, NOISY, PROJECTOR, SHAPE, room_of, sharp_wall


@pytest.fixture
def room(rng: np.random.Generator) -> SimulatedRoom:
    return room_of(sharp_wall(rng))


def findings(camera: SimulatedCamera) -> dict[str, Finding]:
    return {finding.check: finding for finding in preflight(camera)}


class Faulty(SimulatedCamera):
    """A simulated camera whose pictures (before projection) or shots are changed.

    shown : changes the codes of a picture.
    seen : changes a shot, given the number of frames since the picture changed.
    """

    def __init__(
        self,
        room: SimulatedRoom,
        *,
        shown: Callable[[Codes], Codes] = lambda codes: codes,
        seen: Callable[[Shot, int], Any] = lambda shot, since: shot,
    ) -> None:
        super().__init__(room, NOISY)
        frame, skip, show = self.device.frame, self.device.skip, self.screen.show
        self.since, self.mean = 0, -1.0

        def counted_skip() -> None:  # a frame skips one frame, too
            self.since += 1
            skip()

        def changed_show(codes: Codes) -> None:
            self.since = self.since if codes.mean() == self.mean else 0
            self.mean = codes.mean()
            show(shown(codes))

        self.device.skip, self.screen.show = counted_skip, changed_show  # type: ignore[method-assign]
        self.device.frame = lambda: np.clip(seen(frame(), self.since), 0, 65535).astype(np.uint16)  # type: ignore[method-assign]


@pytest.mark.parametrize("lag", [0, 1, 4])
def test_a_sound_rig_passes_and_its_lag_is_found(room: SimulatedRoom, lag: int) -> None:
    camera = SimulatedCamera(room, replace(NOISY, lag=lag))
    camera.lag = 0  # the lag is unknown at first
    found = findings(camera)
    assert len(found) == len(CHECKS)
    assert {finding.grade for finding in found.values()} == {"good"}
    assert camera.lag == lag + 1
    assert f"{lag} to {lag} frames" in found["latency"].sentence


@pytest.mark.parametrize("bracket", [(1.0, 4.0), (4.0, 1.0), (4.0, 1.0, 2.0)])
def test_a_bracket_may_come_in_any_order(room: SimulatedRoom, bracket: tuple[float, ...]) -> None:
    """The shortest exposure measures light that saturates the longer exposures."""
    found = findings(SimulatedCamera(room, replace(NOISY, exposures=bracket)))
    assert [finding.grade for finding in found.values()] == ["good"] * len(CHECKS)


def test_captures_with_the_lag_that_was_found_are_those_without_lag(room: SimulatedRoom) -> None:
    late, direct = SimulatedCamera(room, replace(NOISY, lag=3)), SimulatedCamera(room, NOISY)
    late.lag = 0
    findings(late)
    for number in range(4):
        pattern = np.full(PROJECTOR, number % 2 == 0)
        np.testing.assert_array_equal(late.capture(number, pattern), direct.capture(number, pattern))


def automatic(shot: Shot, _: int) -> Any:
    """Model an automatic exposure that gives all bright pictures the same mean at once."""
    return shot * (20000.0 / shot.mean() if shot.mean() > 5000 else 1.0)


def weakly_curved(shot: Shot, _: int) -> Any:
    """Model a curve of so little contrast that half the exposure time gives nearly half the light."""
    light = shot / 65535.0
    return 65535 * (0.6 * light + 0.4 * light * light * (3 - 2 * light))


def white_segment(codes: Codes) -> Codes:
    """Model a white segment: a colour alone has two thirds of the light that it has within white."""
    grey = np.all(codes == codes[..., :1], axis=2, keepdims=True)
    return np.where(grey, codes, codes // 3 * 2).astype(np.uint8)


def vivid(codes: Codes) -> Codes:
    """Model colour processing: grey has four fifths of the light of its red, green and blue."""
    grey = np.all(codes == codes[..., :1], axis=2, keepdims=True)
    return np.where(grey, codes // 5 * 4, codes).astype(np.uint8)


def dimming(codes: Codes) -> Codes:
    """Model dynamic contrast: the lamp dims with the picture's mean."""
    return np.asarray(codes * (0.7 + 0.3 * codes.mean() / 255), np.uint8)


class Stale:
    """A projector that, after 13 pictures, shows every third picture only when the next one comes."""

    def __init__(self) -> None:
        self.last, self.count = np.zeros((*PROJECTOR, 3), np.uint8), 0

    def __call__(self, codes: Codes) -> Codes:
        self.count += 1
        shown = self.last if self.count > 13 and self.count % 3 == 0 else codes
        self.last = codes
        return shown


@pytest.mark.parametrize(
    ("fault", "check", "advice"),
    [
        ({"shown": np.zeros_like}, "projector", "changes .* of the camera's picture: switch the projector on"),
        ({"seen": lambda shot, _: shot * 3.0}, "saturation", "are at the top: expose less"),
        ({"seen": lambda shot, _: shot * 0.1}, "saturation", "white reaches .* of the range: expose longer"),
        ({"seen": lambda shot, _: shot * 0.5 + 20000.0}, "ambient", "switch lamps off"),
        ({"seen": automatic}, "exposure", "the camera ignores it"),
        ({"shown": Stale()}, "own pattern", "captures show another picture than projected"),
        ({"seen": lambda shot, since: shot * (1 + 0.02 * (since % 3 - 1))}, "flicker", "expose for a multiple"),
        (
            {"seen": lambda shot, _: 65535 * (shot / 65535.0) ** (1 / 1.2)},
            "linearity",
            "have a curve, as JPEGs and webcams",
        ),
        ({"seen": weakly_curved}, "linearity", "have a contrast curve, or the projector resamples"),
        ({"shown": white_segment}, "additivity", "differ from white by .*: switch off the projector's white segment"),
        ({"shown": dimming}, "additivity", "(dynamic contrast|white segment)"),
    ],
)
def test_each_fault_has_its_advice(room: SimulatedRoom, fault: dict[str, Any], check: str, advice: str) -> None:
    finding = findings(Faulty(room, **fault))[check]
    assert finding.grade != "good"
    assert re.search(advice, finding.sentence)
    assert "\n" not in str(finding)


@pytest.mark.parametrize("shown", [white_segment, vivid])
def test_what_the_acquisition_takes_out_does_not_stop_it(room: SimulatedRoom, shown: Callable[[Codes], Codes]) -> None:
    assert findings(Faulty(room, shown=shown))["additivity"].grade == "doubtful"


def test_a_drifting_white_balance_is_distinguished_from_a_drifting_exposure(room: SimulatedRoom) -> None:
    for factor, advice in ((np.array([1, 1, 0.99]), "white balance"), (np.full(3, 0.99), "exposure and gain")):
        drifting = Faulty(room, seen=lambda shot, since, factor=factor: shot * factor ** min(since, 20))
        assert advice in findings(drifting)["locked"].sentence


def test_a_dark_room_has_no_projector() -> None:
    dark = Transport.from_matrices((sparse.csr_array(SHAPE, dtype=np.float32),) * 3)
    found = findings(SimulatedCamera(room_of(dark, ambient=0.2), NOISY))
    assert list(found) == ["projector"]
    assert found["projector"].grade == "bad"


# Video and still cameras. A stand-in that keeps settings replaces OpenCV and the driver.


class Driver:
    """A video camera's settings. Settings in `stubborn` never change."""

    def __init__(self, stubborn: tuple[int, ...] = ()) -> None:
        self.settings: dict[int, float] = {cv2.CAP_PROP_AUTO_EXPOSURE: 3.0, cv2.CAP_PROP_AUTO_WB: 1.0}
        self.settings[cv2.CAP_PROP_EXPOSURE] = 156.0
        self.stubborn, self.frames = stubborn, 3

    def get(self, prop: int) -> float:
        return self.settings.get(prop, 0.0)

    def set(self, prop: int, value: float) -> bool:
        if prop not in self.stubborn:
            self.settings[prop] = value
        return True  # drivers report success here

    def grab(self) -> bool:
        self.frames -= 1
        return self.frames >= 0

    def retrieve(self) -> tuple[bool, Shot]:
        picture = np.zeros((*CAMERA, 3), np.uint8)
        picture[..., 0] = 200  # blue in OpenCV's order
        return self.frames >= 0, picture


def test_a_video_camera_is_set_by_hand() -> None:
    driver = Driver()
    device = VideoDevice("/dev/video0", driver)
    assert driver.settings[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    assert driver.settings[cv2.CAP_PROP_AUTO_WB] == 0
    device.expose(1 / 60)
    assert driver.settings[cv2.CAP_PROP_EXPOSURE] == 167  # units of 100 µs
    assert device.frame()[0, 0].tolist() == [0, 0, 200]
    device.skip()
    device.skip()
    with pytest.raises(InputError, match="gives no more frames"):
        device.frame()


@pytest.mark.parametrize(
    ("prop", "message"),
    [
        (cv2.CAP_PROP_AUTO_EXPOSURE, "keeps its automatic exposure on; set it with v4l2-ctl"),
        (cv2.CAP_PROP_AUTO_WB, "keeps its automatic white balance on"),
        (cv2.CAP_PROP_EXPOSURE, r"asked for an exposure of 0\.05 s, it is at 0\.0156 s"),
    ],
)
def test_a_video_camera_that_ignores_a_setting_is_refused(prop: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        VideoDevice("/dev/video0", Driver((prop,))).expose(0.05)


def test_shutter_times() -> None:
    assert [shutter_time(choice) for choice in ("1/250", "0.3", "2s", "bulb", "0")] == [0.004, 0.3, 2.0, None, None]


def test_without_its_package_gphoto2_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gphoto2", None)
    with pytest.raises(InputError, match=r"pip install 'counterlight\[gphoto2\]'"), open_tethered_device(LINEAR):
        pass


def test_the_desktop_is_no_projector() -> None:
    from counterlight.gl.monitors import Monitor

    desktop, projector = Monitor(0, "eDP", 9, 9, 60, 0, 0, True), Monitor(1, "HDMI", 9, 9, 60, 9, 0, False)
    assert projector_monitor([desktop, projector], "HDMI", desktop=False) is projector
    with pytest.raises(InputError, match=r"monitor eDP is the desktop itself; .* found: 1 HDMI"):
        projector_monitor([desktop, projector], "0", desktop=False)
    assert projector_monitor([desktop], "0", desktop=True) is desktop
