"""Read camera RAW through rawpy (LibRaw; the optional extra `raw`): the sensor's linear light without processing.

LibRaw's white balance, colour matrix, brightening and curve are not applied, because LibRaw would choose them again
for each picture. There is no demosaicing either: see mosaic.py. The file gives the black and white levels.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight import memory
from counterlight.errors import InputError, one_line
from counterlight.files.reading import read_bytes
from counterlight.files.silence import overheard
from counterlight.tools.hdr.mosaic import CELLS, binned, grey

SUFFIXES = (
    *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dng", ".erf", ".iiq", ".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf"),
    *(".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
)
MAX_BYTES = 1 << 30
SITE_BYTES = 16  # bytes of memory per site, measured
COPY = "copy it from the camera again"


def is_raw(name: str | Path) -> bool:
    return Path(name).suffix.lower() in SUFFIXES


def decode_raw(content: bytes, name: str) -> NDArray[np.uint16]:
    """Returns (height, width, 3) for a colour sensor, (height, width) for a grey one; 65535 is the white level.

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
    return codes


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
