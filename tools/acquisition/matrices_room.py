"""Import a light transport that another program measured as a calibration folder."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.tools.choices import TOLERANCE
from counterlight.tools.factoring.factoring import Factoring, compacted
from counterlight.tools.transport.arrays import NOT_LIGHT, opened_array
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.pixel_order import Misreading, misreading
from counterlight.tools.transport.storage import read_matrix, write_transport
from counterlight.tools.transport.transport import CHANNELS, Csr, Transport, luminance

NEGLIGIBLE = 0.01  # light of negative entries that may be noise, as a share of the positive entries' light


@dataclass(frozen=True)
class MatrixFiles:
    """The files of one room.

    matrices : red, green and blue. scipy.sparse .npz of (camera pixels, projector pixels).
    ambient : .exr or .npy of the camera's size; None for no ambient light.
    mask : a picture; None selects the lit pixels.
    """

    matrices: tuple[Path, Path, Path]
    ambient: Path | None = None
    mask: Path | None = None

    @property
    def all(self) -> tuple[Path, ...]:
        """The files that are given."""
        return tuple(path for path in (*self.matrices, self.ambient, self.mask) if path is not None)


@dataclass(frozen=True)
class MatricesSummary:
    """Counts of the imported entries; the text is the command's output.

    doubts : warnings, one line each.
    misreading : swapped sizes for which T looks better, if any.
    """

    entries: tuple[int, ...]
    negative: tuple[int, ...]
    size_bytes: int
    counting: int
    camera_pixels: int
    doubts: tuple[str, ...]
    factoring: Factoring
    misreading: Misreading | None

    def __str__(self) -> str:
        channels = ", ".join(f"{name} {count}" for name, count in zip(CHANNELS, self.entries, strict=True))
        negative = f"{sum(self.negative)} negative entries set to 0"
        if any(self.negative):
            negative += f" ({', '.join(f'{n} {c}' for n, c in zip(CHANNELS, self.negative, strict=True))})"
        return (
            f"entries: {channels}; {self.size_bytes / 2**20:.1f} MiB; "
            f"{self.counting} of {self.camera_pixels} camera pixels in the mask; {negative}\n{self.factoring}"
        )


def import_matrices_room(
    files: MatrixFiles,
    folder: Path,
    projector: Device,
    camera: Device,
    *,
    name: str | None = None,
    force: bool = False,
    tolerance: float = TOLERANCE,
) -> MatricesSummary:
    """Read and check the files, then write the calibration `folder`, which appears whole or not at all.

    tolerance : dB that pictures may lose when a dense or blurred T is factored; 0 keeps T unfactored.

    Raises InputError for damaged files, wrong shapes, NaN, infinity, a channel without entries, and an unlit camera.
    """
    with calibration.replacing(folder, force=force, inputs=files.all) as stage:
        ambient = read_ambient(files.ambient, camera)
        given = None if files.mask is None else _counting(calibration.read_mask_picture(files.mask, camera), files.mask)
        shape = camera.pixels, projector.pixels
        matrices = [read_matrix(path, shape) for path in files.matrices]
        negative = tuple(map(keep_light, matrices, files.matrices))
        doubts = [each.doubt and f"{path}: {each.doubt}" for path, each in zip(files.matrices, negative, strict=True)]
        entries = tuple(int(matrix.nnz) for matrix in matrices)
        transport = Transport.from_matrices(matrices, camera=camera.shape, projector=projector.shape)
        del matrices  # frees memory: they are as large as T, which may be dense
        doubt = misreading(transport.near, camera.shape, projector.shape)
        transport, factoring = compacted(transport, ambient, tolerance)
        mask = _counting(directly_lit(transport, ambient, projector.shape), None) if given is None else given
        named = folder.name if name is None else name
        write_transport(transport, stage)
        calibration.write(Calibration(named, _provenance(files), (projector,), camera, ambient, mask), stage)
    return MatricesSummary(
        entries=entries,
        negative=tuple(each.count for each in negative),
        size_bytes=sum(path.stat().st_size for path in folder.iterdir()),
        counting=int(mask.sum()),
        camera_pixels=camera.pixels,
        doubts=tuple(doubt for doubt in (*doubts, brighter_ambient(transport, ambient, mask)) if doubt is not None),
        factoring=factoring,
        misreading=doubt,
    )


def read_ambient(path: Path | None, camera: Device) -> NDArray[np.float32]:
    """Returns the ambient picture e, (camera height, camera width, 3) float32, finite and ≥ 0; black for None.

    An .npy file holds (height, width, 3) or, for grey light, (height, width) real numbers, and is never unpickled.
    """
    if path is None:
        return np.zeros((*camera.shape, 3), np.float32)
    if path.suffix.lower() not in (".exr", ".npy"):
        raise InputError(f"{path}: ambient light is read from .exr or .npy; save it as one of these")
    if path.suffix.lower() == ".exr":
        picture = exr.read_rgb(path, exr.sized(camera.shape, "the camera", "check --camera"))
    else:
        picture = _read_npy(path, camera)
    for fault, bad in (("NaN or infinite", ~np.isfinite(picture)), ("negative", picture < 0)):
        if bad.any():
            raise InputError(f"{path}: {int(bad.sum())} of {bad.size} values are {fault}; repair the measurement")
    return picture


def _read_npy(path: Path, camera: Device) -> NDArray[np.float32]:
    size = "x".join(map(str, camera.shape[::-1]))
    with opened_array(path, "no picture of this camera", f"for --camera {size}, save (height, width, 3)") as stored:
        grey = len(stored.shape) == 2
        if stored.dtype.kind in "iu":
            raise InputError(f"{path}: ambient light of {stored.dtype}; {NOT_LIGHT}")
        picture = stored.expect("fiu", *camera.shape, *(() if grey else (3,))).read()
    with np.errstate(over="ignore"):  # values beyond float32 become infinite, which the caller refuses
        rgb = np.stack([picture] * 3, axis=-1) if grey else picture
        return rgb.astype(np.float32)


@dataclass(frozen=True)
class Negative:
    """The negative entries of a channel of T, which were set to 0.

    share : their light, as a share of the positive entries' light.
    """

    count: int
    share: float

    @property
    def doubt(self) -> str | None:
        """A warning if the negative entries hold more light than noise does."""
        if self.share <= NEGLIGIBLE:
            return None
        return (
            f"{self.count} negative entries, set to 0, hold {100 * self.share:.2g} % as much light as the positive "
            "entries, more than noise; check the subtraction of dark pictures, or drop entries below the noise"
        )


def keep_light(matrix: Csr, where: Path | str) -> Negative:
    """Remove negative entries and zeros from a channel of T in place; returns the negative entries.

    Raises InputError if nothing is left.
    """
    negative = matrix.data < 0
    count, removed = int(negative.sum()), -float(matrix.data[negative].sum(dtype=np.float64))
    matrix.data[negative] = 0
    matrix.eliminate_zeros()
    if not matrix.nnz:
        raise InputError(
            f"{where}: no positive entry ({count} negative); the projector would light nothing in this channel"
        )
    return Negative(count, removed / float(matrix.data.sum(dtype=np.float64)))


def brighter_ambient(transport: Transport, ambient: NDArray[np.floating], mask: NDArray[np.bool_]) -> str | None:
    """Return a warning if ambient light is brighter than white in the median pixel of the mask, else None."""
    white, dark = (
        float(np.median(luminance(light.reshape(-1, 3))[mask.ravel()]))
        for light in (transport.composition(), ambient.astype(np.float64))
    )
    if dark <= white:
        return None
    return (
        f"ambient light is brighter than the projector's white: {dark:.3g} and {white:.3g} in the median pixel of the "
        "mask; check that ambient light and T have the same unit"
    )


def _counting(mask: NDArray[np.bool_], path: Path | None) -> NDArray[np.bool_]:
    """Returns the mask; InputError if it is empty. `path` is None for the default mask."""
    fix = "check the unit of --ambient against the matrices, or name the pixels that count with --mask"
    if path is not None:
        fix = "make the pixels that count white"
    if not mask.any():
        raise InputError(f"{path or 'the default mask'}: no camera pixel counts, expected at least 1; {fix}")
    return mask


def _provenance(files: MatrixFiles) -> str:
    return "counterlight import-transport of " + ", ".join(path.name for path in files.all)
