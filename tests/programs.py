"""Programs as a user runs them: whole commands, and processes that continue while a test observes them."""

import contextlib
import io
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from counterlight.tools import verbs
from tests.copies import Copy, read_early

if TYPE_CHECKING:
    import pytest

ROOT = Path(__file__).resolve().parents[1]
PATIENCE_S = 120.0  # for a process that hangs; a busy machine takes half of it
LONGEST_S = 300.0  # limit for a whole command


def python(*arguments: str) -> str:
    """Run a fresh interpreter and return its output; fail with the error output unless it exits with 0."""
    outcome = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, cwd=ROOT, timeout=120, check=False
    )
    assert outcome.returncode == 0, outcome.stderr
    return outcome.stdout


def script(name: str) -> str:
    """Path of a console script of this environment."""
    return str(Path(sys.executable).with_name(name))


def verb(name: str) -> tuple[str, str]:
    """First words of a command line: `counterlight NAME`."""
    return script("counterlight"), name


def command(name: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a verb to its end; a hang fails the test."""
    with started([*verb(name), *map(str, arguments)], environment) as process:
        output, errors = process.communicate(timeout=LONGEST_S)
        return subprocess.CompletedProcess(process.args, process.returncode, output, errors)


def succeed(name: str, *arguments: object, **environment: str) -> str:
    done = command(name, *arguments, **environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def here(name: str, *arguments: object) -> str:
    """Run a verb in this process, where its code is loaded already, and return its output."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        assert verbs.main([name, *map(str, arguments)]) == 0
    return output.getvalue()


def refusal_here(
    main: Callable[[Sequence[str]], int], capsys: "pytest.CaptureFixture[str]", folder: Path, *arguments: object
) -> str:
    """Run a command's `main` that must refuse, and return its only line of output.

    folder : must hold the same files before and after.
    """
    before = sorted(folder.rglob("*"))
    printed, line = _refused(main, capsys, arguments)
    assert printed == ""
    assert sorted(folder.rglob("*")) == before
    return line


def error_here(main: Callable[[Sequence[str]], int], capsys: "pytest.CaptureFixture[str]", *arguments: object) -> str:
    """Run a command's `main` that must be refused, and return its only line of error output."""
    return _refused(main, capsys, arguments)[1]


def _refused(
    main: Callable[[Sequence[str]], int], capsys: "pytest.CaptureFixture[str]", arguments: Sequence[object]
) -> tuple[str, str]:
    """Run a command's `main` that must be refused; returns its output and its only line of error output."""
    assert main([str(each) for each in arguments]) == 2
    printed = capsys.readouterr()
    line = printed.err.removesuffix("\n")
    assert re.fullmatch("error: .+", line)
    return printed.out, line


def fail(name: str, *arguments: object, code: int = 2, **environment: str) -> str:
    """Run a command that must be refused, and return its only line of error output."""
    done = command(name, *arguments, **environment)
    assert done.returncode == code, done.stdout + done.stderr
    lines = [line for line in done.stderr.splitlines() if line]
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("error: ")
    return lines[0]


def on(display: str) -> dict[str, str]:
    """Environment variables that send a program's windows to an X server."""
    return {"DISPLAY": display, "WAYLAND_DISPLAY": ""}


@contextmanager
def running(
    *words: object, folder: Path | None = None, errors: int | None = subprocess.PIPE, given: int = 0, **environment: str
) -> Iterator[subprocess.Popen[str]]:
    """Start a program, and kill it at the end if it still runs."""
    with started([*map(str, words)], environment, folder=folder, errors=errors, given=given) as process:
        yield process


@contextmanager
def started(
    words: list[str],
    environment: Mapping[str, str],
    *,
    folder: Path | None = None,
    errors: int | None = subprocess.PIPE,
    given: int = 0,
) -> Iterator[subprocess.Popen[str]]:
    """Start a verb, `python -m` or `python -c` as a copy of the warm interpreter (warm_start.py).

    Any other program starts in a new process. `given` is the descriptor of its standard input.
    """
    variables = os.environ | environment
    process: Any
    of_python = words[0] == sys.executable and words[1] in ("-m", "-c")
    warm = of_python or words[0] == script("counterlight")
    if not warm or "FRESH" in os.environ or read_early(variables):
        process = subprocess.Popen(
            words, env=variables, cwd=folder, stdin=given, stdout=subprocess.PIPE, stderr=errors, text=True
        )
    else:
        process = Copy(words[of_python:], variables, folder or Path.cwd(), errors, given)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_until(
    condition: Callable[[], bool], what: str, process: subprocess.Popen[str], *, every_s: float = 0.05
) -> None:
    """Wait until a condition holds; fail if the process ends before, or after PATIENCE_S."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, what
        time.sleep(every_s)


def children(pid: int) -> set[int]:
    """Processes that a process has started; empty if it has ended."""
    found: set[int] = set()
    with contextlib.suppress(OSError):  # the process or one of its threads may end while the folder is read
        for task in os.listdir(f"/proc/{pid}/task"):
            with contextlib.suppress(OSError):
                found |= set(map(int, Path(f"/proc/{pid}/task/{task}/children").read_text().split()))
    return found


def descendants(pid: int) -> set[int]:
    """Children of a process, their children, and so on."""
    found = children(pid)
    return found.union(*map(descendants, found))


def is_running(pid: int) -> bool:
    """Whether a process exists and is not a zombie, because some containers never reap orphans."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
