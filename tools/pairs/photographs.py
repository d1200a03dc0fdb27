"""Find and read pairs: projector pictures and their photographs.

Pairs are matched by a list, by the last number in the names, or by content (matching.py).
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.command import track
from counterlight.errors import InputError
from counterlight.files.picture_files import MAX_BYTES
from counterlight.files.reading import not_read, read_bytes
from counterlight.files.silence import silence
from counterlight.response import Response
from counterlight.tools.hdr import photographs as stored
from counterlight.tools.hdr.photographs import refuse_curve
from counterlight.tools.hdr.raw_files import is_raw
from counterlight.tools.pairs.model import SATURATED

LEAST = 8  # pairs that a fit needs
TIFF = (".tif", ".tiff")
SUFFIXES = (*stored.SUFFIXES, *TIFF)
LONGEST_SIDE = 640  # camera pixels of a room's longer side, unless given
ABOVE = 3  # folders between a CompenNet data set and a set-up: light, position, surface
SHORTEST_SIDE, STRETCHED = 32, 0.01  # least camera pixels of a room's shorter side; change of the aspect ratio
Size = tuple[int, int]  # (width, height)


@dataclass(frozen=True)
class Pair:
    """A projector picture and its photograph."""

    picture: Path
    photograph: Path

    @property
    def name(self) -> str:
        return f"{self.picture.name} with {self.photograph.name}"


def files_in(folder: Path) -> list[Path]:
    """Return the pictures of a folder in the order of their numbers."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected a folder of pictures")
    entries = [path for path in folder.iterdir() if path.is_file()]
    found = [path for path in entries if path.suffix.lower() in SUFFIXES]
    unread = [path for path in entries if path.suffix.lower() in (".heic", ".heif", ".avif")]
    if unread and not found:
        raise InputError(f"{min(unread)}: {not_read(min(unread))}")
    return sorted(found, key=lambda path: (number_of(path) is None, number_of(path) or 0, path.name))


def set_up_folders(pictures: Path, set_up: Path, part: str = "train") -> tuple[Path, Path] | None:
    """Return the folders of pictures and photographs of a CompenNet set-up; None without set_up/cam/raw/PART.

    Several set-ups share pictures in PART of a folder above them. Others have pictures of their own in prj/share/PART.
    """
    photographs = set_up / "cam" / "raw" / part
    if not photographs.is_dir():
        return None
    places = (pictures, set_up, *set_up.resolve().parents[:ABOVE])
    known = [place / below / part for place in places for below in ("prj/share", "prj", "")]
    return next((folder for folder in known if folder.is_dir()), pictures), photographs


def black_photograph(pictures: Path, set_up: Path) -> Path | None:
    """Return the photograph of the black picture among the reference pictures of a CompenNet set-up, if any."""
    folders = set_up_folders(pictures, set_up, "ref")
    shown, seen = (files_in(folder) for folder in folders) if folders else ([], [])
    by_number = {number_of(path): path for path in seen}
    both = [path for path in shown if number_of(path) is not None and number_of(path) in by_number]
    return next((by_number[number_of(path)] for path in both if not read_photograph(path).any()), None)


def number_of(path: Path) -> int | None:
    """Return the last number in a file's name."""
    numbers = re.findall(r"\d+", path.stem)
    return int(numbers[-1]) if numbers else None


def pairs_by_number(pictures: Sequence[Path], photographs: Sequence[Path]) -> list[Pair] | None:
    """Match the photographs to the pictures with the same numbers; None unless every photograph has one picture."""
    by_number: dict[int | None, list[Path]] = {}
    for path in pictures:
        by_number.setdefault(number_of(path), []).append(path)
    numbers = [number_of(path) for path in photographs]
    if None in numbers or len(set(numbers)) < len(numbers) or any(len(by_number.get(n, [])) != 1 for n in numbers):
        return None
    return [Pair(by_number[number][0], path) for number, path in zip(numbers, photographs, strict=True)]


def pairs_by_list(path: Path, pictures: Path, photographs: Path) -> list[Pair]:
    """Read a list of pairs: a picture and a photograph per line, separated by a comma, semicolon or tab."""
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a list of pairs ({error})") from None
    pairs: list[Pair] = []
    for number, line in enumerate(lines, 1):
        words = [word.strip() for word in re.split(r"[,;\t]", line)]
        if not line.strip():
            continue
        if len(words) != 2:
            raise InputError(f"{path}: line {number} has {len(words)} names, expected PICTURE, PHOTOGRAPH")
        pair = Pair(pictures / words[0], photographs / words[1])
        for each in (pair.picture, pair.photograph):
            if not each.is_file():
                raise InputError(f"{path}: line {number} names {each}, which does not exist")
        if pair.photograph in [each.photograph for each in pairs]:
            raise InputError(f"{path}: line {number} names {words[1]} again; list each photograph once")
        pairs.append(pair)
    return pairs


def check_count(count: int, where: Path) -> None:
    if count < LEAST:
        raise InputError(f"{where}: {count} pairs, expected at least {LEAST}; photograph more pictures")


def read_pictures(paths: Sequence[Path]) -> NDArray[np.uint8]:
    """Read projector pictures as 8-bit code values, (pictures, height, width, 3). All must have the same size."""
    return np.stack(list(each_picture(paths)))


def each_picture(paths: Sequence[Path]) -> Iterator[NDArray[np.uint8]]:
    """Like `read_pictures`, one picture at a time."""
    first: tuple[int, ...] = ()
    for path in paths:
        picture = _coloured(read_photograph(path))
        codes = np.rint(picture / 257).astype(np.uint8) if picture.dtype == np.uint16 else picture
        first = first or codes.shape
        _check_size(path, codes.shape, first, paths[0])
        yield codes


def read_photographs(
    paths: Sequence[Path], response: Response | None, size: Size | None = None
) -> NDArray[np.floating]:
    """Read photographs as linear light, (photographs, height, width, 3), 1 at the largest code value.

    A reduced pixel is 1 where any of its sites is saturated.

    response : the camera's response; None for linear RAW and 16-bit files, and sRGB for 8-bit files.
    size : (width, height) to reduce to; None to divide the size by the least integer for LONGEST_SIDE.
    """
    return np.stack(list(each_photograph(paths, response, size)))


def each_photograph(
    paths: Sequence[Path], response: Response | None, size: Size | None = None
) -> Iterator[NDArray[np.floating]]:
    """Like `read_photographs`, one photograph at a time."""
    first: tuple[int, ...] = ()
    for path in track(paths, "photographs", len(paths)):
        picture = _coloured(read_photograph(path))
        first = first or picture.shape
        _check_size(path, picture.shape, first, paths[0])
        if size is not None:
            _check_reduction(path, picture.shape, size)
        if response is not None:
            refuse_curve(path, response, "--camera-response")
        here = response or default_response(path, picture)
        light = here.to_linear(picture / np.float32(np.iinfo(picture.dtype).max)).astype(np.float32)
        to = size or room_size(first)
        clipped = cv2.resize((light >= SATURATED).astype(np.float32), to, interpolation=cv2.INTER_AREA)
        yield np.where(clipped > 0, 1, cv2.resize(light, to, interpolation=cv2.INTER_AREA)).astype(np.float32)


def read_photograph(path: Path) -> NDArray[Any]:
    """Read a picture upright, 8 or 16 bits, R'G'B' or grey: PNG, JPEG, RAW or TIFF."""
    if path.suffix.lower() not in TIFF:
        return stored.read_photograph(path, upright=True)
    content = np.frombuffer(read_bytes(path, MAX_BYTES, "save it as PNG"), np.uint8)
    try:
        with silence():  # OpenCV applies the orientation tag of a TIFF, but imread fails for quarter turns
            found = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        found = None
    if found is None or found.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: cannot be read as TIFF of 8 or 16 bits; save it as PNG")
    return found if found.ndim == 2 else np.ascontiguousarray(found[..., 2::-1])


def default_response(path: Path, picture: NDArray[Any]) -> Response:
    """Return sRGB for 8-bit files, and linear for RAW and 16-bit files."""
    return Response("srgb" if picture.dtype == np.uint8 and not is_raw(path) else "linear")


def room_size(shape: Sequence[int]) -> Size:
    """Return (width, height) of the camera of a room made of photographs of this shape."""
    divisor = -(-max(shape[:2]) // LONGEST_SIDE)
    return shape[1] // divisor, shape[0] // divisor


def _coloured(picture: NDArray[Any]) -> NDArray[Any]:
    return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)


def _check_size(path: Path, found: Sequence[int], first: Sequence[int], of: Path) -> None:
    if tuple(found) != tuple(first):
        raise InputError(
            f"{path}: {found[1]}x{found[0]}, but {of.name} is {first[1]}x{first[0]}; all must have the same size"
        )


def _check_reduction(path: Path, shape: Sequence[int], size: Size) -> None:
    height, width = shape[:2]
    fitting = size[0] * height / width
    if min(size) < SHORTEST_SIDE or size[0] > width or abs(size[1] - fitting) > max(1, STRETCHED * fitting):
        usual = room_size(shape)
        raise InputError(
            f"{path}: {width}x{height} cannot be reduced to {size[0]}x{size[1]}; expected the same aspect ratio, at "
            f"least {SHORTEST_SIDE} pixels a side and at most the photograph's size, such as {usual[0]}x{usual[1]}"
        )
