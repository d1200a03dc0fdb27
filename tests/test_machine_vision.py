"""Machine-vision cameras, tested with pylon's emulation of two cameras. Files replace the light."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.tools import acquire_transport
from counterlight.tools.acquisition.cameras import machine_vision
from counterlight.tools.acquisition.cameras.camera import Exposures
from counterlight.tools.acquisition.cameras.live import LiveCamera
from counterlight.tools.acquisition.cameras.machine_vision import MachineVisionEye, open_machine_vision_eye
from counterlight.tools.acquisition.cameras.simulated import SimulatedCamera, SimulatedRoom
from counterlight.tools.acquisition.plan import Codes
from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme
from counterlight.tools.hdr.raw_files import TOP
from tests.acquired_rooms import CAMERA, NOISY, PROJECTOR, room_of, run, sharp_wall
from tests.dng import RGGB, mosaic_of

pytestmark = pytest.mark.skipif(
    subprocess.run([sys.executable, "-c", "import pypylon"], capture_output=True, check=False).returncode != 0,
    reason="pypylon is not installed: pip install 'counterlight[pylon]'",
)
HALF = 0.5 + 1 / 128  # code values: rounding of a float32
SHUTTER_S = 0.0001  # the emulation takes this long per frame


@pytest.fixture(autouse=True)
def emulation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYLON_CAMEMU", "2")


@pytest.fixture
def eye() -> Iterator[MachineVisionEye]:
    with open_machine_vision_eye("0815-0001") as opened:
        yield opened


def set_to(eye: MachineVisionEye, **settings: str) -> None:
    """Change settings of the emulation, which accepts them only between frames."""
    eye._camera.StopGrabbing()
    for name, value in settings.items():
        eye._camera.GetNodeMap().GetNode(name).FromString(value)
    eye._camera.StartGrabbing(eye._pylon.GrabStrategy_OneByOne)


def look_at(eye: MachineVisionEye, path: Path, sites: np.ndarray) -> None:
    """Make the emulation's next frames show `sites`, (height, width), uint16.

    The emulation keeps the bits of its format.
    """
    assert cv2.imwrite(str(path), sites)
    height, width = sites.shape
    files = {"TestImageSelector": "Off", "ImageFilename": str(path), "ImageFileMode": "On"}
    set_to(eye, Width=str(width), Height=str(height), ExposureTimeAbs=str(round(1e6 * SHUTTER_S)), **files)


def setting(eye: MachineVisionEye, name: str) -> str:
    return str(eye._camera.GetNodeMap().GetNode(name).ToString())


def test_a_camera_is_found_by_serial_or_number() -> None:
    for wanted, name in (("0815-0000", "0815-0000"), ("0", "0815-0000"), ("1", "0815-0001")):
        with open_machine_vision_eye(wanted) as opened:
            assert opened.name == f"pylon Emulation {name}"
    with (
        pytest.raises(
            InputError, match=r"pylon:7: no such camera, found: 0: Emulation 0815-0000, 1: Emulation 0815-0001;"
        ),
        open_machine_vision_eye("7"),
    ):
        pass


def test_what_it_does_by_itself_is_off(eye: MachineVisionEye) -> None:
    for name in ("ExposureAuto", "GainAuto"):
        assert setting(eye, name) == "Off"
    assert setting(eye, "AcquisitionFrameRateEnable") == "0"
    assert float(setting(eye, "Gamma")) == 1
    assert float(setting(eye, "Gain")) == float(setting(eye, "BlackLevel")) == 0
    assert (setting(eye, "TriggerSelector"), setting(eye, "TriggerMode")) == ("FrameStart", "On")
    assert setting(eye, "TriggerSource") == "Software"
    assert setting(eye, "PixelFormat") in {f"Bayer{first}12" for first in machine_vision.MOSAICS}


def test_a_setting_that_it_keeps_is_refused(eye: MachineVisionEye, monkeypatch: pytest.MonkeyPatch) -> None:
    class Stubborn:
        def ToString(self) -> str:  # noqa: N802
            return "Continuous"

        def FromString(self, value: str) -> None:  # noqa: N802
            pass

    monkeypatch.setattr(eye, "_node", lambda name: Stubborn())
    with pytest.raises(InputError, match="0815-0001: keeps GainAuto at Continuous, expected Off; set it by hand"):
        eye._set("GainAuto", "Off")


def test_exposures_are_seconds(eye: MachineVisionEye) -> None:
    eye.expose(1 / 60)
    assert float(setting(eye, "ExposureTime")) == pytest.approx(1e6 / 60, abs=1)  # in microseconds
    with pytest.raises(InputError, match=r"no exposure of 100 s, its range is 1e-06 to 10 s"):
        eye.expose(100)


@pytest.mark.parametrize("first", machine_vision.MOSAICS)
def test_all_twelve_bits_of_each_colour_arrive(
    eye: MachineVisionEye, rng: np.random.Generator, tmp_path: Path, first: str
) -> None:
    set_to(eye, PixelFormat=f"Bayer{first}12")
    eye._colours, eye._bits = np.array(machine_vision.MOSAICS[first]), 12
    light = rng.integers(0, 4095, (24, 32, 3))
    sites = np.zeros((48, 64), np.uint16)
    for y, x in np.ndindex(2, 2):
        sites[y::2, x::2] = 16 * light[..., machine_vision.MOSAICS[first][y][x]]
    look_at(eye, tmp_path / "wall.png", sites)
    shot = eye.frame()
    assert shot.dtype == np.uint16
    assert np.abs(shot - light * (TOP / 4095)).max() <= HALF


def test_clipped_sites_and_grey_cameras(eye: MachineVisionEye, rng: np.random.Generator, tmp_path: Path) -> None:
    sites = rng.integers(0, 40000, (48, 64)).astype(np.uint16)
    sites[5, 7] = 65535
    look_at(eye, tmp_path / "wall.png", sites)
    clipped = Exposures().saturated([eye.frame()])
    assert np.array_equal(np.argwhere(clipped), [[2, 3]])
    eye._colours = None
    assert np.abs(eye.frame() - (sites >> 4) * (TOP / 4095)).max() <= HALF


def test_each_frame_is_one_that_began_after_it_was_asked_for(eye: MachineVisionEye, tmp_path: Path) -> None:
    for value in (4000, 16000, 32000, 8000):
        look_at(eye, tmp_path / f"{value}.png", np.full((32, 48), value, np.uint16))
        assert np.abs(eye.frame() - (value >> 4) * (TOP / 4095)).max() <= HALF


def test_a_frame_that_is_lost_on_its_way_is_taken_again(eye: MachineVisionEye, tmp_path: Path) -> None:
    look_at(eye, tmp_path / "wall.png", np.full((32, 48), 16000, np.uint16))

    def lose(frames: int) -> None:
        nodes = eye._camera.GetNodeMap()
        nodes.GetNode("ForceFailedBufferCount").Value = frames
        nodes.GetNode("ForceFailedBuffer").Execute()

    lose(2)
    assert eye.frame().max() > 0
    lose(3)
    with pytest.raises(
        InputError, match=r"0815-0001: 3 frames in a row were damaged \(.*\); try another cable or port"
    ):
        eye.frame()


def test_a_camera_that_gives_nothing_is_one_line(eye: MachineVisionEye, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_vision, "ANSWER_S", 0.2)
    set_to(eye, ExposureTimeAbs="3000000")  # microseconds until the emulation answers
    with pytest.raises(InputError, match=r"0815-0001: gives no more frames; plug it in again and run the same"):
        eye.frame()


def test_an_unplugged_camera_is_one_line(eye: MachineVisionEye) -> None:
    eye._camera.Close()  # an emulated camera cannot be unplugged
    for act in (eye.frame, eye.skip, lambda: eye.expose(0.01)):
        with pytest.raises(InputError, match=r"0815-0001: is unplugged; plug it in again and run the same command"):
            act()


def test_another_programs_camera_is_one_line(eye: MachineVisionEye, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(camera: object) -> None:
        raise eye._genicam.AccessException("The device is controlled by another application. : thrown (file 'x')")

    monkeypatch.setattr(eye._pylon.InstantCamera, "Open", refuse)  # the emulation can be opened twice
    with (
        pytest.raises(
            InputError, match=r"0000: cannot be opened \(.*controlled by another application\); close the pro"
        ),
        open_machine_vision_eye("0"),
    ):
        pass


class PaintedScreen:
    """A screen that passes its picture, as a simulated sensor sees it, to the emulated camera."""

    refresh_hz: float | None = None

    def __init__(self, eye: MachineVisionEye, room: SimulatedRoom, folder: Path) -> None:
        self._eye, self._folder, self._sensor = eye, folder, SimulatedCamera(room, replace(NOISY, seed=3))
        self.shape, self._shown = room.projector, 0

    def show(self, codes: Codes) -> None:
        self._shown += 1
        self._sensor.screen.show(codes)
        self._sensor.eye.begin(self._shown)
        self._sensor.eye.expose(self._sensor.exposures.times[0])
        shot = self._sensor.eye.frame()
        look_at(self._eye, self._folder / f"{self._shown}.png", mosaic_of(shot.astype(np.float64)))


def test_an_acquisition_through_it(eye: MachineVisionEye, rng: np.random.Generator, tmp_path: Path) -> None:
    room = room_of(sharp_wall(rng))
    set_to(eye, PixelFormat="BayerRG12")
    eye._colours = np.reshape(RGGB, (2, 2))
    screen = PaintedScreen(eye, room, tmp_path)
    camera = LiveCamera(screen, eye, Exposures((SHUTTER_S,)))
    found = run(room, MultiplexedScheme(), camera=camera)
    assert found.room.floodlight.shape == (*CAMERA, 3)
    assert found.check.error < 0.05  # noise is 1 %; rounding to 12 bits adds less


def test_the_command_names_what_it_lacks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    size = f"{PROJECTOR[1]}x{PROJECTOR[0]}"
    command = ["--window", "--projector", size, "--exposures", "0.01", "-o", str(tmp_path / "room")]

    def refused(*camera: Any) -> str:
        assert acquire_transport.main([*camera, *command]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        return str(line)

    assert "pylon:9: no such camera, found: 0: Emulation" in refused("--camera", "pylon:9")
    assert "expected simulated:SCENE|CALIBRATION" in refused("--camera", "pylon:")
    monkeypatch.setitem(sys.modules, "pypylon", None)
    assert "pip install 'counterlight[pylon]'" in refused("--camera", "pylon:0")
