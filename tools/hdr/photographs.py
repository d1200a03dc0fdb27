"""Read photographs as the camera stored them: PNG and JPEG (files/picture_files.py), or RAW (raw_files.py)."""

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.files import picture_files
from counterlight.files.picture_files import decode, read_picture
from counterlight.files.reading import read_bytes
from counterlight.response import Response
from counterlight.tools.hdr.raw_files import COPY, MAX_BYTES, decode_raw, is_raw
from counterlight.tools.hdr.raw_files import SUFFIXES as RAW

SUFFIXES = (*picture_files.SUFFIXES, *RAW)


def read_photograph(path: Path, *, upright: bool = False) -> NDArray[Any]:
    """Returns code values (height, width) or (height, width, 3), uint8 or uint16; linear for RAW (`decode_raw`).

    upright : whether to apply an orientation tag. Otherwise the pixels stay as the camera stored them.
    """
    if is_raw(path):
        return decode_raw(read_bytes(path, MAX_BYTES, COPY), str(path), upright=upright)
    return read_picture(path, upright=upright)


def decode_photograph(content: bytes, name: str) -> NDArray[Any]:
    """Like `read_photograph`, for the content of a file whose name gives its format."""
    return decode_raw(content, name) if is_raw(name) else decode(content, name)


def refuse_curve(name: str | Path, response: Response, option: str) -> None:
    """Raises InputError if a non-linear response is given for RAW, which is linear."""
    if is_raw(name) and response != Response("linear"):
        raise InputError(f"{option}: {name} is camera RAW, which is linear; leave the option out")
