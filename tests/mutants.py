"""Damaged files, reproducible from a seed: bytes, words of text, arrays of archives, chunks of PNG.

`mutant` damages the content of one file as a failing disk, a careless editor or an attacker would. `DamagedRoom` puts
the content into a calibration folder, renews checksums if asked, and reports the outcome of reading.
"""

import io
import re
import struct
import tomllib
import warnings
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TypeAlias

import numpy as np
import tomli_w

from counterlight import calibration
from counterlight.calibration import TOML
from counterlight.errors import InputError
from counterlight.maps import room_maps as maps
from counterlight.maps.room_maps import FOLDER, MANIFEST
from counterlight.pipeline.placement import read_placement
from counterlight.tools.transport.storage import read_transport

Rng: TypeAlias = np.random.Generator
Mutator: TypeAlias = Callable[[bytes, Rng], bytes]

READ, REFUSED = "read", "refused"
LONGEST_COMPLAINT = 1500  # characters: paths, and quoted text from the file, which is cut
MANIFEST_NAME = f"{FOLDER}/{MANIFEST}"
HEADER = 400  # bytes at the beginning, where most formats describe the rest
INTEGERS = (0, 1, -1, 2, 127, 255, 256, 65535, 1 << 20, (1 << 31) - 1, -(1 << 31), (1 << 32) - 1, 1 << 40, -(1 << 63))
NUMBERS = (np.nan, np.inf, -np.inf, -1.0, 1e30, -1e30, 3.4e38, 1e-45, 1e300)
WORDS = re.findall(
    r"\S+",
    """
    0 1 -1 0.0 -0.5 5e-324 1e30 1e300 1e400 -1e400 nan inf -inf 0x7fffffffffffffff 9223372036854775808 65536 268435456
    1979-05-27 true false "" "srgb" "../../secret" "/etc/passwd" "\\u0000" [] [[]] [[0],[1]] {} {a=1} [1,2,3] ' ~
    """,
)
TYPES = re.findall(r"\S+", "<f4 <f8 >f8 <f2 <f16 <i8 <i4 >i2 |u1 <u8 |b1 <c8 |S3 <U3 |O <M8[s] |V4 |S0 f4,f4")
SHAPES = re.findall(r"\S+", "() (0,) (-1,) (1,) (7,) (2,2) (3,3,3) (1000000000,) (1e23,) (999999999999999999,) (True,)")


def mutant(content: bytes, name: str, rng: Rng) -> bytes:
    """Damage a file once or twice, mostly in ways specific to its format."""
    own = BY_SUFFIX.get(Path(name).suffix.lower(), ANY_FILE)
    for _ in range(rng.integers(1, 3)):
        kinds = ANY_FILE if not rng.integers(3) else own
        content = kinds[rng.integers(len(kinds))](content, rng)
    return content


def outcome(read: Callable[[], object]) -> str:
    """Returns READ, or REFUSED for one line of bounded length; fails on any other exception or warning."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read()
    except InputError as error:
        line = str(error)
        assert "\n" not in line, line
        assert 0 < len(line) <= LONGEST_COMPLAINT, line
        return REFUSED
    return READ


@dataclass(frozen=True)
class DamagedRoom:
    """Calibration folder with maps, in which one file at a time is damaged. `files` is the original content."""

    folder: Path
    files: dict[str, bytes]

    @classmethod
    def of(cls, folder: Path) -> "DamagedRoom":
        found = (path for path in sorted(folder.rglob("*")) if path.is_file())
        return cls(folder, {path.relative_to(folder).as_posix(): path.read_bytes() for path in found})

    def outcome(self, name: str, content: bytes, *, renewed: bool) -> str:
        """Outcome of reading the room with another content of a file; restores the room afterwards."""
        changed = self.put(name, content, renewed=renewed)
        try:
            return outcome(self.read)
        finally:
            for name in changed:
                (self.folder / name).write_bytes(self.files[name])

    def put(self, name: str, content: bytes, *, renewed: bool = True) -> list[str]:
        """Write a file and, if renewed, the tables with its checksum; returns the names of changed files."""
        changed = self._with_checksums(name, content) if renewed else {name: content}
        for other, content in changed.items():
            (self.folder / other).write_bytes(content)
        return list(changed)

    def read(self) -> None:
        """Read the room as the commands and the player do."""
        stored = calibration.read(self.folder)
        read_placement(self.folder)
        read_transport(stored)
        maps.read_maps(stored, words=True)

    def _with_checksums(self, name: str, content: bytes) -> dict[str, bytes]:
        """Content of the damaged file, and of the tables that hold its checksum."""
        changed = {name: content}
        if Path(name).suffix != ".toml":
            home = MANIFEST_NAME if name.startswith(f"{FOLDER}/") else TOML
            table = tomllib.loads(self.files[home].decode())
            described = {"bytes": len(content), "sha256": sha256(content).hexdigest()}
            table["files"][name.removeprefix(f"{FOLDER}/")] = described
            changed[home] = tomli_w.dumps(table).encode()
        if TOML in changed and MANIFEST_NAME in self.files:
            table = tomllib.loads(self.files[MANIFEST_NAME].decode())
            table["calibration"] = sha256(changed[TOML]).hexdigest()
            changed[MANIFEST_NAME] = tomli_w.dumps(table).encode()
        return changed


# Any file


def _flip(content: bytes, rng: Rng) -> bytes:
    damaged = bytearray(content)
    for bit in rng.integers(0, 8 * max(len(content), 1), rng.integers(1, 9)) if content else ():
        damaged[bit // 8] ^= 1 << (bit % 8)
    return bytes(damaged)


def _poke(content: bytes, rng: Rng) -> bytes:
    """Overwrite bytes with a number that many formats treat specially, in the header or anywhere."""
    value = INTEGERS[rng.integers(len(INTEGERS))]
    size = int(rng.choice([1, 2, 4, 8]))
    order = "little" if rng.integers(2) else "big"
    at = int(rng.integers(0, max(1, min(len(content), HEADER) if rng.integers(2) else len(content))))
    return content[:at] + (value % (1 << 8 * size)).to_bytes(size, order) + content[at + size :]


def _cut(content: bytes, rng: Rng) -> bytes:
    return content[: _place(content, rng)]


def _lose(content: bytes, rng: Rng) -> bytes:
    start, end = sorted((_place(content, rng), _place(content, rng)))
    return content[:start] + content[end:]


def _repeat(content: bytes, rng: Rng) -> bytes:
    start, end = sorted((_place(content, rng), _place(content, rng)))
    return content[:end] + content[start:end] + content[end:]


def _overwrite(content: bytes, rng: Rng) -> bytes:
    """Overwrite part of a file with another part or with zeros, like a lost disk block."""
    start, to, size = _place(content, rng), _place(content, rng), int(rng.integers(1, 600))
    piece = content[start : start + size] if rng.integers(2) else bytes(size)
    return content[:to] + piece + content[to + len(piece) :]


def _append(content: bytes, rng: Rng) -> bytes:
    return content + rng.bytes(int(rng.integers(1, 200)))


def _place(content: bytes, rng: Rng) -> int:
    return int(rng.integers(0, len(content) + 1))


# Text


def _change_word(content: bytes, rng: Rng) -> bytes:
    words = list(re.finditer(rb"[^\s=,\[\]{}]+", content))
    if not words:
        return content
    start, end = words[rng.integers(len(words))].span()
    return content[:start] + WORDS[rng.integers(len(WORDS))].encode() + content[end:]


def _change_lines(content: bytes, rng: Rng) -> bytes:
    """Drop, double or move a line."""
    lines = content.splitlines(keepends=True)
    if not lines:
        return content
    line = lines.pop(rng.integers(len(lines)))
    for _ in range(rng.integers(0, 3)):
        lines.insert(int(rng.integers(0, len(lines) + 1)), line)
    return b"".join(lines)


def _change_value(content: bytes, rng: Rng) -> bytes:
    """Replace a value with a long or deeply nested one."""
    deep = b"[" * 600 + b"]" * 600, b"{a=" * 99 + b"1" + b"}" * 99
    long = *deep, b"9" * 5000, b"0x" + b"f" * 400, b'"' + b"x" * 5000 + b'"'
    values = list(re.finditer(rb"(?<==)[^\n]*", content))
    if not values:
        return b"a." * 3000 + b"a = 1\n" + content
    start, end = values[rng.integers(len(values))].span()
    return content[:start] + b" " + long[rng.integers(len(long))] + content[end:]


# Formats


def _change_array(content: bytes, rng: Rng) -> bytes:
    """Damage one array of an archive, with correct directory and checksums."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    except Exception:  # another mutation has already damaged the file
        return content
    if members:
        at = int(rng.integers(len(members)))
        name, array = members[at]
        kind = rng.integers(6)
        if kind == 0:
            members.pop(at)
        elif kind == 1:
            members.append((members[rng.integers(len(members))][0], array))
        else:
            members[at] = name, (_change_header, _change_numbers, _flip, _lose)[kind - 2](array, rng)
    packed = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(packed, "w", rng.choice([0, 8])) as archive:
        warnings.simplefilter("ignore")  # duplicate member names are intended
        for name, array in members:
            archive.writestr(name, array)
    return packed.getvalue()


def _change_header(array: bytes, rng: Rng) -> bytes:
    """Change the type or shape in the header of an .npy file."""
    end = array.find(b"\n") + 1
    header = array[10:end].decode("latin-1")
    if rng.integers(2):
        header = re.sub(r"'descr': '[^']*'", f"'descr': '{TYPES[rng.integers(len(TYPES))]}'", header)
    else:
        header = re.sub(r"'shape': \([^)]*\)", f"'shape': {SHAPES[rng.integers(len(SHAPES))]}", header)
    if not rng.integers(8):
        header = "(" * 9000 + header
    return array[:8] + struct.pack("<H", len(header) % 65536) + header.encode("latin-1") + array[end:]


def _change_numbers(array: bytes, rng: Rng) -> bytes:
    """Replace numbers with impossible values of the right type."""
    try:
        values = np.load(io.BytesIO(array), allow_pickle=False)
        flat = values.ravel()
        few = rng.integers(0, max(flat.size, 1), rng.integers(1, 4)) if rng.integers(2) else slice(None)
        with np.errstate(all="ignore"):
            chosen = NUMBERS if values.dtype.kind == "f" else INTEGERS
            flat[few] = np.array(chosen[rng.integers(len(chosen))]).astype(values.dtype)
    except Exception:  # numpy cannot read the array, or it holds text
        return array
    changed = io.BytesIO()
    np.save(changed, flat.reshape(values.shape))
    return changed.getvalue()


def _change_chunk(content: bytes, rng: Rng) -> bytes:
    """Damage one chunk of a PNG, with correct checksums."""
    at, chunks = 8, []
    while at + 12 <= len(content):
        length, kind = struct.unpack(">I4s", content[at : at + 8])
        chunks.append((kind, content[at + 8 : at + 8 + length]))
        at += 12 + length
    if not chunks:
        return content
    which = int(rng.integers(len(chunks)))
    kind, body = chunks[which]
    chunks[which] = kind, _poke(body, rng)[: len(body)] if body else rng.bytes(5)
    packed = content[:8]
    for kind, body in chunks:
        packed += struct.pack(">I4s", len(body), kind) + body + struct.pack(">I", zlib.crc32(kind + body))
    return packed


def _change_exr(content: bytes, rng: Rng) -> bytes:
    """Change a number in the header's windows, channels, compression or tables."""
    value = INTEGERS[rng.integers(len(INTEGERS))] if rng.integers(2) else int(rng.integers(0, 20000))
    at = int(rng.integers(8, max(9, min(len(content), HEADER))))
    return content[:at] + (value % (1 << 32)).to_bytes(4, "little") + content[at + 4 :]


ANY_FILE: tuple[Mutator, ...] = (_flip, _poke, _cut, _lose, _repeat, _overwrite, _append)
TEXT: tuple[Mutator, ...] = (_change_word, _change_word, _change_lines, _change_value)
BY_SUFFIX: dict[str, tuple[Mutator, ...]] = {
    ".toml": TEXT,
    ".obj": TEXT,
    ".csv": TEXT,
    ".npz": (_change_array,),
    ".npy": (_change_header, _change_numbers),
    ".png": (_change_chunk,),
    ".exr": (_change_exr,),
}
