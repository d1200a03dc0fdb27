"""Exposure times as cameras write them into their files.

Pillow reads EXIF from JPEG and PNG; OpenCV, which decodes the pixels, gives none of it. RAW's is read by LibRaw.
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
    """What one file says of its exposure; None where it says nothing.  aperture : the f-number."""

    time_s: float | None
    aperture: float | None
    iso: float | None


def read_exposure(path: Path) -> Exposure:
    """The exposure in a picture's EXIF. Raises InputError for a file that is no picture."""
    if is_raw(path):
        return Exposure(*map(_positive, raw_exposure(path)))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # damaged EXIF and large pictures: what matters is checked below
            with opened(path, "check the path") as file, Image.open(file, formats=("PNG", "JPEG")) as picture:
                tags = dict(picture.getexif().get_ifd(ExifTags.IFD.Exif))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or 'neither PNG nor JPEG'}; check the path") from None
    except Exception as error:  # Pillow's parsers raise many kinds on damaged files
        raise InputError(f"{path}: its EXIF cannot be read ({' '.join(str(error).split())}); {GIVE_TIMES}") from None
    names = ExifTags.Base.ExposureTime, ExifTags.Base.FNumber, ExifTags.Base.ISOSpeedRatings
    return Exposure(*(_positive(tags.get(name)) for name in names))


def exposure_times(paths: Sequence[Path]) -> NDArray[np.float64]:
    """The exposure time of each picture, in seconds.

    Raises InputError for a file without one, and where aperture or sensitivity change: then times are not exposures.
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
