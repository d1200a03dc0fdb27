"""Files from outside: opened once, regular, read up to a limit, compared with their checksum; TOML at a bounded cost.

Whatever a command or the player reads may be damaged, replaced, or made to harm. A pipe would block, a device never
end, a file be exchanged between a check and its use: so a file is opened here, once and without waiting, and what was
checked is what is read. Numbers and texts of a table are checked by player/files/tables.py.
"""

import hashlib
import os
import re
import stat
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path, PurePosixPath
from typing import Any, TypeAlias

from counterlight.errors import InputError, one_line, shown

Source: TypeAlias = Path | BufferedReader  # a path, or a file that is open already

CHUNK = 1 << 20
MAX_BYTES = 17 << 30  # of any file that is checked, the largest map among them: to be hashed takes seconds
MAX_TOML_BYTES = 1 << 20  # a calibration of 8 projectors with measured responses has 0.2 MB
MOST_PARTS = 32  # of a dotted key: tomllib takes their square, times the lines below a [header] of them
LONG_INTEGER = "an integer of more than 64 bits"
# Of a line of TOML only what could be a key matters; strings, numbers and comments are stepped over, each once.
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
    """A regular file, from its beginning; its `name` is the path. What is open already is passed on.

    Raises InputError, ending in `fix`, where there is none; with other advice where the system refuses to read it.
    """
    if not isinstance(source, Path):
        source.seek(0)
        yield source
        return
    try:
        # O_NONBLOCK: a pipe that nobody writes to would wait for ever.
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
    """Everything that a regular file holds; InputError if it is more than `most` bytes, however long it says it is."""
    with opened(source, fix) as file:
        size = os.fstat(file.fileno()).st_size
        content = file.read(size + 1) if size <= most else b""
        while size <= most and (more := file.read(CHUNK)):  # it grows, or never told its size (/proc)
            content += more
            size = len(content)
        if size > most:
            raise InputError(f"{file.name}: more than the {most} bytes that are read; {fix}")
        return content


@dataclass(frozen=True)
class DescribedFiles:
    """A folder's files by the table that `describe_files` made of them; `fix` ends every complaint."""

    folder: Path
    described: Mapping[str, Any]
    fix: str

    def __contains__(self, name: str) -> bool:
        return name in self.described

    @contextmanager
    def opened(self, path: Path) -> Iterator[BufferedReader]:
        """A file in the folder or below, if it is byte for byte the one that was described; InputError otherwise."""
        name = path.relative_to(self.folder).as_posix()
        expected = self.described.get(name)
        if not isinstance(expected, dict):
            raise InputError(f"{self.folder}: its table of files does not list {name}; {self.fix}")
        with opened(path, self.fix) as file:
            size, told = os.fstat(file.fileno()).st_size, expected.get("bytes")
            if size != told or size > MAX_BYTES:
                raise InputError(
                    f"{path}: {size} bytes, expected {shown(told)}: the file is damaged or was replaced; {self.fix}"
                )
            if hashlib.file_digest(file, "sha256").hexdigest() != expected.get("sha256"):
                raise InputError(
                    f"{path}: its SHA-256 differs from the recorded one: the file is damaged or was replaced; "
                    f"{self.fix}"
                )
            file.seek(0)
            yield file


def is_below(name: str) -> bool:
    """Whether a path that a file gives stays below the folder it is relative to."""
    path = PurePosixPath(name)
    return not (path.is_absolute() or ".." in path.parts or "\0" in name)


def read_toml(path: Path, fix: str) -> dict[str, Any]:
    """Parse a TOML file; InputError ending in `fix` when it is missing, too large, too deep or no TOML."""
    return parse_toml(read_bytes(path, MAX_TOML_BYTES, fix), path, fix)


def parse_toml(content: bytes, where: Path, fix: str) -> dict[str, Any]:
    """See `read_toml`; at most MAX_TOML_BYTES take under a second."""
    try:
        text = content.decode("utf-8")
        _refuse_long_keys(text)
        table = tomllib.loads(text)
        _refuse_long_integers(table)
    except RecursionError:
        raise InputError(f"{where}: not valid TOML (nested too deeply); {fix}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: not valid TOML ({one_line(error)}); {fix}") from None
    except ValueError:  # of int(), for thousands of digits
        raise InputError(f"{where}: not valid TOML ({LONG_INTEGER}); {fix}") from None
    return table


def _refuse_long_keys(text: str) -> None:
    for token in _TOKEN.finditer(text):
        if token["long"]:
            raise tomllib.TOMLDecodeError(f"a dotted key of more than {MOST_PARTS} parts")
        if token["open"] or token["unclosed"]:
            return  # a string that does not end: tomllib says where


def _refuse_long_integers(table: dict[str, Any]) -> None:
    """TOML's integers have 64 bits; tomllib takes any, which neither float() nor a message can."""
    left: list[Any] = [table]
    while left:
        value = left.pop()
        if isinstance(value, dict):
            left += value.values()
        elif isinstance(value, list):
            left += value
        elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
            raise tomllib.TOMLDecodeError(LONG_INTEGER)
