"""Photographs as a camera stored them: PNG and JPEG (files/picture_files.py), or RAW (raw_files.py)."""

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


def read_photograph(path: Path) -> NDArray[Any]:
    """Code values (height, width) or (height, width, 3), uint8 or uint16; of RAW those of `decode_raw`, linear."""
    return decode_raw(read_bytes(path, MAX_BYTES, COPY), str(path)) if is_raw(path) else read_picture(path)


def decode_photograph(content: bytes, name: str) -> NDArray[Any]:
    """See `read_photograph`; the name says which format it is."""
    return decode_raw(content, name) if is_raw(name) else decode(content, name)


def refuse_curve(name: str | Path, response: Response, option: str) -> None:
    """InputError for RAW, which is linear, if its codes are to go through a curve."""
    if is_raw(name) and response != Response("linear"):
        raise InputError(f"{option}: {name} is camera RAW, which is linear; leave the option out")
