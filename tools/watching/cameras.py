"""The cameras of the watcher: live cameras, the newest file of a folder, and a simulated room."""

import os
import queue
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Protocol

import numpy as np

from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.passes.encode import encoded
from counterlight.raster import Shape
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.tools.acquisition.cameras.folder import ANY_CASE
from counterlight.tools.acquisition.cameras.live import CameraDevice
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, simulated_rooms
from counterlight.tools.acquisition.cameras.together import JoinedDevices, together
from counterlight.tools.acquisition.photographer import check_sizes
from counterlight.tools.acquisition.rig import open_device, parted
from counterlight.tools.hdr.photographs import read_photograph
from counterlight.tools.watching.view import repeating
from counterlight.unattended.watch_link import Picture, Start

KINDS = "v4l2:NUMBER, pylon:SERIAL|N, simulated:SCENE|CALIBRATION or folder:DIR"
LIVE = "v4l2", "pylon"
POLL_S = 0.01
SILENT_S = 5.0  # without a new file
BRIEF_S = 1e-4  # exposure of a simulated camera


class WatchCamera(Protocol):
    """A camera whose frames arrive by themselves.

    exposures : conversion of shots to radiance.
    exposure_s : duration of an exposure; None if it is unknown.
    follows : whether each capture shows exactly one picture that the player has sent.
    """

    @property
    def exposures(self) -> Exposures: ...
    @property
    def exposure_s(self) -> float | None: ...
    @property
    def follows(self) -> bool: ...
    def arrival(self) -> float:
        """Wait for the next frame, and return the time of its arrival. Raises InputError if none comes."""

    def shot(self) -> Shot:
        """Read the frame that has arrived last."""

    def show(self, picture: Picture) -> None:
        """Take a displayed picture, for cameras that are simulated."""


class LiveFrames:
    """The frames of one or more live cameras, (height, width) or (height, width, 3) for all of them together."""

    follows = False

    def __init__(self, device: CameraDevice, exposures: Exposures) -> None:
        self._device, self.exposures, self.exposure_s = device, exposures, exposures.shortest
        device.expose(exposures.shortest)

    def arrival(self) -> float:
        self._device.skip()
        return time.monotonic()

    def shot(self) -> Shot:
        return self._device.last()

    def show(self, picture: Picture) -> None:
        """Does nothing: the camera sees the projector."""


class NewestFile:
    """The newest photograph in a folder, as soon as it appears. Files whose name starts with a dot are incomplete.

    shape : (height, width) that photographs have.
    """

    follows = False

    def __init__(self, folder: Path, exposures: Exposures, exposure_s: float | None, shape: Shape) -> None:
        self._folder, self._shape, self.exposures, self.exposure_s = folder, shape, exposures, exposure_s
        self._seen_ns, self._path = time.time_ns(), folder
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder; name the folder that another program writes captures to")

    def arrival(self) -> float:
        """Wait for a new file. Raises InputError or OSError; files may vanish at any time."""
        deadline = time.monotonic() + SILENT_S
        while time.monotonic() < deadline:
            with os.scandir(self._folder) as entries:
                files = [each for each in entries if Path(each.name).suffix in ANY_CASE and each.name[0] != "."]
                written, path = max(((each.stat().st_mtime_ns, each.path) for each in files), default=(0, ""))
            if written > self._seen_ns:
                self._seen_ns, self._path = written, Path(path)
                return time.monotonic() - (time.time_ns() - written) * 1e-9
            time.sleep(POLL_S)
        raise InputError(f"{self._folder}: no new photograph for {SILENT_S:.0f} s")

    def shot(self) -> Shot:
        shot = read_photograph(self._path)
        if shot.shape[:2] != self._shape:
            (height, width), (rows, columns) = shot.shape[:2], self._shape
            raise InputError(f"{self._path}: {width}x{height} pixels, the calibration's camera has {columns}x{rows}")
        return shot

    def show(self, picture: Picture) -> None:
        """Does nothing: another program photographs."""


class SimulatedFrames:
    """A simulated room under the newest pictures that the player sends; a picture gives at most one capture."""

    exposure_s, follows = BRIEF_S, True

    def __init__(self, room: Calibration, camera: SimulatedCamera, factor: int) -> None:
        self._room, self._camera, self._repeat = room, camera, repeating(room, factor)
        self.exposures, self._pictures = camera.exposures, queue.Queue[Picture](maxsize=2)
        self._number = 0
        camera.device.expose(camera.exposures.shortest)

    def arrival(self) -> float:
        try:
            picture = self._pictures.get(timeout=SILENT_S)
        except queue.Empty:
            raise InputError("the simulated camera: the player has sent no picture") from None
        self._number += 1
        whole = self._repeat @ picture.drive.reshape(-1, 3).astype(np.float64)
        self._camera.screen.show(encoded(whole.reshape(*self._room.projector.shape, 3), self._room.response))
        return picture.time_s + BRIEF_S

    def shot(self) -> Shot:
        self._camera.device.begin(self._number)
        return self._camera.device.frame()

    def show(self, picture: Picture) -> None:
        """Add a picture; if captures take longer than pictures, the oldest one has no capture."""
        if self._pictures.full():
            with suppress(queue.Empty):
                self._pictures.get_nowait()
        self._pictures.put(picture)


@contextmanager
def open_cameras(start: Start, room: Calibration) -> Iterator[WatchCamera]:
    """Open the cameras of --watch. Raises InputError for missing or unsuitable cameras."""
    words = [parted(camera) for camera in start.cameras]
    for camera, (kind, source) in zip(start.cameras, words, strict=True):
        if kind not in (*LIVE, "simulated", "folder") or not source:
            raise InputError(f"--watch {camera}: expected {KINDS}")
        if len(words) > 1 and (kind not in LIVE):
            raise InputError(f"--watch {camera}: cannot watch together with others")
    exposures = Exposures((min(start.exposures, default=1.0),), room.camera.response)
    kind, source = words[0]
    with ExitStack() as opened:
        if kind == "simulated":
            rooms = simulated_rooms(Path(source))
            settings = CameraSettings(exposures=exposures.times, response=exposures.response)
            yield SimulatedFrames(room, SimulatedCamera(rooms[0], settings, None, rooms[1:]), start.factor)
        elif kind == "folder":
            yield NewestFile(Path(source), exposures, min(start.exposures, default=None), room.camera.shape)
        else:
            if not start.exposures:
                raise InputError(f"--watch {start.cameras[0]}: needs the exposure of the calibration; add --exposures")
            device = together([open_device(*each, exposures.response, opened) for each in words])
            views = device.views if isinstance(device, JoinedDevices) else (device.frame().shape[:2],)
            check_sizes(views, room, "--watch")
            yield LiveFrames(device, exposures)
