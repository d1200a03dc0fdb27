"""Camera RAW through rawpy (LibRaw; the optional extra `raw`): the sensor's own light, linear, and nothing else.

Nobody's taste is applied: no white balance, colour matrix, brightening or curve, which LibRaw would choose anew for
each picture. A site of the mosaic has one colour, and demosaicing would guess the two others from its neighbours; noise
would become patterns, and edges colours. Here each cell of the mosaic becomes one pixel, each of its colours the mean
of the sites that have it: half the size with a Bayer filter (2x2: a red, a blue, two greens), a third with X-Trans
(3x3). Every value was measured, neighbours share no noise, and it is the same for every picture. What that costs is
pixels, of which such cameras have more than a projector.

    code = 65535 (site − black) / (white − black), clipped to 0..65535

with the file's own black level of each colour. One clipped site clips its colour in the cell.
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

SUFFIXES = (
    *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dng", ".erf", ".iiq", ".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf"),
    *(".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
)
TOP = 65535
MAX_BYTES = 1 << 30
SITE_BYTES = 12  # of memory: the file, LibRaw's copy, sums of a quarter as many pixels
CELLS = {2: 2, 6: 3}  # the smallest square that has every colour, by the period of the mosaic
COPY = "copy it from the camera again"


def is_raw(name: str | Path) -> bool:
    return Path(name).suffix.lower() in SUFFIXES


def decode_raw(content: bytes, name: str) -> NDArray[np.uint16]:
    """(height, width, 3) of a colour sensor, (height, width) of a grey one; 65535 is the white level.

    Raises InputError for a damaged or truncated file, for another format, and for RAW that is no mosaic.
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
    """Seconds, f-number and ISO in a file; 0 where it says nothing."""
    with _opened(read_bytes(path, MAX_BYTES, COPY), str(path)) as raw:
        return raw.other.shutter_speed, raw.other.aperture, raw.other.iso_speed


@contextmanager
def _opened(content: bytes, name: str) -> Iterator[Any]:
    """LibRaw at a file; whatever it throws or complains of becomes an InputError."""
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
    except Exception as error:  # of LibRaw, and of rawpy for damaged dates and names
        raise InputError(f"{name}: LibRaw cannot read it ({_said(error)}); {COPY}, or save it as DNG") from None
    if complaints:  # it goes on, with zeros where the file ends
        raise InputError(f"{name}: damaged or truncated ({one_line(complaints[0].rpartition(': ')[2])}); {COPY}")


def _developed(raw: Any, name: str) -> NDArray[np.uint16]:
    sites, black = raw.raw_image_visible, np.array(raw.black_level_per_channel, np.float32)
    own = [level for level in raw.camera_white_level_per_channel or () if 0 < level < raw.white_level]
    white = float(min(own, default=raw.white_level))  # where the camera says its sensor ends below its range
    if not white > black.max():
        raise InputError(f"{name}: a black level of {black.max():g} and a white level of {white:g}; {COPY}")
    if raw.num_colors == 1:
        return _codes((sites - black[0]) * (TOP / (white - black[0])), sites >= white)
    period = 0 if raw.raw_pattern is None else len(raw.raw_pattern)
    letters = bytes(raw.color_desc).decode("ascii", "replace")
    pattern = raw.raw_colors_visible[:period, :period]
    cell = CELLS.get(period, 0)
    if not cell or set(letters) != set("RGB") or pattern.shape != (period, period):
        raise InputError(f"{name}: a mosaic of {letters}, period {period}, is not known here; save it as 16-bit PNG")
    return _binned(sites, pattern, cell, letters, black, white)


def _binned(
    sites: NDArray[np.uint16], pattern: NDArray[Any], cell: int, letters: str, black: NDArray[np.float32], white: float
) -> NDArray[np.uint16]:
    """The mean of each colour in each cell.  pattern : (period, period), which of `letters` a site has."""
    period, repeat = len(pattern), len(pattern) // cell  # cells before the mosaic repeats
    height, width = (side // period * repeat for side in sites.shape)
    light, clipped = np.zeros((height, width, 3), np.float32), np.zeros((height, width, 3), np.bool_)
    counts = np.zeros((repeat, repeat, 3), np.float32)
    for y, x in np.ndindex(pattern.shape):
        index, colour = pattern[y, x], "RGB".index(letters[pattern[y, x]])
        alike = sites[y::period, x::period][: height // repeat, : width // repeat]
        place = np.s_[y // cell :: repeat, x // cell :: repeat, colour]
        light[place] += (alike - black[index]) * (TOP / (white - black[index]))
        clipped[place] |= alike >= white
        counts[y // cell, x // cell, colour] += 1
    for y, x in np.ndindex(repeat, repeat):
        light[y::repeat, x::repeat] /= counts[y, x]
    return _codes(light, clipped)


def _codes(light: NDArray[np.float32], clipped: NDArray[np.bool_]) -> NDArray[np.uint16]:
    light[clipped] = TOP
    return np.asarray(np.rint(light.clip(0, TOP)), np.uint16)


def _said(error: Exception) -> str:
    said = error.args[0] if error.args else error
    return said.decode("utf-8", "replace") if isinstance(said, bytes) else one_line(error)
