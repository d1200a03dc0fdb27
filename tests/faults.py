"""Faults at every step of writing to disk, for tests and campaigns: kills, refusals, full disks.

A runner is a copy of the warm interpreter (warm_start.py) that forks for every run, so that hundreds of runs take
seconds:

    with Runner() as runner:
        run = runner.run("counterlight.tools.build_correction_map:main", [[str(room)]], Fault(at=17))
        assert run.code == -9 or not run.struck  # killed before its 17th step, or done in fewer

Steps are calls from Python to the system: STEPS, files opened for writing, and the exchange of folders. Libraries also
write between steps. A small file system (`small_disk`) or a file size limit (`most_bytes`) makes those writes fail.
"""

import contextlib
import errno
import importlib
import io
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from counterlight.errors import InputError
from counterlight.writing import disk
from tests.copies import Copy

ROOT = Path(__file__).resolve().parents[1]
STEPS = ("mkdir", "rename", "replace", "unlink", "remove", "rmdir", "fsync", "ftruncate", "pwrite")
KILL, REFUSE = "kill", "refuse"


@dataclass(frozen=True)
class Fault:
    """Fault that is injected into a run.

    at : number of the faulty step, from 1; 0 for none.
    how : KILL kills the process before the step; REFUSE fails the step with "no space".
    most_bytes : largest allowed file size.
    exchange : whether the system can exchange folders.
    """

    at: int = 0
    how: str = KILL
    most_bytes: int | None = None
    exchange: bool = True


@dataclass(frozen=True)
class Run:
    """End of a run.

    at : number of the faulty step.
    steps : steps that the run took.
    code : return value of the function, 2 for an InputError, -9 if killed.
    words : text of the InputError, or of an exception that no function may raise.
    """

    at: int
    steps: int
    code: int
    words: str

    @property
    def struck(self) -> bool:
        return 0 < self.at <= self.steps


class Runner:
    """Runs functions (`module:name`, arguments as JSON) in forks of one process."""

    def __init__(self) -> None:
        given, requests = os.pipe()
        self._requests = os.fdopen(requests, "w")
        self._process = Copy(["-m", "tests.faults"], os.environ, ROOT, None, given)
        os.close(given)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._requests.close()
        self._process.communicate()

    def run(self, function: str, arguments: Sequence[Any], fault: Fault | None = None) -> Run:
        request = {"function": function, "arguments": list(arguments), "fault": asdict(fault or Fault())}
        print(json.dumps(request), file=self._requests, flush=True)
        answer = self._process.stdout.readline()
        assert answer, "the runner has ended"
        return Run(**json.loads(answer))


def refused_here(function: Callable[..., Any], arguments: Sequence[Any], fault: Fault) -> Run:
    """Run a function in this process and refuse a step; what it leaves locked then stays locked."""
    assert fault.how == REFUSE
    counter = _Counter(fault, lambda _: None)
    with counter.installed():
        code, words = _outcome(function, arguments)
    return Run(fault.at, counter.steps, code, words)


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[None]:
    """Mount a file system of `size` bytes at a folder; needs the right to mount."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@contextmanager
def no_file_above(size: int) -> Iterator[None]:
    """Make this process fail to write files above `size` bytes, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def can_mount() -> bool:
    command = ["unshare", "--mount", "true"]
    return os.geteuid() == 0 and subprocess.run(command, check=False, capture_output=True).returncode == 0


class _Counter:
    """Counts steps and applies the fault at its step."""

    def __init__(self, fault: Fault, tell: Callable[[int], None]) -> None:
        self.fault, self.steps, self._tell = fault, 0, tell

    def wrapped(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def step(*arguments: Any, **named: Any) -> Any:
            self.steps += 1
            if self.steps == self.fault.at:
                self._strike(*arguments[:1])
            return call(*arguments, **named)

        return step

    def _strike(self, first: Any = None) -> None:
        if self.fault.how == KILL:
            self._tell(self.steps)
            os.kill(os.getpid(), signal.SIGKILL)
        # the system names the file only for calls with a path
        place = [str(first)] if isinstance(first, str | Path) else []
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), *place)

    @contextmanager
    def installed(self) -> Iterator[None]:
        calls, exchange, opened = {name: getattr(os, name) for name in STEPS}, disk._exchange, io.open
        for name, call in calls.items():
            setattr(os, name, self.wrapped(call))
        disk._exchange = self.wrapped(exchange if self.fault.exchange else lambda *_: False)  # type: ignore[assignment]
        counted = self.wrapped(opened)
        io.open = lambda *a, **k: (counted if _writes(*a, **k) else opened)(*a, **k)  # type: ignore[assignment]
        try:
            yield
        finally:
            for name, call in calls.items():
                setattr(os, name, call)
            disk._exchange, io.open = exchange, opened


def _writes(file: Any, mode: str = "r", *_: Any, **__: Any) -> bool:
    return isinstance(file, str | os.PathLike) and bool(set(mode) & set("wax+"))


def _serve() -> None:
    """Fork for every request and report how the fork ended."""
    for line in sys.stdin:
        request = json.loads(line)
        module, _, name = request["function"].partition(":")
        function = getattr(importlib.import_module(module), name)
        fault = Fault(**request["fault"])
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read)
            _run(function, request["arguments"], fault, write)
        os.close(write)
        with os.fdopen(read) as stream:
            parts = stream.read().split("\n", 2)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        steps, code, words = int(parts[0] or 0), parts[1] if len(parts) > 1 else "", parts[2] if len(parts) > 2 else ""
        print(json.dumps(asdict(Run(fault.at, steps, int(code) if code else status, words))), flush=True)


def _run(function: Callable[..., Any], arguments: list[Any], fault: Fault, write: int) -> None:
    """Run the function under a fault in the fork, reports steps, code and words, and exits."""
    counter = _Counter(fault, lambda steps: os.write(write, b"%d\n" % steps) and None)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    if fault.most_bytes is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (fault.most_bytes, resource.RLIM_INFINITY))
    with counter.installed():
        code, words = _outcome(function, arguments)
    os.write(write, f"{counter.steps}\n{code}\n{words}".encode())
    os._exit(0)


def _outcome(function: Callable[..., Any], arguments: Sequence[Any]) -> tuple[int, str]:
    """Return a function's exit code, 1 for an unexpected exception, and its error output or its exception's text."""
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            code = function(*arguments) or 0
    except InputError as error:
        return 2, str(error)
    except BaseException as error:
        return 1, repr(error)
    return code, errors.getvalue()


if __name__ == "__main__":
    _serve()
