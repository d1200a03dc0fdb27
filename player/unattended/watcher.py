"""Runs a watcher, the process that calibrates the room from the film (watch_link.py), without ever waiting for it.

A watcher that dies, stays silent or sends nonsense is ended and started again after a pause, which doubles up to
LONGEST_REST_S.
"""

import fcntl
import os
import subprocess
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import IO

from counterlight.command import tell
from counterlight.unattended.room_checks import last_line
from counterlight.unattended.watch_link import Answer, Message, packed

REST_S, LONGEST_REST_S = 5.0, 60.0
STEADY_S = 300.0  # a watcher that has run this long has recovered: the next pause is REST_S again
SILENT_S = 60.0  # longest time between two answers, also while the watcher reads the room
ENDING_S = 1.0  # seconds, less than the silence after which a supervisor takes a player for dead
MOST_WAITING = 32 << 20  # bytes in the player that the watcher has not read: bursts of a 4K raster
PIPE_BYTES = 1 << 20  # largest pipe that Linux gives without privileges
MOST_LINE = 1 << 18  # most bytes of an answer
LONGEST_LINE = 1 << 12  # most bytes of a reported line of stderr


class Watcher:
    """A watcher process and the messages to it.

    command : command line of the process.
    notice : takes a line about a fault; further faults are silent until a watcher has run for STEADY_S.
    clock : seconds, monotonic.
    environment : environment variables of the process; None for the player's own.
    """

    def __init__(
        self,
        command: Sequence[str],
        notice: Callable[[str], None] = tell,
        clock: Callable[[], float] = time.monotonic,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._environment = environment
        self._command, self._notice, self._clock = list(command), notice, clock
        self._child: _Child | None = None
        self._ended: list[_Child] = []  # children that were killed and may not be gone yet
        self._rest_s, self._begins_s = REST_S, clock()
        self.fault = ""

    @property
    def running(self) -> bool:
        return self._child is not None

    def due(self) -> bool:
        """Whether `begin` should be called: nothing runs, and the pause is over."""
        return self._child is None and self._clock() >= self._begins_s

    def begin(self, *messages: Message) -> None:
        """Start the process and send it the first messages. A failure is reported as a fault."""
        try:
            self._child = _Child(self._command, self._environment, self._clock())
        except OSError as error:
            self._failed(f"it cannot be started ({error})")
            return
        for message in messages:
            self.send(message)

    def send(self, message: Message) -> None:
        """Queue a message. The whole message is dropped if too many bytes are unread."""
        if self._child is not None:
            self._child.queue(packed(message))

    def poll(self) -> Answer | None:
        """Write as many messages as the pipe accepts, and return the newest answer since the last call. Never waits."""
        self._ended = [child for child in self._ended if not child.buried()]
        child, now_s = self._child, self._clock()
        if child is None:
            return None
        try:
            child.flush()
            answer = child.answer()
        except ValueError as error:
            self._failed(f"it sent nonsense ({error})")
            return None
        if answer is not None:
            child.heard_s = now_s
            if now_s - child.began_s > STEADY_S:
                self._rest_s, self.fault = REST_S, ""
        elif child.gone():
            self._failed(f"its process has ended with {child.code}: {child.said()}")
        elif now_s - child.heard_s > SILENT_S:
            self._failed(f"it has said nothing for {SILENT_S:.0f} s")
        return answer

    def refuse(self, why: str) -> None:
        """End a watcher whose answers cannot be used. It is started again after a pause."""
        self._failed(why)

    def rest(self) -> None:
        """End the process without a fault. `due` is then true at once."""
        self._drop()
        self._begins_s = self._clock()

    def close(self) -> None:
        """End the process. Waits at most ENDING_S."""
        self._drop()
        deadline = time.monotonic() + ENDING_S
        for child in self._ended:
            child.wait(max(deadline - time.monotonic(), 0.0))
            child.buried()
        self._ended = []

    def _failed(self, why: str) -> None:
        self._drop()
        self._begins_s = self._clock() + self._rest_s
        if not self.fault:
            self._notice(f"watch: {why}; the correction stays, and another watcher begins in {self._rest_s:.0f} s")
        self.fault = why
        self._rest_s = min(2 * self._rest_s, LONGEST_REST_S)

    def _drop(self) -> None:
        if self._child is not None:
            self._child.kill()
            self._ended.append(self._child)
            self._child = None


class _Child:
    """One process with its pipes, neither of which waits. Its stderr is an anonymous file, which cannot fill a pipe."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str] | None, now_s: float) -> None:
        self.began_s = self.heard_s = now_s
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - held until the child is gone
        try:
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=self._errors, bufsize=0, env=environment
            )
        except BaseException:
            self._errors.close()
            raise
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._output = self._process.stdin, self._process.stdout
        for pipe_end in (self._input, self._output):
            os.set_blocking(pipe_end.fileno(), False)
        with suppress(OSError, AttributeError):  # without a larger pipe, the usual 64 KiB also work
            fcntl.fcntl(self._input.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._waiting: deque[memoryview] = deque()
        self._bytes = 0
        self._line = b""

    def queue(self, message: bytes) -> None:
        if self._bytes + len(message) <= MOST_WAITING:
            self._waiting.append(memoryview(message))
            self._bytes += len(message)

    def flush(self) -> None:
        """Write until the pipe is full. The rest of a message follows later."""
        with suppress(BlockingIOError, BrokenPipeError):
            while self._waiting:
                written = os.write(self._input.fileno(), self._waiting[0])
                self._bytes -= written
                self._waiting[0] = self._waiting[0][written:]
                if not self._waiting[0]:
                    self._waiting.popleft()

    def answer(self) -> Answer | None:
        """Return the newest complete answer. Raises ValueError for anything else."""
        try:
            content = os.read(self._output.fileno(), MOST_LINE)
        except BlockingIOError:
            return None
        *lines, self._line = (self._line + content).split(b"\n")
        if len(self._line) > MOST_LINE:
            raise ValueError(f"a line of more than {MOST_LINE} bytes")
        return Answer.parse(lines[-1]) if lines else None

    def said(self) -> str:
        """Return the last line of stderr."""
        self._errors.seek(max(self._errors.seek(0, os.SEEK_END) - LONGEST_LINE, 0))
        return last_line(self._errors.read())

    @property
    def code(self) -> int | None:
        return self._process.returncode

    def gone(self) -> bool:
        return self._process.poll() is not None

    def buried(self) -> bool:
        """Whether the process has ended. If so, close its pipes and files."""
        gone = self.gone()
        if gone:
            self._errors.close()
        return gone

    def kill(self) -> None:
        for pipe_end in (self._input, self._output):
            with suppress(OSError):
                pipe_end.close()
        self._process.kill()

    def wait(self, seconds: float) -> None:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
