"""A calibration folder: one room, one camera position (calibration.toml, transport_*.npz, ambient.exr, mask.png).

The folder's metadata, ambient picture and mask are read here; the transport matrices by tools/transport. Every file is
listed in calibration.toml with its size and SHA-256 and is refused if it differs.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from player import exr
from player.errors import InputError
from player.files import check_file, describe_files, read_toml, replacing_folder, sha256_of, write_toml
from player.response import Response, parse_response

FORMAT = 1
TOML, AMBIENT, MASK = "calibration.toml", "ambient.exr", "mask.png"
MAX_SIDE = 16384
REBUILD = "make the calibration again (simulate-transport, import-transport or import-graycode)"


@dataclass(frozen=True)
class Device:
    """A projector or a camera: its size in pixels and, for a projector, its response."""

    height: int
    width: int
    response: Response

    def __post_init__(self) -> None:
        if not (1 <= self.height <= MAX_SIDE and 1 <= self.width <= MAX_SIDE):
            raise InputError(f"size {self.width}x{self.height}: expected 1 to {MAX_SIDE} pixels a side")

    @property
    def shape(self) -> tuple[int, int]:
        return self.height, self.width

    @property
    def pixels(self) -> int:
        return self.height * self.width


@dataclass(frozen=True)
class Calibration:
    """One room as seen from one camera position.

    ambient : (camera height, camera width, 3) float32, radiance with the projector at black.
    mask : (camera height, camera width) bool, the camera pixels that count.
    """

    name: str
    provenance: str
    projectors: tuple[Device, ...]
    camera: Device
    ambient: NDArray[np.float32]
    mask: NDArray[np.bool_]

    @property
    def projector(self) -> Device:
        return self.projectors[0]


@dataclass(frozen=True)
class StoredCalibration:
    """A calibration, the folder it came from, and what identifies it: the SHA-256 of its calibration.toml."""

    folder: Path
    calibration: Calibration
    fingerprint: str
    files: dict[str, Any]

    def checked_path(self, name: str) -> Path:
        """The path of one of the folder's files, its checksum compared."""
        return check_file(self.folder, name, self.files, REBUILD)


@contextmanager
def writing(folder: Path, calibration: Calibration, *, force: bool = False) -> Iterator[Path]:
    """Yield a stage to put further files (the transport) into; when done, the whole folder appears at once.

    Raises InputError if `folder` exists already, unless `force` is set and it is a calibration (or empty).
    """
    refuse_existing(folder, force=force)
    with replacing_folder(folder) as stage:
        yield stage
        exr.write_rgb(stage / AMBIENT, calibration.ambient)
        if not cv2.imwrite(str(stage / MASK), calibration.mask.astype(np.uint8) * 255):
            raise OSError(f"{stage / MASK}: could not be written")
        write_toml(stage / TOML, _to_toml(calibration, describe_files(stage)))


def refuse_existing(folder: Path, *, force: bool) -> None:
    """InputError if writing a calibration to `folder` would lose something; commands ask before the long work."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    if not (folder / TOML).is_file():
        raise InputError(f"{folder}: exists and is no calibration folder; choose another name")
    if not force:
        raise InputError(f"{folder}: a calibration is there already; choose another name or replace it with --force")


def read(folder: Path) -> StoredCalibration:
    """Open a calibration folder; InputError for anything missing, damaged, or of another format."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; {REBUILD}")
    table = read_toml(folder / TOML, REBUILD)
    if table.get("format") != FORMAT:
        raise InputError(f"{folder / TOML}: format {table.get('format')!r}, this version reads {FORMAT}; {REBUILD}")
    projectors, camera, files = table.get("projectors"), table.get("camera"), table.get("files")
    if not (isinstance(projectors, list) and projectors and isinstance(camera, dict) and isinstance(files, dict)):
        raise InputError(f"{folder / TOML}: needs [[projectors]], [camera] and [files]; {REBUILD}")
    devices = tuple(_device(entry, folder) for entry in projectors)
    eye = _device(camera, folder)
    calibration = Calibration(
        str(table.get("name", folder.name)),
        str(table.get("provenance", "")),
        devices,
        eye,
        _read_ambient(check_file(folder, AMBIENT, files, REBUILD), eye),
        _read_mask(check_file(folder, MASK, files, REBUILD), eye),
    )
    return StoredCalibration(folder, calibration, sha256_of(folder / TOML), files)


def read_mask_picture(path: Path, camera: Device) -> NDArray[np.bool_]:
    """A grey picture of camera size, white where a camera pixel counts (value ≥ 128)."""
    return _read_mask(path, camera)


def _to_toml(calibration: Calibration, files: dict[str, Any]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "name": calibration.name,
        "provenance": calibration.provenance,
        "projectors": [
            {"width": p.width, "height": p.height, "response": p.response.to_toml()} for p in calibration.projectors
        ],
        "camera": {"width": calibration.camera.width, "height": calibration.camera.height},
        "files": files,
    }


def _device(entry: Any, folder: Path) -> Device:
    height, width = (entry.get(key) for key in ("height", "width")) if isinstance(entry, dict) else (None, None)
    if not (isinstance(height, int) and isinstance(width, int)):
        raise InputError(f"{folder / TOML}: a projector or camera lacks width and height; {REBUILD}")
    try:
        return Device(height, width, parse_response(entry.get("response", "linear")))
    except InputError as error:
        raise InputError(f"{folder / TOML}: {error}; {REBUILD}") from None


def _read_ambient(path: Path, camera: Device) -> NDArray[np.float32]:
    header = exr.read_header(path)
    if (header.height, header.width) != camera.shape:
        raise InputError(
            f"{path}: {header.width}x{header.height}, the camera is {camera.width}x{camera.height}; {REBUILD}"
        )
    ambient = exr.read_rgb(path)
    if not np.isfinite(ambient).all():
        raise InputError(f"{path}: holds NaN or infinity; {REBUILD}")
    return ambient


def _read_mask(path: Path, camera: Device) -> NDArray[np.bool_]:
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise InputError(f"{path}: not a readable picture; save it as an 8-bit grey PNG")
    if picture.shape != camera.shape:
        found = f"{picture.shape[1]}x{picture.shape[0]}"
        raise InputError(f"{path}: {found}, the camera is {camera.width}x{camera.height}; save it at the camera's size")
    return np.asarray(picture >= 128)
