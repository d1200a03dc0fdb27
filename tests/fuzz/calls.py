"""A program whose system calls are logged (strace): opened and written files, started programs, network addresses."""

import os
import re
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.programs import ROOT

WRITES, READS, RUNS, CALLS = "writes", "reads", "runs", "calls"
_OPENING = "open,openat,openat2,creat"
_CHANGING = (
    "rename,renameat,renameat2,unlink,unlinkat,mkdir,mkdirat,rmdir,link,linkat,symlink,symlinkat,truncate,"
    "chmod,fchmodat,chown,lchown,fchownat,mknod,mknodat,setxattr,utimensat"
)
_OTHERS = {"execve": RUNS, "execveat": RUNS, "connect": CALLS, "bind": CALLS}
_LINE = re.compile(r"^(?:\d+ +)?(\w+)\((.*)$")
_TEXT = re.compile(r'(?:AT_FDCWD|\d+)<([^>]*)>, "((?:[^"\\]|\\.)*)"|"((?:[^"\\]|\\.)*)"')
_RESULT = re.compile(r"= \d+<(/[^>]*)>")
_NUMBER = re.compile(r"(?<=/)\d+(?=/|$)")
_TO_WRITE = re.compile(r"O_WRONLY|O_RDWR|O_CREAT|O_TRUNC|O_APPEND")


def watched(words: Sequence[object], log: Path) -> list[str]:
    """Return the command line that runs a program and logs its system calls to a file."""
    strace = shutil.which("strace")
    assert strace, "strace is missing; install it with: apt-get install strace"
    traced = ",".join([_OPENING, _CHANGING, *_OTHERS])
    return [
        strace,
        "-f",
        "--seccomp-bpf",
        "-qq",
        "-y",
        "-s",
        "8192",
        "-e",
        f"trace={traced}",
        "-o",
        str(log),
        *map(str, words),
    ]


@dataclass(frozen=True)
class Call:
    """A call and its object: a path, with links resolved as far as the kernel reports, or an address."""

    kind: str
    target: str

    def __str__(self) -> str:
        return f"{self.kind} {self.target}"


def calls_of(log: Path) -> set[Call]:
    return {call for line in log.read_text(errors="replace").splitlines() for call in _calls(line)}


@dataclass(frozen=True)
class Rules:
    """Allowed calls: the calls of a harmless run (`known`), and reading the program itself and files below `roots`.

    scratch : a folder in which every call may create files, for the program's own temporary files.
    """

    known: frozenset[Call]
    roots: tuple[Path, ...]
    scratch: Path

    def broken_by(self, calls: set[Call]) -> list[str]:
        return sorted(str(call) for call in calls if not self._may(call))

    def _may(self, call: Call) -> bool:
        inside = f'sa_family=AF_UNIX, sun_path="{self.scratch}/'  # the show's own socket, whose name changes
        if call in self.known or call.target.startswith(inside) or _is_below(call.target, self.scratch):
            return True
        return call.kind == READS and any(_is_below(call.target, root) for root in (*OURS, *self.roots))


OURS = tuple(
    {Path(sys.prefix), Path(sys.base_prefix), ROOT / "player", ROOT / "tools", ROOT / "tests", ROOT / "shaders"}
)
OURS += Path("/usr"), Path("/lib"), Path("/lib64"), Path(os.devnull), Path("/sys/devices/system/cpu")


def _calls(line: str) -> Iterator[Call]:
    found = _LINE.match(line)
    opened = _RESULT.search(line)
    if found is None or found[1] not in (*_OPENING.split(","), *_CHANGING.split(","), *_OTHERS):
        if opened and "resumed>" in line:
            yield Call(READS, _normal(opened[1]))
        return
    name, rest = found[1], found[2]
    if name in _OTHERS:
        kind = _OTHERS[name]
        yield Call(kind, _normal(_paths(rest)[0]) if kind == RUNS else _address(rest))
        return
    kind = WRITES if name in _CHANGING or name == "creat" or _TO_WRITE.search(rest) else READS
    for path in _paths(rest)[: 1 if name in _OPENING else 2]:
        yield Call(kind, _normal(path))
    if opened:
        yield Call(kind, _normal(opened[1]))


def _paths(arguments: str) -> list[str]:
    return [
        f"{folder}/{name}" if folder and not name.startswith("/") else name or bare
        for folder, name, bare in _TEXT.findall(arguments)
    ]


def _normal(path: str) -> str:
    """Remove the numbers of processes, descriptors and deleted files."""
    return _NUMBER.sub("N", path.removesuffix("(deleted)"))


def _address(arguments: str) -> str:
    """Return the address in text such as `{sa_family=AF_UNIX, sun_path=@"/tmp/.X11-unix/X77"}`."""
    return arguments.partition("{")[2].partition("}")[0]


def _is_below(path: str, folder: Path) -> bool:
    return path == str(folder) or path.startswith(f"{folder}/")
