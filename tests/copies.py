"""Copies of an interpreter that has imported the product (warm_start.py); they act like subprocess.Popen."""

import atexit
import functools
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TextIO

from tests import warm_start

# Variables that no module reads at import. A change to any other variable needs a new interpreter.
LATE = {"DISPLAY", "WAYLAND_DISPLAY", "HOME", "PATH", "TMPDIR", "NOTIFY_SOCKET", "PYTEST_CURRENT_TEST"}
LATE |= {"__EGL_VENDOR_LIBRARY_DIRS", "OMP_WAIT_POLICY"}  # read by the first OpenGL context and the first parallel loop
ERRORS = 2  # descriptor of standard error, which a process may share with this one


@functools.cache
def _warm() -> tuple[socket.socket, Mapping[str, str]]:
    """Start the warm interpreter; return its request socket and the variables that were set at import."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    atexit.register(ours.close)
    readable, pipe = os.pipe()  # Python chooses the buffering of its streams at startup, so they must be pipes then
    words = sys.executable, warm_start.__file__, str(theirs.fileno())
    with theirs:
        subprocess.run(
            words, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, check=True
        )
    os.close(readable)
    os.close(pipe)
    return ours, dict(os.environ)


def read_early(variables: Mapping[str, str]) -> bool:
    """Whether a variable is read during import, so that changing it later has no effect on a copy."""
    _, before = _warm()
    return any(
        variables.get(name) != before.get(name) and name not in LATE and not name.startswith("XDG_")
        for name in {*variables, *before}
    )


class Copy:
    """Process with the part of subprocess.Popen's interface that tests use; text through pipes."""

    def __init__(
        self, words: list[str], variables: Mapping[str, str], folder: Path, errors: int | None, given: int = 0
    ) -> None:
        """Start a copy.

        words : a script, -m MODULE or -c CODE, and its arguments.
        errors : a descriptor, PIPE, or None for this process's standard error.
        given : descriptor of its standard input.
        """
        self.args, self.returncode = words, None
        self.stdout: TextIO
        self.stderr: TextIO | None = None
        self.stdout, output = _pipe()
        replies, reply = _pipe()
        theirs = [output, reply]
        if errors == subprocess.PIPE:
            self.stderr, errors = _pipe()
            theirs.append(errors)
        asked = warm_start.request_here(words, dict(variables), folder)
        socket.send_fds(_warm()[0], [asked], [given, output, ERRORS if errors is None else errors, reply])
        for descriptor in theirs:
            os.close(descriptor)
        self._replies = replies
        line = replies.readline()
        assert line, "the interpreter that has imported the product has ended: try python tests/warm_start.py 0"
        self.pid = int(line)
        self._readers: ThreadPoolExecutor | None = None
        self._texts: list[Future[str]] = []

    def poll(self) -> int | None:
        return self._ended(0)

    def wait(self, timeout: float | None = None) -> int:
        if self._ended(timeout) is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0)
        return self.returncode

    def _ended(self, timeout: float | None) -> int | None:
        if self.returncode is None and select.select([self._replies], [], [], timeout)[0]:
            self.returncode = int(self._replies.readline())
            self._replies.close()
        return self.returncode

    def communicate(self, timeout: float | None = None) -> tuple[str, str | None]:
        """Wait for the end and return the unread text of stdout and stderr; may be called repeatedly."""
        until = None if timeout is None else time.monotonic() + timeout
        streams = [stream for stream in (self.stdout, self.stderr) if stream]
        if not self._readers:
            self._readers = ThreadPoolExecutor(len(streams))
            self._texts = [self._readers.submit(_rest, stream) for stream in streams]
        try:
            texts = [each.result(None if until is None else max(until - time.monotonic(), 0)) for each in self._texts]
        except TimeoutError:
            raise subprocess.TimeoutExpired(self.args, timeout or 0) from None
        self.wait(None if until is None else max(until - time.monotonic(), 0.1))
        self._readers.shutdown()
        return texts[0], texts[1] if self.stderr else None

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def _pipe() -> tuple[TextIO, int]:
    readable, writable = os.pipe()
    return open(readable), writable


def _rest(stream: TextIO) -> str:
    with stream:
        return stream.read()
