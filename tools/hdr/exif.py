"""Exposure times that cameras write into their files.

Pillow reads EXIF from JPEG and PNG, because OpenCV, which decodes the pixels, does not. LibRaw reads it from RAW.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from counterlight.errors import InputError
from counterlight.files.reading import opened
from counterlight.tools.hdr.raw_files import is_raw, raw_exposure

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
            warnings.simplefilter("ignore")  # damaged EXIF and large pictures: the values are checked below
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
