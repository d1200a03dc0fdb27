"""Opens files safely: once, regular files only, up to a size limit, with a checksum. Parses TOML at a bounded cost.

Every file may be damaged, replaced or malicious. A pipe would block, a device would never end, and a file could be
replaced between a check and its use. Therefore each file is opened once and without waiting, and the checked file is
the file that is read. player/files/tables.py checks the values of a table.
"""

import hashlib
import os
import re
import shlex
import stat
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path, PurePosixPath
from typing import Any, TypeAlias

from counterlight.errors import InputError, one_line, shown

Source: TypeAlias = Path | BufferedReader  # a path, or an open file

CHUNK = 1 << 20
MAX_BYTES = 17 << 30  # largest size of a checked file; hashing the largest map takes seconds
MAX_TOML_BYTES = 1 << 20  # a calibration of 8 projectors with measured responses has 0.2 MB
MOST_PARTS = 32  # parts of a dotted key; tomllib's time grows with their square, and with the lines below a [header]
LONG_INTEGER = "an integer of more than 64 bits"
# Only possible keys matter here. Strings, numbers and comments are skipped in one step each.
_PART = r"""(?:[\w+-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_TOKEN = re.compile(
    rf"""(?P<long>{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MOST_PARTS}}})"""
    r'''|"""(?:[^\\]|\\.)*?"""|\'\'\'.*?\'\'\'|(?P<open>"""|\'\'\')'''
    rf"""|{_PART}|#[^\n]*+|(?P<unclosed>["'])|[^\w+"'#-]++""",
    re.DOTALL,
)
_KINDS = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"))


@contextmanager
def opened(source: Source, fix: str) -> Iterator[BufferedReader]:
    """Yield a regular file, at its beginning; its `name` is the path. An open file is passed through.

    Raises InputError if the file is missing, not regular or unreadable.

    source : a path or an open file.
    fix : advice that ends most messages.
    """
    if not isinstance(source, Path):
        source.seek(0)
        yield source
        return
    try:
        # O_NONBLOCK, because a pipe without a writer would block for ever.
        with open(source, "rb", opener=lambda path, flags: os.open(path, flags | os.O_NONBLOCK)) as file:
            mode = os.fstat(file.fileno()).st_mode
            if not stat.S_ISREG(mode):
                found = next((name for is_kind, name in _KINDS if is_kind(mode)), "no file")
                raise InputError(f"{source}: {found}, expected a regular file; {fix}")
            yield file
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{source}: missing; {fix}") from None
    except IsADirectoryError:
        raise InputError(f"{source}: a folder, expected a regular file; {fix}") from None
    except PermissionError:
        raise InputError(f"{source}: permission denied; give this user the right to read it") from None
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror or error}); check the path and the disk") from None


def read_bytes(source: Source, most: int, fix: str) -> bytes:
    """Return the content of a regular file. Raises InputError if it actually has more than `most` bytes."""
    with opened(source, fix) as file:
        size = os.fstat(file.fileno()).st_size
        content = file.read(size + 1) if size <= most else b""
        while size <= most and (more := file.read(CHUNK)):  # the file grows, or declares no size (/proc)
            content += more
            size = len(content)
        if size > most:
            raise InputError(f"{file.name}: more than the {most} bytes that are read; {fix}")
        return content


@dataclass(frozen=True)
class DescribedFiles:
    """Access to a folder's files by the table that `describe_files` made of them.

    folder : folder of the files.
    described : relative path -> size and SHA-256.
    fix : advice that ends every message.
    """

    folder: Path
    described: Mapping[str, Any]
    fix: str

    def __contains__(self, name: str) -> bool:
        return name in self.described

    @contextmanager
    def opened(self, path: Path) -> Iterator[BufferedReader]:
        """Yield a file of the folder if it equals the described file byte for byte. Raises InputError otherwise."""
        name = path.relative_to(self.folder).as_posix()
        expected = self.described.get(name)
        if not isinstance(expected, dict):
            raise InputError(f"{self.folder}: its table of files does not list {name}; {self.fix}")
        with opened(path, self.fix) as file:
            size, stated = os.fstat(file.fileno()).st_size, expected.get("bytes")
            if size != stated or size > MAX_BYTES:
                raise InputError(
                    f"{path}: {size} bytes, expected {shown(stated)}: the file is damaged or was replaced; {self.fix}"
                )
            if hashlib.file_digest(file, "sha256").hexdigest() != expected.get("sha256"):
                raise InputError(
                    f"{path}: its SHA-256 differs from the recorded one: the file is damaged or was replaced; "
                    f"{self.fix}"
                )
            file.seek(0)
            yield file


def is_below(name: str) -> bool:
    """Whether a relative path from a file stays below its folder."""
    path = PurePosixPath(name)
    return not (path.is_absolute() or ".." in path.parts or "\0" in name)


def not_read(path: Path) -> str:
    """Return the complaint about a picture in a format that is not read, with the command that converts it."""
    command = shlex.join(["heif-convert", path.name, f"{path.stem}.png"])
    return f"{path.suffix[1:].upper() or 'HEIF'} pictures are not read; convert it, for example: {command}"


def read_toml(path: Path, fix: str) -> dict[str, Any]:
    """Parse a TOML file. Raises InputError, ending in `fix`, if it is missing, too large, too deep or invalid."""
    return parse_toml(read_bytes(path, MAX_TOML_BYTES, fix), path, fix)


def parse_toml(content: bytes, where: Path, fix: str) -> dict[str, Any]:
    """Parse TOML text, see `read_toml`. MAX_TOML_BYTES take less than a second."""
    try:
        text = content.decode("utf-8")
        _refuse_long_keys(text)
        table = tomllib.loads(text)
        _refuse_long_integers(table)
    except RecursionError:
        raise InputError(f"{where}: not valid TOML (nested too deeply); {fix}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: not valid TOML ({one_line(error)}); {fix}") from None
    except ValueError:  # int() refuses thousands of digits
        raise InputError(f"{where}: not valid TOML ({LONG_INTEGER}); {fix}") from None
    return table


def _refuse_long_keys(text: str) -> None:
    for token in _TOKEN.finditer(text):
        if token["long"]:
            raise tomllib.TOMLDecodeError(f"a dotted key of more than {MOST_PARTS} parts")
        if token["open"] or token["unclosed"]:
            return  # an unterminated string, which tomllib reports


def _refuse_long_integers(table: dict[str, Any]) -> None:
    """Refuse integers of more than 64 bits. tomllib accepts them, but float() and messages cannot handle them."""
    left: list[Any] = [table]
    while left:
        value = left.pop()
        if isinstance(value, dict):
            left += value.values()
        elif isinstance(value, list):
            left += value
        elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
            raise tomllib.TOMLDecodeError(LONG_INTEGER)
