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
from counterlight.tools.acquisition.cameras.machine_vision import MachineVisionDevice, open_machine_vision_device
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
def device() -> Iterator[MachineVisionDevice]:
    with open_machine_vision_device("0815-0001") as opened:
        yield opened


def set_to(device: MachineVisionDevice, **settings: str) -> None:
    """Change settings of the emulation, which accepts them only between frames."""
    device._camera.StopGrabbing()
    for name, value in settings.items():
        device._camera.GetNodeMap().GetNode(name).FromString(value)
    device._camera.StartGrabbing(device._pylon.GrabStrategy_OneByOne)


def look_at(device: MachineVisionDevice, path: Path, sites: np.ndarray) -> None:
    """Make the emulation's next frames show `sites`, (height, width), uint16.

    The emulation keeps the bits of its format.
    """
    assert cv2.imwrite(str(path), sites)
    height, width = sites.shape
    files = {"TestImageSelector": "Off", "ImageFilename": str(path), "ImageFileMode": "On"}
    set_to(device, Width=str(width), Height=str(height), ExposureTimeAbs=str(round(1e6 * SHUTTER_S)), **files)


def setting(device: MachineVisionDevice, name: str) -> str:
    return str(device._camera.GetNodeMap().GetNode(name).ToString())


def test_a_camera_is_found_by_serial_or_number() -> None:
    for wanted, name in (("0815-0000", "0815-0000"), ("0", "0815-0000"), ("1", "0815-0001")):
        with open_machine_vision_device(wanted) as opened:
            assert opened.name == f"pylon Emulation {name}"
    with (
        pytest.raises(
            InputError, match=r"pylon:7: no such camera, found: 0: Emulation 0815-0000, 1: Emulation 0815-0001;"
        ),
        open_machine_vision_device("7"),
    ):
        pass


def test_what_it_does_by_itself_is_off(device: MachineVisionDevice) -> None:
    for name in ("ExposureAuto", "GainAuto"):
        assert setting(device, name) == "Off"
    assert setting(device, "AcquisitionFrameRateEnable") == "0"
    assert float(setting(device, "Gamma")) == 1
    assert float(setting(device, "Gain")) == float(setting(device, "BlackLevel")) == 0
    assert (setting(device, "TriggerSelector"), setting(device, "TriggerMode")) == ("FrameStart", "On")
    assert setting(device, "TriggerSource") == "Software"
    assert setting(device, "PixelFormat") in {f"Bayer{first}12" for first in machine_vision.MOSAICS}


def test_a_setting_that_it_keeps_is_refused(device: MachineVisionDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    class Stubborn:
        def ToString(self) -> str:  # noqa: N802
            return "Continuous"

        def FromString(self, value: str) -> None:  # noqa: N802
            pass

    monkeypatch.setattr(device, "_node", lambda name: Stubborn())
    with pytest.raises(InputError, match="0815-0001: keeps GainAuto at Continuous, expected Off; set it by hand"):
        device._set("GainAuto", "Off")


def test_exposures_are_seconds(device: MachineVisionDevice) -> None:
    device.expose(1 / 60)
    assert float(setting(device, "ExposureTime")) == pytest.approx(1e6 / 60, abs=1)  # in microseconds
    with pytest.raises(InputError, match=r"no exposure of 100 s, its range is 1e-06 to 10 s"):
        device.expose(100)


@pytest.mark.parametrize("first", machine_vision.MOSAICS)
def test_all_twelve_bits_of_each_colour_arrive(
    device: MachineVisionDevice, rng: np.random.Generator, tmp_path: Path, first: str
) -> None:
    set_to(device, PixelFormat=f"Bayer{first}12")
    device._colours, device._bits = np.array(machine_vision.MOSAICS[first]), 12
    light = rng.integers(0, 4095, (24, 32, 3))
    sites = np.zeros((48, 64), np.uint16)
    for y, x in np.ndindex(2, 2):
        sites[y::2, x::2] = 16 * light[..., machine_vision.MOSAICS[first][y][x]]
    look_at(device, tmp_path / "wall.png", sites)
    shot = device.frame()
    assert shot.dtype == np.uint16
    assert np.abs(shot - light * (TOP / 4095)).max() <= HALF


def test_clipped_sites_and_grey_cameras(device: MachineVisionDevice, rng: np.random.Generator, tmp_path: Path) -> None:
    sites = rng.integers(0, 40000, (48, 64)).astype(np.uint16)
    sites[5, 7] = 65535
    look_at(device, tmp_path / "wall.png", sites)
    clipped = Exposures().saturated([device.frame()])
    assert np.array_equal(np.argwhere(clipped), [[2, 3]])
    device._colours = None
    assert np.abs(device.frame() - (sites >> 4) * (TOP / 4095)).max() <= HALF


def test_each_frame_is_one_that_began_after_it_was_asked_for(device: MachineVisionDevice, tmp_path: Path) -> None:
    for value in (4000, 16000, 32000, 8000):
        look_at(device, tmp_path / f"{value}.png", np.full((32, 48), value, np.uint16))
        assert np.abs(device.frame() - (value >> 4) * (TOP / 4095)).max() <= HALF


def test_a_frame_that_is_lost_on_its_way_is_taken_again(device: MachineVisionDevice, tmp_path: Path) -> None:
    look_at(device, tmp_path / "wall.png", np.full((32, 48), 16000, np.uint16))

    def lose(frames: int) -> None:
        nodes = device._camera.GetNodeMap()
        nodes.GetNode("ForceFailedBufferCount").Value = frames
        nodes.GetNode("ForceFailedBuffer").Execute()

    lose(2)
    assert device.frame().max() > 0
    lose(3)
    with pytest.raises(
        InputError, match=r"0815-0001: 3 frames in a row were damaged \(.*\); try another cable or port"
    ):
        device.frame()


def test_a_camera_that_gives_nothing_is_one_line(device: MachineVisionDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_vision, "ANSWER_S", 0.2)
    set_to(device, ExposureTimeAbs="3000000")  # microseconds until the emulation answers
    with pytest.raises(InputError, match=r"0815-0001: gives no more frames; plug it in again and run the same"):
        device.frame()


def test_an_unplugged_camera_is_one_line(device: MachineVisionDevice) -> None:
    device._camera.Close()  # an emulated camera cannot be unplugged
    for act in (device.frame, device.skip, lambda: device.expose(0.01)):
        with pytest.raises(InputError, match=r"0815-0001: is unplugged; plug it in again and run the same command"):
            act()


def test_another_programs_camera_is_one_line(device: MachineVisionDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(camera: object) -> None:
        raise device._genicam.AccessException("The device is controlled by another application. : thrown (file 'x')")

    monkeypatch.setattr(device._pylon.InstantCamera, "Open", refuse)  # the emulation can be opened twice
    with (
        pytest.raises(
            InputError, match=r"0000: cannot be opened \(.*controlled by another application\); close the pro"
        ),
        open_machine_vision_device("0"),
    ):
        pass


class PaintedScreen:
    """A screen that passes its picture, as a simulated sensor sees it, to the emulated camera."""

    refresh_hz: float | None = None

    def __init__(self, device: MachineVisionDevice, room: SimulatedRoom, folder: Path) -> None:
        self._device, self._folder, self._sensor = device, folder, SimulatedCamera(room, replace(NOISY, seed=3))
        self.shape, self._shown = room.projector, 0

    def show(self, codes: Codes) -> None:
        self._shown += 1
        self._sensor.screen.show(codes)
        self._sensor.device.begin(self._shown)
        self._sensor.device.expose(self._sensor.exposures.times[0])
        shot = self._sensor.device.frame()
        look_at(self._device, self._folder / f"{self._shown}.png", mosaic_of(shot.astype(np.float64)))


def test_an_acquisition_through_it(device: MachineVisionDevice, rng: np.random.Generator, tmp_path: Path) -> None:
    room = room_of(sharp_wall(rng))
    set_to(device, PixelFormat="BayerRG12")
    device._colours = np.reshape(RGGB, (2, 2))
    screen = PaintedScreen(device, room, tmp_path)
    camera = LiveCamera(screen, device, Exposures((SHUTTER_S,)))
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
