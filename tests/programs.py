"""Programs as a user runs them: whole commands, and processes that go on while a test looks at them."""

import atexit
import contextlib
import functools
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from tests import warm_start

ROOT = Path(__file__).resolve().parents[1]
PATIENCE_S = 60.0
LONGEST_S = 300.0  # of a whole command; a hang is a failure
# What no library reads before a program needs it; with other variables, an interpreter is started anew.
LATE = {"DISPLAY", "WAYLAND_DISPLAY", "HOME", "PATH", "TMPDIR", "NOTIFY_SOCKET", "PYTEST_CURRENT_TEST"}
FRESH = "FRESH"  # this variable: every command by an interpreter that is started anew


def python(*arguments: str) -> str:
    """What a fresh interpreter prints; the test fails with its error output if it does not end well."""
    outcome = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, cwd=ROOT, timeout=120, check=False
    )
    assert outcome.returncode == 0, outcome.stderr
    return outcome.stdout


def script(name: str) -> str:
    """A console script of this environment."""
    return str(Path(sys.executable).with_name(name))


def verb(name: str) -> tuple[str, str]:
    """The beginning of a command line: `counterlight NAME`."""
    return script("counterlight"), name


def command(name: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a verb to its end, in a copy of an interpreter that has read the libraries (warm_start.py)."""
    words, variables = [*verb(name), *map(str, arguments)], os.environ | environment
    if FRESH in os.environ or _read_early(variables):
        return subprocess.run(words, capture_output=True, text=True, timeout=LONGEST_S, env=variables, check=False)
    return _copied(words, variables)


@functools.cache
def _warm() -> tuple[socket.socket, Mapping[str, str]]:
    """Where requests go, and the variables with which the libraries were read."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    atexit.register(ours.close)
    with theirs:
        words = sys.executable, warm_start.__file__, str(theirs.fileno())
        readable, pipe = os.pipe()  # Python treats streams by what they are at its start
        os.close(readable)
        subprocess.run(words, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, check=True)
        os.close(pipe)
    return ours, dict(os.environ)


def _read_early(variables: Mapping[str, str]) -> bool:
    _, before = _warm()
    return any(
        variables.get(name) != before.get(name) and name not in LATE and not name.startswith("XDG_")
        for name in {*variables, *before}
    )


def _copied(words: list[str], variables: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    pipes = [os.pipe() for _ in range(3)]  # stdout, stderr, replies
    with contextlib.ExitStack() as stack, ThreadPoolExecutor(2) as readers:
        output, errors, replies = (stack.enter_context(open(readable)) for readable, _ in pipes)
        try:
            asked = warm_start.request_here(words, dict(variables))
            socket.send_fds(_warm()[0], [asked], [0, *(writable for _, writable in pipes)])
        finally:
            for _, writable in pipes:
                os.close(writable)
        read = [readers.submit(stream.read) for stream in (output, errors)]
        timer = threading.Timer(LONGEST_S, os.kill, (int(replies.readline()), signal.SIGKILL))
        timer.start()
        try:
            said, complained = (each.result() for each in read)
            return subprocess.CompletedProcess(words, int(replies.readline()), said, complained)
        finally:
            timer.cancel()


def succeed(name: str, *arguments: object, **environment: str) -> str:
    done = command(name, *arguments, **environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def fail(name: str, *arguments: object, code: int = 2, **environment: str) -> str:
    """The one line that a refused command prints."""
    done = command(name, *arguments, **environment)
    assert done.returncode == code, done.stdout + done.stderr
    lines = [line for line in done.stderr.splitlines() if line]
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("error: ")
    return lines[0]


def on(display: str) -> dict[str, str]:
    """The variables by which a program's windows come to an X server."""
    return {"DISPLAY": display, "WAYLAND_DISPLAY": ""}


@contextmanager
def running(
    *words: object, folder: Path | None = None, errors: int | None = subprocess.PIPE, **environment: str
) -> Iterator[subprocess.Popen[str]]:
    """A program that is killed at the end, if it has not ended by then."""
    process = subprocess.Popen(
        [*map(str, words)],
        env=os.environ | environment,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=errors,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_until(
    condition: Callable[[], bool], what: str, process: subprocess.Popen[str], *, every_s: float = 0.05
) -> None:
    """Fails if the process ends before, or after PATIENCE_S."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, what
        time.sleep(every_s)


def descendants(pid: int) -> set[int]:
    """The children of a process, their children, and so on."""
    found: set[int] = set()
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):  # gone meanwhile
            for child in map(int, task.read_text().split()):
                found |= {child} | descendants(child)
    return found


def is_running(pid: int) -> bool:
    """Neither gone nor a zombie: nobody reaps orphans in some containers."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
