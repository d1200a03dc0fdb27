"""Changes of a room since its calibration that are undone in every frame (docs/drift.md).

The projector's picture has moved: its pixel x now lights position N x of the calibrated raster. A drive p for the
raster is therefore shown as p(N x). The light has changed to c = g T p + e', so p(N x) / g is shown. A picture that now
reaches beyond the calibrated raster adds light that T does not describe. The targets of the affected camera pixels are
reduced by that share.

The folder drift/ of a calibration holds drift.toml, ambient.exr if the ambient light has changed, and share.exr if
there are shares. A drift belongs to one state of calibration.toml, and to any maps built from this state.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.calibration import Device, StoredCalibration, read_light
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.manifest import describe_files, read_steadily, write_toml
from counterlight.files.reading import DescribedFiles, read_toml
from counterlight.files.tables import Table
from counterlight.passes.moved import FADE, TAPS, WHOLE, MovedDrive
from counterlight.raster import Region
from counterlight.writing.replacing import replacing_folder

FOLDER, FILE, AMBIENT, SHARE, FORMAT = "drift", "drift.toml", "ambient.exr", "share.exr", 1
FARTHEST = 0.5  # largest allowed move of a corner, as a share of the projector's longer side
GAIN = 0.05, 20.0
MARGIN = int(WHOLE + FADE) + TAPS // 2  # width in pixels of the mirrored margin around the picture
LEAST_SHARE = 0.05
Light: TypeAlias = NDArray[np.floating]


@dataclass(frozen=True)
class Moved:
    """The drift of one projector's picture.

    to_raster : N, (3, 3), homogeneous. Maps the position of a projector pixel to the position in the calibrated raster
        that the pixel now lights. Positions are in pixels from the upper left corner.
    gain : g, (3,). Change of each channel's light.
    """

    to_raster: FloatArray
    gain: FloatArray

    @classmethod
    def nothing(cls) -> "Moved":
        return cls(np.eye(3), np.ones(3))

    @property
    def changes(self) -> bool:
        return not (np.array_equal(self.to_raster, np.eye(3)) and np.array_equal(self.gain, np.ones(3)))

    def displacement(self, positions: FloatArray) -> FloatArray:
        """Return how far the picture has moved, (n, 2), right and down, at positions (n, 2) in projector pixels."""
        x, y, w = self.to_raster @ np.column_stack([positions, np.ones(len(positions))]).T
        return np.asarray(np.column_stack([x / w, y / w]) - positions)

    def at_corners(self, device: Device) -> FloatArray:
        """Return the displacement at the middle and the four corners, (5, 2)."""
        return self.displacement(_marks(device))

    def check(self, device: Device) -> None:
        """Raise InputError unless the whole picture is in front of the lens, unmirrored, and within FARTHEST."""
        ahead = np.column_stack([_marks(device), np.ones(5)]) @ self.to_raster[2]
        if not (ahead > 0).all() or np.linalg.det(self.to_raster[:2, :2]) <= 0:
            raise InputError("the homography turns the picture over")
        farthest = float(np.abs(self.at_corners(device)).max())
        if not farthest <= FARTHEST * max(device.shape):
            raise InputError(f"the picture's corners have moved by {farthest:.0f} pixels, expected at most half of it")


@dataclass(frozen=True)
class Drift:
    """All changes of a room since its calibration.

    projectors : one entry per projector.
    ambient : (camera height, camera width, 3). Current ambient light; None if unchanged.
    said : description in words.
    date : ISO 8601.
    share : (camera height, camera width), LEAST_SHARE to 1. Share of the current floodlight that comes from the
        calibrated raster; None for 1 everywhere.
    """

    projectors: tuple[Moved, ...]
    ambient: NDArray[np.float32] | None = None
    said: str = ""
    date: str = ""
    share: NDArray[np.float32] | None = None

    @property
    def moves(self) -> bool:
        """Whether any picture has moved or changed its brightness."""
        return any(each.changes for each in self.projectors)

    @property
    def changes(self) -> bool:
        """Whether there is anything to undo."""
        return self.moves or self.ambient is not None

    @property
    def dimming(self) -> float:
        """Return the smallest gain of all channels: the factor by which the reachable white shrinks."""
        return float(min(each.gain.min() for each in self.projectors))

    def table(self, regions: tuple[Region, ...]) -> NDArray[np.float32]:
        """Return (projectors, 6, 3) for moved.frag: the rows of N, then (left, top, 0), (width, height, 0) and g."""
        rows = [
            np.vstack([moved.to_raster, (*region[:2], 0), (*region[2:], 0), moved.gain])
            for moved, region in zip(self.projectors, regions, strict=True)
        ]
        return np.asarray(rows, np.float32)

    def landed(self, drive: Light, regions: tuple[Region, ...]) -> FloatArray:
        """Return the light of a shown drive in the calibrated raster, g p(N⁻¹ u): (height, width, 3)."""
        arrived = np.zeros(drive.shape)
        for each, region in zip(self.projectors, regions, strict=True):
            part = region.part
            arrived[part] = resampled(drive[part], np.asarray(np.linalg.inv(each.to_raster), np.float64)) * each.gain
        return arrived

    def shown(self, drive: Light, regions: tuple[Region, ...]) -> Light:
        """Return the drive to show for a drive in the calibrated raster; unchanged if no picture has moved."""
        if not self.moves:
            return drive
        shown = np.zeros(drive.shape, np.float32)
        MovedDrive(np.ascontiguousarray(drive, np.float32), self.table(regions)).fill(shown)
        return shown

    def to_dict(self, devices: tuple[Device, ...]) -> dict[str, Any]:
        """Return values for JSON: the move of each picture's middle in pixels, and its mean gain."""
        shifts = [each.at_corners(device)[0] for each, device in zip(self.projectors, devices, strict=True)]
        return {
            "checked": self.date,
            "moved": [[round(float(v), 3) for v in shift] for shift in shifts],
            "gain": [round(float(each.gain.mean()), 4) for each in self.projectors],
        }


def read_drift(stored: StoredCalibration) -> Drift | None:
    """Read the drift stored with a calibration, or None. Raises InputError if the file does not fit the calibration."""
    path = stored.folder / FOLDER / FILE
    return read_steadily(path, lambda: _read(stored, path) if path.exists() else None)


def write_drift(stored: StoredCalibration, drift: Drift) -> None:
    """Write a drift, replacing the whole previous drift. A drift without changes is also stored."""
    with replacing_folder(stored.folder / FOLDER, lambda _: stored.refuse_replaced()) as stage:
        if drift.ambient is not None:
            exr.write_rgb(stage / AMBIENT, drift.ambient)
        if drift.share is not None:
            exr.write_channels(stage / SHARE, {"Y": drift.share})
        write_toml(stage / FILE, _to_toml(stored, drift, describe_files(stage)))


def resampled(picture: Light, N: FloatArray) -> FloatArray:
    """Return p(N x) for every pixel x, (height, width, channels), times the share of x that falls on the picture."""
    height, width = picture.shape[:2]
    at, ahead = positions(N, (height, width))
    depth = np.minimum(at, (width, height) - at)
    lands = ahead * np.clip(0.5 + depth, 0, 1).prod(axis=2)
    return np.asarray(lands[..., None] * sampled(picture, at.reshape(-1, 2)).reshape(picture.shape))


def positions(N: FloatArray, shape: tuple[int, int]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return where a homography maps pixel centres, (height, width, 2), and whether each is in front of the lens."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    u, v, w = np.einsum("ij,jyx->iyx", N, np.stack([x, y, np.ones_like(x)]))
    ahead = w > 0
    w = np.where(ahead, w, 1)
    return np.stack([u / w, v / w], axis=2), ahead


def sampled(picture: Light, at: FloatArray) -> FloatArray:
    """Interpolate a picture at positions (n, 2) -> (n, channels), from 6 × 6 pixels (Keys 1981), mirrored outside."""
    height, width = picture.shape[:2]
    mirrored = picture[_mirrored(height)][:, _mirrored(width)]
    flat, stride = mirrored.reshape(-1, picture.shape[2]), width + 2 * MARGIN
    first = np.floor(at - 0.5)
    across, down = (_keys(t)[..., None] for t in (at - 0.5 - first).T)
    # Positions beyond the margin are dark in a shown picture, and have no weight in an estimate.
    x, y = np.clip(first + MARGIN - 2, 0, (stride - TAPS, height + 2 * MARGIN - TAPS)).astype(np.int64).T
    corner, result = y * stride + x, np.zeros((len(at), picture.shape[2]))
    for i in range(TAPS):
        line = across[0] * flat[corner + i * stride]
        for j in range(1, TAPS):
            line += across[j] * flat[corner + i * stride + j]
        result += down[i] * line
    return result


def _keys(t: FloatArray) -> FloatArray:
    """Return the weights of six neighbouring pixels at a share t between the inner two: (6, …). Exact for cubics."""

    def near(x: FloatArray) -> FloatArray:
        return (4 * x - 7) * x * x / 3 + 1

    def middle(x: FloatArray) -> FloatArray:
        return ((36 - 7 * x) * x - 59) * x / 12 + 2.5

    def far(x: FloatArray) -> FloatArray:
        return ((x - 8) * x + 21) * x / 12 - 1.5

    return np.stack([far(2 + t), middle(1 + t), near(t), near(1 - t), middle(2 - t), far(3 - t)])


def _mirrored(count: int) -> NDArray[np.int64]:
    """Return indices of a line with mirrored margins; the outermost pixels are not repeated."""
    last = count - 1
    return np.asarray(np.clip(last - np.abs(last - np.abs(np.arange(-MARGIN, count + MARGIN))), 0, last))


def _read(stored: StoredCalibration, path: Path) -> Drift:
    fix = "check the room again with counterlight verify, or remove the folder"
    values = read_toml(path, fix)
    table = Table(values, f"{path}", fix)
    table.format(FORMAT)
    if values.get("calibration") != stored.fingerprint:
        raise table.refusal(f": found for another state of {stored.folder}/calibration.toml")
    room = stored.calibration
    entries = table.tables("projectors")
    if len(entries) != len(room.projectors):
        raise table.refusal(f": {len(entries)} projectors, the calibration has {len(room.projectors)}")
    moved = tuple(_read_moved(entry, device) for entry, device in zip(entries, room.projectors, strict=True))
    files = DescribedFiles(path.parent, table.table("files", optional=True).values, fix)
    ambient = read_light(files, AMBIENT, room.camera) if AMBIENT in files else None
    share = _read_share(files, room.camera) if SHARE in files else None
    return Drift(moved, ambient, table.text("said", ""), table.text("date", ""), share)


def _read_share(files: DescribedFiles, camera: Device) -> NDArray[np.float32]:
    share = exr.read_described(files, SHARE, camera.shape, "the camera")[..., 0]
    low, high = float(share.min()), float(share.max())
    if not (low >= LEAST_SHARE and high <= 1):  # `not`, because a comparison with NaN is false
        raise InputError(
            f"{files.folder / SHARE}: shares from {low:g} to {high:g}, expected {LEAST_SHARE} to 1; {files.fix}"
        )
    return share


def _read_moved(table: Table, device: Device) -> Moved:
    if table.size("size", device.pixels) != device.shape:
        raise table.wrong("size", f"[{device.width}, {device.height}], the calibrated projector's")
    moved = Moved(table.rows("to_raster", 3, 3, -1e5, 1e5), table.numbers("gain", 3, None, *GAIN))
    try:
        moved.check(device)
    except InputError as error:
        raise table.refusal(f": {error}") from None
    return moved


def _to_toml(stored: StoredCalibration, drift: Drift, files: dict[str, Any]) -> dict[str, Any]:
    devices = stored.calibration.projectors
    return {
        "format": FORMAT,
        "calibration": stored.fingerprint,
        "date": drift.date,
        "said": drift.said,
        "projectors": [
            {
                "size": [device.width, device.height],
                "to_raster": [[float(v) for v in row] for row in moved.to_raster],
                "gain": [float(v) for v in moved.gain],
            }
            for moved, device in zip(drift.projectors, devices, strict=True)
        ],
        "files": files,
    }


def _marks(device: Device) -> FloatArray:
    """Return the middle and the corners of the picture, (5, 2)."""
    width, height = device.width, device.height
    return np.array([(width / 2, height / 2), (0, 0), (width, 0), (width, height), (0, height)], np.float64)
