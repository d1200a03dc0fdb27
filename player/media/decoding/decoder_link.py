"""The parent's end of a decoder process: starts it, receives its events, shares memory with it, ends it. Never waits.

Commands and events are JSON lines (decoder.py lists them). Pixels pass through a ring of slots in anonymous shared
memory, which is freed on any exit of the processes.
"""

import contextlib
import json
import mmap
import os
import queue
import signal
import tempfile
import threading
import time
from typing import Any

from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.media.decoding.child import Letters, end_child, start_child
from counterlight.media.frames import PixelFormat, slot_bytes, slot_planes

FIRST_SIGN_S = 5.0  # Python starts in a tenth of a second, on a busy machine in a second
SILENCE_S = 2.0  # limit of four heartbeats; a process that is silent for longer counts as stopped
# limit per picture; the slowest accepted picture (2^26 pixels) takes a few seconds, and a deadlocked codec never ends
STUCK_S = 60.0


class DecoderLink:
    """One decoder process, its ring, and a thread that turns its lines into events.

    Raises InputError if no process or memory is available.
    """

    def __init__(self, number: int, arguments: dict[str, Any]) -> None:
        self._events: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._ring: mmap.mmap | None = None
        self._planes: list[tuple[NDArray[Any], ...]] = []
        self._cause: str | None = None
        self.busy_s = 0.0
        with contextlib.ExitStack() as stack:
            try:
                self._memory = _nameless_file()
                stack.callback(os.close, self._memory)
                self._errors = stack.enter_context(tempfile.TemporaryFile())
            except OSError as error:
                raise InputError(f"no decoder can be started ({error.strerror}); free some memory or disk") from None
            self.process = start_child("counterlight.media.decoding.decoder", self._errors, [self._memory])
            stack.pop_all()
        self._letters = Letters(self.process)
        self.send(arguments | {"ring": self._memory})
        self._looked = self._heard = time.monotonic()
        self._speaks = self._closed = False
        self._listener = threading.Thread(target=self._listen, name=f"decoder {number}", daemon=True)
        self._listener.start()

    def receive(self, timeout_s: float) -> dict[str, Any] | None:
        """Return the next event, None if none arrives within `timeout_s`."""
        self._letters.flush()
        try:
            return self._events.get(timeout=timeout_s) if timeout_s else self._events.get_nowait()
        except queue.Empty:
            return None

    def send(self, command: dict[str, Any]) -> None:
        self._letters.send(json.dumps(command).encode())

    @property
    def hangs(self) -> bool:
        """Whether the process has been silent for too long, or has spent too long on one picture.

        Ignores seconds in which this property was not read, because the parent may have been stopped too.
        """
        now = time.monotonic()
        if now - self._looked > 0.5 * SILENCE_S:
            self._heard = now
        self._looked = now
        return now - self._heard > (SILENCE_S if self._speaks else FIRST_SIGN_S) or self.busy_s > STUCK_S

    def map_ring(self, slots: int, pixels: PixelFormat) -> None:
        """Map the ring that the decoder has created."""
        size = slots * slot_bytes(pixels)
        if os.fstat(self._memory).st_size != size:
            raise InputError("the decoder's ring is not of the size that it announced; play the medium again")
        self._ring = mmap.mmap(self._memory, size)
        self._planes = [slot_planes(self._ring, pixels, slot) for slot in range(slots)]

    def planes(self, slot: int) -> tuple[NDArray[Any], ...]:
        return self._planes[slot]

    def kill(self, cause: str) -> None:
        self._cause = cause
        self.process.kill()

    def close(self) -> None:
        """Make the process quit, in the background. Frees everything but a ring whose frames are still held."""
        if self._closed:
            return
        self._closed = True
        self.send({"quit": True})
        self._planes = []
        if self._ring is not None:
            with contextlib.suppress(BufferError):  # a frame is still held, and keeps the mapping alive
                self._ring.close()
        end_child(self.process, self._clear)

    def _clear(self) -> None:
        self._listener.join()
        self._errors.close()
        os.close(self._memory)

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._heard, self._speaks = time.monotonic(), True
            event = json.loads(line) if line.endswith(b"\n") else {}
            self.busy_s = event.get("busy_s", 0.0)
            if "busy_s" not in event:
                self._events.put(event)
        self._events.put({"died": self._epitaph(self.process.wait())})

    def _epitaph(self, code: int) -> str:
        if self._cause is not None:
            return self._cause
        how = f"signal {-code}, {_signal_name(-code)}" if code < 0 else f"exit code {code}"
        self._errors.seek(0)
        last_words = self._errors.read().decode(errors="replace").strip().splitlines()[-1:]
        return f"decoder stopped ({': '.join([how, *last_words])})"


def _nameless_file() -> int:
    """Return a descriptor of memory that two processes can map, or of an anonymous file where no such memory exists."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("counterlight-ring")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return "unknown"
