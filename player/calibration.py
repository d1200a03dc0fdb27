"""Reads and writes a calibration folder, which holds one room.

The folder holds calibration.toml, transport_*.npz, ambient.exr and mask.png. It may also hold floodlights of the
primaries, and the screen that several cameras share. This module reads the metadata, the ambient picture and the mask;
tools/transport reads the transport matrices. calibration.toml lists every file with its size and SHA-256, and a file
that differs is refused.
"""

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight import viewpoints
from counterlight.arrays import brief
from counterlight.errors import AbsentError, InputError, nearest
from counterlight.files import exr
from counterlight.files.manifest import describe_files, read_steadily, sha256_of, write_toml
from counterlight.files.picture_files import MAX_SIDE, grey, read_picture, write_png
from counterlight.files.reading import MAX_TOML_BYTES, DescribedFiles, Source, opened, parse_toml, read_bytes
from counterlight.files.tables import LONGEST_TEXT, Table
from counterlight.raster import Raster, Region, side_by_side
from counterlight.response import Matrix, RasterResponse, Response, read_response
from counterlight.screen import FILE as SCREEN
from counterlight.screen import MOST_CAMERAS, Screen, parts_of, raster_of, read_screen, write_screen
from counterlight.writing.outputs import check_folder, is_vacant, refuse_strangers
from counterlight.writing.replacing import replacing_folder

FORMAT = 1
TOML, AMBIENT, MASK = "calibration.toml", "ambient.exr", "mask.png"
PRIMARIES = "primary_red.exr", "primary_green.exr", "primary_blue.exr"
LIGHT = "transport_*.npz", "far_light.npz", "blurred_light.npz"
INTERVAL = "interval.npz"
VIEWS = viewpoints.TOML, viewpoints.FOLDER
PARTS = (TOML, AMBIENT, MASK, *PRIMARIES, SCREEN, *LIGHT, INTERVAL, "correction", "placement.toml", "drift", *VIEWS)
MOST_PROJECTORS, LONGEST_PROVENANCE = 64, 1 << 16
# limits of `colour`: tolerance of a row's sum, because text is rounded; least determinant of an invertible matrix
GREY, LEAST_COLOUR = 1e-3, 1e-3
# Limits of white and of radiance, in any unit. Within them, squares and sums over a picture fit float32.
RADIANCE = (1e-12, 1e12)
GAIN = (1e-6, 1e6)  # limits of one camera's light relative to another camera's
REBUILD = (
    "make the calibration again (counterlight acquire, simulate, import-transport, import-graycode or import-pairs)"
)
MAKE = "measure a room with: counterlight acquire, or compute one with: counterlight simulate"


@dataclass(frozen=True)
class Device(Raster):
    """A projector or a camera: its size in pixels and its response.

    response : code value -> light.
    monitor : name of the projector's monitor, if it is known.
    colour : (3, 3), ≥ 0, rows of sum 1, so that grey stays grey. Converts a drive of the primaries that all projectors
        of a raster share into a drive of the projector's own primaries. None if the raster uses the projector's own
        primaries.
    """

    response: Response
    monitor: str | None = None
    colour: Matrix | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.colour is None:
            return
        values = np.array(self.colour)
        unlike_grey = values.shape != (3, 3) or values.min() < 0 or np.abs(values.sum(axis=1) - 1).max() > GREY
        if unlike_grey or abs(np.linalg.det(values)) < LEAST_COLOUR:
            raise InputError(
                f"colour {values.tolist()}: expected three rows of three numbers, none below 0, each of sum 1, "
                "that can be undone; join the projectors again"
            )


@dataclass(frozen=True)
class Calibration:
    """One room as seen by one camera, or by several cameras whose pictures stand below each other.

    name : name of the room.
    provenance : how the calibration was made.
    projectors : one or more; several stand side by side in one raster, in this order from the left.
    camera : output of T and source of the maps: the camera, or the raster of several (counterlight.screen).
    ambient : (camera height, camera width, 3) float32. Radiance with the projector at black.
    mask : (camera height, camera width) bool. The camera pixels that constrain a solution.
    primaries : (3, camera height, camera width, 3) float32. Radiance above ambient with only red, green or blue at full
        drive, as each camera channel sees it (thesis eq. 4.1). None if it was not measured.
    screen : shared by several cameras; None for one camera.
    """

    name: str
    provenance: str
    projectors: tuple[Device, ...]
    camera: Device
    ambient: NDArray[np.float32]
    mask: NDArray[np.bool_]
    primaries: NDArray[np.float32] | None = None
    screen: Screen | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        if len(self.name) > LONGEST_TEXT or len(self.projectors) > MOST_PROJECTORS:
            raise InputError(
                f"{len(self.projectors)} projectors, a name of {len(self.name)} characters: expected at most "
                f"{MOST_PROJECTORS} and {LONGEST_TEXT}"
            )
        _ = self.projector  # raises an error if the raster's size is invalid
        if self.screen is not None and raster_of(self.screen.cameras) != self.camera.shape:
            raise InputError(f"a screen of cameras {self.screen.cameras} for a raster of {self.camera.shape}")
        fix = "subtract less darkness, or give light in another unit"
        _check_light(self.ambient, "ambient light", fix)
        if self.primaries is not None:
            _check_light(self.primaries, "light of the primaries", fix)

    @property
    def projector(self) -> Raster:
        """The source of T: the projector, or the raster of several projectors (docs/displays.md).

        The raster has pixels below smaller projectors that light nothing.
        """
        if len(self.projectors) == 1:
            return self.projectors[0]
        return Raster(*side_by_side([each.shape for each in self.projectors])[0])

    @property
    def response(self) -> RasterResponse:
        """Response of the raster, with each projector's response in its own columns."""
        each = self.projectors
        return RasterResponse(tuple(p.response for p in each), self.regions, tuple(p.colour for p in each))

    @property
    def cameras(self) -> tuple[tuple[int, int], ...]:
        """(height, width) of each camera."""
        return (self.camera.shape,) if self.screen is None else self.screen.cameras

    @property
    def gains(self) -> NDArray[np.float64]:
        """Factor that each camera's light was multiplied by when the cameras were joined, (cameras, 3)."""
        gains = None if self.screen is None else self.screen.gains
        return np.ones((len(self.cameras), 3)) if gains is None else gains

    @property
    def views(self) -> tuple[tuple[slice, slice], ...]:
        """Rows and columns of each camera's picture in the raster."""
        return parts_of(self.cameras)

    def pixels_of(self, number: int) -> NDArray[np.bool_]:
        """Return which pixels of the raster belong to camera `number`, from 0: (camera height, camera width) bool."""
        pixels = np.zeros(self.camera.shape, np.bool_)
        pixels[self.views[number]] = True
        return pixels

    @property
    def placed_on(self) -> tuple[int, int]:
        """(height, width) of the area that holds the picture: the camera's view, or the screen of several cameras."""
        return self.camera.shape if self.screen is None else self.screen.shape

    @property
    def regions(self) -> tuple[Region, ...]:
        """Region of each projector's picture in the raster."""
        return side_by_side([each.shape for each in self.projectors])[1]


@dataclass(frozen=True)
class StoredCalibration:
    """A calibration, its folder, and its identity.

    folder : folder of the calibration.
    calibration : the calibration in it.
    fingerprint : SHA-256 of calibration.toml.
    files : checked access to the folder's files.
    """

    folder: Path
    calibration: Calibration
    fingerprint: str
    files: DescribedFiles

    @contextmanager
    def opened(self, name: str) -> Iterator[BufferedReader]:
        """Yield one of the folder's files, after checking its checksum."""
        try:
            with self.files.opened(self.folder / name) as file:
                yield file
        except InputError:
            self.refuse_replaced()
            raise

    def refuse_replaced(self) -> None:
        """Raise InputError if the folder has been replaced. Files read since then belong to the new calibration."""
        if sha256_of(self.folder / TOML) != self.fingerprint:
            raise InputError(f"{self.folder}: was replaced while it was read; run the command again")


@contextmanager
def replacing(folder: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """Lock the name `folder` for a calibration, and yield a stage for its files. Call this before the long work.

    The whole folder appears at once at the end. Call `write` last.
    Raises InputError if `folder` exists, unless `force` is set and it is a calibration (or empty). Also raises it if
    the folder holds an input or a foreign file, or if another process is writing it.

    folder : the calibration folder to write.
    force : whether an existing calibration may be replaced.
    inputs : paths that the command reads.
    """
    check_folder(folder, inputs=inputs)
    with replacing_folder(folder, lambda path: refuse_existing(path, force=force)) as stage:
        yield stage


@contextmanager
def writing(folder: Path, calibration: Calibration, *, force: bool = False) -> Iterator[Path]:
    """Yield a stage for further files (the transport), then write `calibration`. See `replacing`."""
    with replacing(folder, force=force) as stage:
        yield stage
        write(calibration, stage)


def write(calibration: Calibration, stage: Path) -> None:
    """Write a calibration to a stage that already holds its transport. calibration.toml lists all files."""
    exr.write_rgb(stage / AMBIENT, calibration.ambient)
    write_png(stage / MASK, calibration.mask.astype(np.uint8) * 255)
    if calibration.primaries is not None:
        for file_name, light in zip(PRIMARIES, calibration.primaries, strict=True):
            exr.write_rgb(stage / file_name, light)
    if calibration.screen is not None:
        write_screen(calibration.screen, stage)
    write_toml(stage / TOML, _to_toml(calibration, describe_files(stage)))


def refuse_existing(folder: Path, *, force: bool) -> None:
    """Raise InputError if writing a calibration to `folder` would lose data. Call this before the long work."""
    if is_vacant(folder):
        return
    if not (folder / TOML).is_file() and not viewpoints.is_set(folder):
        raise InputError(f"{folder}: exists and is no calibration folder; choose another name")
    if not force:
        raise InputError(f"{folder}: a calibration is there already; choose another name or replace it with --force")
    refuse_strangers(folder, PARTS, "a calibration")


def read(folder: Path) -> StoredCalibration:
    """Read a calibration folder. Raises InputError for missing or damaged files or another format.

    All data is of one generation, even if another process replaces the folder meanwhile.
    """
    return read_steadily(folder / TOML, lambda: _read(folder))


def _read(folder: Path) -> StoredCalibration:
    with suppress(OSError):  # an inaccessible folder causes an error when its file is read
        if not folder.is_dir():
            if folder.exists():
                raise InputError(f"{folder}: a file, expected a calibration folder; {MAKE}")
            raise AbsentError(f"{folder}: no such folder{_nearest_room(folder)}; {MAKE}")
        if next(folder.iterdir(), None) is None:  # perhaps a disk is mounted here later
            raise AbsentError(f"{folder}: an empty folder, expected a calibration folder; {MAKE}")
    if viewpoints.is_set(folder):
        one = folder / viewpoints.FOLDER / "1"
        raise InputError(f"{folder}: a set of views, expected one calibration; name a view, as {one}")
    path = folder / TOML
    if not path.exists() and next(folder.glob("*.npz"), None) and not next(folder.glob(LIGHT[0]), None):
        raise InputError(
            f"{folder}: matrices without {TOML}; make a calibration of them: counterlight import-transport"
        )
    content = read_bytes(path, MAX_TOML_BYTES, REBUILD)
    table = Table(parse_toml(content, path, REBUILD), f"{path}", REBUILD)
    table.format(FORMAT)
    projectors = _read_projectors(table)
    files = DescribedFiles(folder, table.table("files").values, REBUILD)
    camera, screen = _read_cameras(table, files)
    name, provenance = table.text("name", folder.name), table.text("provenance", "", LONGEST_PROVENANCE)
    ambient, mask = read_light(files, AMBIENT, camera), _read_mask(files, camera)
    try:
        primaries = _read_primaries(files, camera)
        calibration = Calibration(name, provenance, projectors, camera, ambient, mask, primaries, screen)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return StoredCalibration(folder, calibration, hashlib.sha256(content).hexdigest(), files)


def _nearest_room(folder: Path) -> str:
    """Return `; did you mean NAME?` for a room next to a missing folder: the only one, or one of a similar name."""
    if not folder.parent.is_dir():
        return ""
    rooms = [each.name for each in folder.parent.iterdir() if (each / TOML).is_file() or viewpoints.is_set(each)]
    return nearest(folder.name, rooms, 0.5 if len(rooms) > 1 else 0.0)


def read_projectors(folder: Path) -> tuple[Device, ...]:
    """Read the projectors of a calibration or a set of views, without the pictures. Raises InputError for damage."""
    path = (folder / viewpoints.FOLDER / "1" if viewpoints.is_set(folder) else folder) / TOML
    table = Table(parse_toml(read_bytes(path, MAX_TOML_BYTES, REBUILD), path, REBUILD), f"{path}", REBUILD)
    return _read_projectors(table)


def _read_projectors(table: Table) -> tuple[Device, ...]:
    return tuple(_read_projector(entry) for entry in table.tables("projectors", MOST_PROJECTORS))


def check_order(room: Path, others: Iterable[Path | str | None]) -> None:
    """Raise InputError if another argument is the calibration folder instead of `room`."""
    swapped = next((other for other in others if other is not None and (Path(other) / TOML).is_file()), None)
    if swapped is not None and not (room / TOML).exists() and not viewpoints.is_set(room):
        raise InputError(f"{room}: no calibration folder, but {swapped} is one; name the room first")


def read_mask_picture(path: Path, camera: Device) -> NDArray[np.bool_]:
    """Read a grey picture of the camera's size. White pixels (value ≥ 128) belong to the mask."""
    return _mask_of(path, camera)


def _to_toml(calibration: Calibration, files: dict[str, Any]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "name": calibration.name,
        "provenance": calibration.provenance,
        "projectors": [_projector_to_toml(projector) for projector in calibration.projectors],
        **_cameras_to_toml(calibration),
        "files": files,
    }


def _cameras_to_toml(calibration: Calibration) -> dict[str, Any]:
    response = calibration.camera.response
    curve = {} if response == Response("linear") else {"response": response.to_toml()}
    cameras = [{"width": width, "height": height, **curve} for height, width in calibration.cameras]
    if calibration.screen is None:
        return {"camera": cameras[0]}
    height, width = calibration.screen.shape
    matched = [{**camera, "gain": gain.tolist()} for camera, gain in zip(cameras, calibration.gains, strict=True)]
    return {"cameras": matched, "screen": {"width": width, "height": height}}


def _read_cameras(table: Table, files: DescribedFiles) -> tuple[Device, Screen | None]:
    """Return the camera, or the raster of several cameras and their screen."""
    if "cameras" not in table:
        return _read_device(table.table("camera")), None
    entries = table.tables("cameras", MOST_CAMERAS)
    cameras = [_read_device(entry) for entry in entries]
    gains = np.stack([entry.numbers("gain", 3, (1.0,) * 3, *GAIN) for entry in entries])
    shapes = tuple(camera.shape for camera in cameras)
    raster = Device(*raster_of(shapes), cameras[0].response)
    return raster, read_screen(table.table("screen"), files, shapes, gains, REBUILD)


def _projector_to_toml(projector: Device) -> dict[str, Any]:
    response = projector.response
    table: dict[str, Any] = {"width": projector.width, "height": projector.height, "response": response.to_toml()}
    segment = None if response.segment is None else [list(row) for row in response.segment.samples]
    processing = None if response.processing is None else [list(row) for row in response.processing.samples]
    optional: dict[str, object] = {"white_segment": segment, "processing": processing}
    optional |= {"monitor": projector.monitor, "colour": projector.colour}
    return table | {name: value for name, value in optional.items() if value is not None}


def _read_projector(table: Table) -> Device:
    device = _read_device(table)
    if "monitor" in table:
        monitor = table.text("monitor")
        if not monitor:
            raise table.wrong("monitor", 'the name of a monitor, as in monitor = "HDMI-1"')
        device = replace(device, monitor=monitor)
    if "colour" not in table:
        return device
    rows = table.rows("colour", 3, 3, 0.0, 1.0)
    try:
        return replace(device, colour=tuple(tuple(float(value) for value in row) for row in rows))
    except InputError as error:
        raise table.refusal(f", {error}") from None


def _read_device(table: Table) -> Device:
    height, width = (table.integer(key, None, 1, MAX_SIDE) for key in ("height", "width"))
    return Device(height, width, read_response(table))


def read_light(files: DescribedFiles, name: str, camera: Device) -> NDArray[np.float32]:
    """Read a camera picture of light from a described folder. Raises InputError for a wrong size or radiance."""
    light = exr.read_described(files, name, camera.shape, "the camera")
    _check_light(light, f"{files.folder / name}", files.fix)
    return light


def _read_primaries(files: DescribedFiles, camera: Device) -> NDArray[np.float32] | None:
    """Read all three pictures of the primaries, None if none is listed."""
    if not any(name in files for name in PRIMARIES):
        return None
    return np.stack([read_light(files, name, camera) for name in PRIMARIES])


def _check_light(light: NDArray[np.float32], where: str, fix: str = REBUILD) -> None:
    """Raise InputError for invalid radiance. Noise may make values negative, down to minus the upper limit."""
    low, high = float(light.min()), float(light.max())
    if not (-high <= low and high <= RADIANCE[1]):  # `not`, because a comparison with NaN is false
        raise InputError(
            f"{where}: radiance from {low:g} to {high:g}, expected numbers from 0 (a little noise below) to "
            f"{RADIANCE[1]:g}; {fix}"
        )


def _read_mask(files: DescribedFiles, camera: Device) -> NDArray[np.bool_]:
    with files.opened(files.folder / MASK) as file:
        return _mask_of(file, camera)


def _mask_of(source: Source, camera: Device) -> NDArray[np.bool_]:
    with opened(source, "check the path") as file:
        picture = grey(read_picture(file, camera.pixels))
        if picture.shape != camera.shape:
            found = f"{picture.shape[1]}x{picture.shape[0]}"
            raise InputError(
                f"{file.name}: {found}, the camera is {camera.width}x{camera.height}; save it at the camera's size"
            )
        return np.asarray(picture > np.iinfo(picture.dtype).max // 2)
