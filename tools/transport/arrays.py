"""Arrays of .npy and .npz files: a header's claims are compared with the file's size before memory is allocated.

Numpy trusts a header's shape, and scipy a matrix's shape: a kilobyte can request gigabytes. Type, shape and place are
therefore read first, by numpy's parser on a bounded piece. The numbers are read on request, if they fit. Nothing is
ever unpickled. An archive is a zip file of arrays (numpy.savez), stored or deflated.
"""

import io
import os
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from io import BufferedReader
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight import memory
from counterlight.errors import InputError, one_line, shown
from counterlight.files.reading import Source, opened

HEADER_BYTES = 512  # largest accepted header; numpy writes 128 bytes
MOST_MEMBERS, MOST_DIMENSIONS = 64, 3
MAX_BYTES = 16 << 30
COPIES = 2  # an array as stored, and as converted to another type
PIECE = 1 << 20
ENCRYPTED = 1
CODES = np.uint8, np.uint16  # types of code values
NOT_LIGHT = "expected radiance in one unit, as floats; code values are not light"
RATIOS = {zipfile.ZIP_STORED: 1, zipfile.ZIP_DEFLATED: 1032}  # the highest ratio of a zlib stream
HEADERS: dict[tuple[int, int], Callable[..., tuple[tuple[int, ...], bool, np.dtype[Any]]]] = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
# Exceptions of zipfile and zlib for archives that are damaged, encrypted or packed in another way.
UNREADABLE = (ValueError, RuntimeError, NotImplementedError, EOFError, KeyError, zlib.error, zipfile.BadZipFile)


class ArrayError(ValueError):
    """An array that differs from its claim or from the expected array. The message omits the file's name."""


@dataclass(frozen=True)
class StoredArray:
    """The claims of a header; the numbers stay in the file.

    shape : at most three integers ≥ 0, of any size.
    fortran : whether the first index varies fastest.
    offset : place of the numbers, in bytes.
    """

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran: bool
    offset: int
    _open: Callable[[], AbstractContextManager[Any]]

    @property
    def nbytes(self) -> int:
        return prod(self.shape) * self.dtype.itemsize

    def expect(self, kinds: str, *shape: int | None) -> "StoredArray":
        """Return self if the type is of numpy's `kinds` and the shape agrees, else raise ArrayError.

        shape : expected lengths; None for any length.
        """
        agrees = len(self.shape) == len(shape) and all(b in (a, None) for a, b in zip(self.shape, shape, strict=True))
        if self.dtype.kind not in kinds or not agrees:
            wanted = "x".join("n" if n is None else f"{n}" for n in shape) or "a single value"
            what = {"fiu": "real numbers", "iu": "whole numbers"}.get(kinds, "text")
            raise ArrayError(f"{self.dtype} of shape {self.shape}, expected {what}, {wanted}")
        return self

    def read(self) -> NDArray[Any]:
        """Read the numbers; raises ArrayError if their number differs from the claim."""
        values = np.empty(prod(self.shape), self.dtype)
        left = values.view(np.uint8).data
        with self._open() as file:
            file.read(self.offset)
            while left and (piece := file.read(min(len(left), PIECE))):
                left[: len(piece)] = piece
                left = left[len(piece) :]
            if left or file.read(1):  # at the end of a zip member, this read verifies its checksum
                raise ArrayError("another length than its header claims")
        return values.reshape(self.shape, order="F" if self.fortran else "C")


class Members(dict[str, StoredArray]):
    """The arrays of an archive by name. file : name for error messages."""

    def __init__(self, file: str) -> None:
        super().__init__()
        self.file = file

    def __missing__(self, name: str) -> StoredArray:
        raise ArrayError(f"it has no array {name}")


@contextmanager
def opened_archive(source: Source, what: str, fix: str) -> Iterator[Members]:
    """Open the arrays of an .npz file; raises InputError `FILE: what (reason); fix` for bad files.

    A ValueError inside the block becomes such an InputError, too.
    """
    with opened(source, fix) as file, _named(file, what, fix), zipfile.ZipFile(_Measured(file)) as archive:
        members = _members(archive, file)
        needed = sum(member.nbytes for member in members.values())
        if needed > MAX_BYTES:
            raise ArrayError(f"unpacks to {needed >> 20} MiB, at most {MAX_BYTES >> 20} are read")
        memory.check(COPIES * needed, f"{file.name}: reading it", "close other programs, or thin it out")
        yield members


@contextmanager
def opened_array(source: Source, what: str, fix: str) -> Iterator[StoredArray]:
    """Open the array of an .npy file; raises InputError as `opened_archive` does."""
    with opened(source, fix) as file, _named(file, what, fix):
        array = _parsed(file.read(HEADER_BYTES), lambda: opened(file, fix))
        if os.fstat(file.fileno()).st_size != array.offset + array.nbytes:
            raise ArrayError(f"claims {array.nbytes} bytes, which are not what follows its header")
        memory.check(COPIES * array.nbytes, f"{file.name}: reading it", "close other programs, or scale it down")
        yield array


@contextmanager
def _named(file: BufferedReader, what: str, fix: str) -> Iterator[None]:
    try:
        yield
    except (*UNREADABLE, MemoryError) as error:
        raise InputError(f"{file.name}: {what} ({one_line(error)}); {fix}") from None


class _Measured:
    """A file that reads a limited amount at a time: zipfile trusts an archive's claim of its directory's length."""

    def __init__(self, file: BufferedReader) -> None:
        self._file = file
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1) -> bytes:
        if size > PIECE:
            raise zipfile.BadZipFile("its directory is damaged")
        return self._file.read(size)


def _members(archive: zipfile.ZipFile, file: BufferedReader) -> Members:
    members = Members(file.name)
    size, infos = os.fstat(file.fileno()).st_size, archive.infolist()
    if len(infos) > MOST_MEMBERS:
        raise ArrayError(f"{len(infos)} arrays, at most {MOST_MEMBERS} are read")
    for info in infos:
        name = info.filename.removesuffix(".npy")
        if name in members:
            raise ArrayError(f"two arrays {shown(name)}")
        if info.flag_bits & ENCRYPTED or info.compress_type not in RATIOS:
            raise ArrayError(f"{shown(name)} is encrypted, or packed otherwise than by numpy")
        if info.compress_size > size or info.file_size > RATIOS[info.compress_type] * info.compress_size:
            raise ArrayError(f"{shown(name)} claims {info.file_size} bytes, more than the file can hold")
        with archive.open(info) as member:
            array = _parsed(member.read(HEADER_BYTES), partial(archive.open, info))
        if info.file_size != array.offset + array.nbytes:
            raise ArrayError(f"{shown(name)} claims {array.nbytes} bytes, which are not what follows its header")
        members[name] = array
    return members


def _parsed(head: bytes, open_again: Callable[[], AbstractContextManager[Any]]) -> StoredArray:
    stream = io.BytesIO(head)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # for old or odd headers; what matters is checked below
            shape, fortran, dtype = HEADERS[np.lib.format.read_magic(stream)](stream, max_header_size=HEADER_BYTES)
    except Exception as error:  # numpy's parser raises many kinds of exceptions
        raise ArrayError(f"a header that is not numpy's: {one_line(error)}") from None
    if dtype.hasobject:
        raise ArrayError("Python objects, which are never unpickled")
    if len(shape) > MOST_DIMENSIONS or not all(type(n) is int and n >= 0 for n in shape) or not dtype.itemsize:
        raise ArrayError(f"an array of shape {shown(shape)}, {dtype}")
    return StoredArray(dtype, shape, fortran, stream.tell(), open_again)
