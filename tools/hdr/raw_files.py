"""Camera files: RAW through rawpy (LibRaw; the optional extra `raw`) as binned, linear light, and exposure times.

LibRaw's white balance, colour matrix, brightening and curve are not applied, because LibRaw would choose them again
for each picture. There is no demosaicing either. The file gives the black and white levels.

A site has one colour. Demosaicing guesses the two others from neighbours, which turns noise into patterns and edges
into colours. Here each value is measured, and neighbours share no noise. A cell is 2x2 for a Bayer filter (one red, one
blue, two greens) and 3x3 for X-Trans. The price is resolution, of which such cameras have more than a projector.

    code = 65535 (site − black) / (white − black), clipped to 0..65535

One clipped site clips its colour in the cell.

Pillow reads EXIF from JPEG and PNG, because OpenCV, which decodes the pixels, does not. LibRaw reads it from RAW.
"""

import io
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from counterlight import memory
from counterlight.arrays import FloatArray
from counterlight.errors import InputError, one_line
from counterlight.files.reading import opened, read_bytes
from counterlight.files.silence import overheard

TOP = 65535
QUARTER_TURNS = {3: 2, 5: 1, 6: -1}  # number of an orientation in LibRaw -> quarter turns counterclockwise
CELLS = {2: 2, 6: 3}  # period of the mosaic: side of the smallest square that contains every colour


def binned(
    sites: NDArray[np.unsignedinteger], colours: NDArray[np.intp], black: FloatArray, white: float
) -> NDArray[np.uint16]:
    """Returns (height, width, 3) of a mosaic; incomplete periods at its right and lower edge are left out.

    colours : (period, period). 0 red, 1 green, 2 blue; the period is a key of CELLS.
    black : (period, period). Black levels.
    """
    period, cell = len(colours), CELLS[len(colours)]
    repeat = period // cell  # cells per period of the mosaic
    height, width = (side // period * repeat for side in sites.shape)
    light: NDArray[np.float32] = np.zeros((height, width, 3), np.float32)
    clipped = np.zeros(light.shape, np.bool_)
    counts = np.zeros((repeat, repeat, 3), np.float32)
    for y, x in np.ndindex(colours.shape):
        alike = sites[y::period, x::period][: height // repeat, : width // repeat]
        place = np.s_[y // cell :: repeat, x // cell :: repeat, colours[y, x]]
        light[place] += _light(alike, float(black[y, x]), white)
        clipped[place] |= alike >= white
        counts[y // cell, x // cell, colours[y, x]] += 1
    for y, x in np.ndindex(repeat, repeat):
        light[y::repeat, x::repeat] /= counts[y, x]
    return _codes(light, clipped)


def grey(sites: NDArray[np.unsignedinteger], black: float, white: float) -> NDArray[np.uint16]:
    """Returns (height, width) of a sensor without a mosaic, one pixel per site."""
    return _codes(_light(sites, black, white), sites >= white)


def _light(sites: NDArray[np.unsignedinteger], black: float, white: float) -> NDArray[np.float32]:
    return (sites.astype(np.float32) - np.float32(black)) * np.float32(TOP / (white - black))


def _codes(light: NDArray[np.float32], clipped: NDArray[np.bool_]) -> NDArray[np.uint16]:
    light[clipped] = TOP
    return np.asarray(np.rint(light.clip(0, TOP)), np.uint16)


SUFFIXES = (
    *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dng", ".erf", ".iiq", ".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf"),
    *(".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
)
MAX_BYTES = 1 << 30
SITE_BYTES = 16  # bytes of memory per site, measured
COPY = "copy it from the camera again"


def is_raw(name: str | Path) -> bool:
    return Path(name).suffix.lower() in SUFFIXES


def decode_raw(content: bytes, name: str, *, upright: bool = False) -> NDArray[np.uint16]:
    """Returns (height, width, 3) for a colour sensor, (height, width) for a grey one; 65535 is the white level.

    upright : whether to apply the orientation tag.

    Raises InputError for a damaged or truncated file, for another format, and for RAW without a mosaic.
    """
    with _opened(content, name) as raw:
        sizes = raw.sizes
        memory.check(SITE_BYTES * sizes.raw_height * sizes.raw_width, f"{name}: decoding it", "close other programs")
        raw.unpack()
        if raw.raw_image is None or raw.raw_image_visible.ndim != 2:
            raise InputError(
                f"{name}: not the sites of a sensor; choose full-size RAW in the camera, not small or linear"
            )
        codes = _developed(raw, name)
        return np.rot90(codes, QUARTER_TURNS.get(sizes.flip, 0)) if upright else codes


def raw_exposure(path: Path) -> tuple[float, float, float]:
    """Returns seconds, f-number and ISO of a file; 0 where a value is missing."""
    with _opened(read_bytes(path, MAX_BYTES, COPY), str(path)) as raw:
        return raw.other.shutter_speed, raw.other.aperture, raw.other.iso_speed


@contextmanager
def _opened(content: bytes, name: str) -> Iterator[Any]:
    """Open a file with LibRaw; its exceptions and complaints become InputErrors."""
    try:
        import rawpy
    except ImportError:
        raise InputError(f"{name}: camera RAW needs an extra package: pip install 'counterlight[raw]'") from None
    try:
        with overheard() as complaints, rawpy.RawPy() as raw:
            raw.open_buffer(io.BytesIO(content))
            yield raw
    except InputError:
        raise
    except Exception as error:  # raised by LibRaw, and by rawpy for damaged dates and names
        raise InputError(f"{name}: LibRaw cannot read it ({_said(error)}); {COPY}, or save it as DNG") from None
    if complaints:  # LibRaw continues with zeros where the file ends
        raise InputError(f"{name}: damaged or truncated ({one_line(complaints[0].rpartition(': ')[2])}); {COPY}")


def _developed(raw: Any, name: str) -> NDArray[np.uint16]:
    sites, black = raw.raw_image_visible, np.array(raw.black_level_per_channel, np.float64)
    own = [level for level in raw.camera_white_level_per_channel or () if 0 < level < raw.white_level]
    white = float(min(own, default=raw.white_level))  # the camera may state that its sensor saturates below its range
    if not white > black.max():
        raise InputError(f"{name}: a black level of {black.max():g} and a white level of {white:g}; {COPY}")
    if raw.num_colors == 1:
        return grey(sites, float(black[0]), white)
    period = 0 if raw.raw_pattern is None else len(raw.raw_pattern)
    letters = bytes(raw.color_desc).decode("ascii", "replace")
    pattern = raw.raw_colors_visible[:period, :period]
    if period not in CELLS or set(letters) != set("RGB") or pattern.shape != (period, period):
        raise InputError(f"{name}: a mosaic of {letters}, period {period}, is not known here; save it as 16-bit PNG")
    colours = np.array(["RGB".index(letter) for letter in letters])
    return binned(sites, colours[pattern], black[pattern], white)


def _said(error: Exception) -> str:
    said = error.args[0] if error.args else error
    return said.decode("utf-8", "replace") if isinstance(said, bytes) else one_line(error)


GIVE_TIMES = "give --times, one for each picture, in seconds"


@dataclass(frozen=True)
class Exposure:
    """The exposure stated in a file; None for values that are missing. `aperture` is the f-number."""

    time_s: float | None
    aperture: float | None
    iso: float | None


def read_exposure(path: Path) -> Exposure:
    """Read the exposure from a picture's EXIF; InputError for a file that is not a picture."""
    if is_raw(path):
        return Exposure(*map(_positive, raw_exposure(path)))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damaged EXIF and large pictures; the values are checked below
            with opened(path, "check the path") as file, Image.open(file, formats=("PNG", "JPEG")) as picture:
                tags = dict(picture.getexif().get_ifd(ExifTags.IFD.Exif))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or 'neither PNG nor JPEG'}; check the path") from None
    except Exception as error:  # Pillow raises many kinds of exceptions on damaged files
        raise InputError(f"{path}: its EXIF cannot be read ({' '.join(str(error).split())}); {GIVE_TIMES}") from None
    names = ExifTags.Base.ExposureTime, ExifTags.Base.FNumber, ExifTags.Base.ISOSpeedRatings
    return Exposure(*(_positive(tags.get(name)) for name in names))


def exposure_times(paths: Sequence[Path]) -> NDArray[np.float64]:
    """Returns the exposure time of each picture, in seconds.

    Raises InputError if a time is missing, and if aperture or sensitivity change, because then times are not exposures.
    """
    exposures = [read_exposure(path) for path in paths]
    for path, exposure in zip(paths, exposures, strict=True):
        if exposure.time_s is None:
            raise InputError(f"{path}: no exposure time in its EXIF; {GIVE_TIMES}")
        for what, value, first in (
            ("aperture f/", exposure.aperture, exposures[0].aperture),
            ("ISO ", exposure.iso, exposures[0].iso),
        ):
            if value != first:
                raise InputError(
                    f"{path}: {what}{_text(value)}, expected {what}{_text(first)} as in {paths[0].name}: only the time "
                    "may change; take the bracket again, or give --times that make up for it"
                )
    return np.array([exposure.time_s for exposure in exposures], np.float64)


def _positive(value: object) -> float | None:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if isfinite(number) and number > 0 else None


def _text(value: float | None) -> str:
    return "unknown" if value is None else f"{value:g}"
