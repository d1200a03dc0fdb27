"""The parent's end of a decoder process: start it, hear it, share memory with it, end it.

Commands and events are JSON lines (decoder.py lists them); pixels go through a ring of slots in a memory-mapped file
that is unlinked as soon as both sides have mapped it.
"""

import contextlib
import json
import mmap
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import IO, Any

from numpy.typing import NDArray

from player.errors import InputError
from player.frames import PixelFormat, slot_bytes, slot_planes

SILENCE_S = 2.0  # four heartbeats: the process is stopped
STUCK_S = 60.0  # on one picture; the slowest accepted (2^26 pixels) takes a few, a deadlocked codec takes for ever


class DecoderLink:
    """One decoder process, its ring, and a thread that turns its lines into events."""

    def __init__(self, number: int, arguments: dict[str, Any]) -> None:
        self._events: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._folder: str | None = None
        self._ring: mmap.mmap | None = None
        self._planes: list[tuple[NDArray[Any], ...]] = []
        self._cause: str | None = None
        self.busy_s = 0.0
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (closed with the process)
        self.process = start_child("player.decoding.decoder", json.dumps(arguments), self._errors)
        self._looked = time.monotonic()
        self._heard: float | None = None
        self._listener = threading.Thread(target=self._listen, name=f"decoder {number}", daemon=True)
        self._listener.start()

    def receive(self, timeout_s: float) -> dict[str, Any] | None:
        """The next event, or None when none arrives in time."""
        try:
            return self._events.get(timeout=timeout_s) if timeout_s else self._events.get_nowait()
        except queue.Empty:
            return None

    def send(self, command: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # it has died: that arrives as an event
            self.process.stdin.write(json.dumps(command).encode() + b"\n")
            self.process.stdin.flush()

    def silent_s(self) -> float:
        """Seconds since the last sign of life, 0 before the first (the interpreter starts).

        Does not count those in which nobody looked: we may have been stopped, too.
        """
        now = time.monotonic()
        if self._heard is not None and now - self._looked > 0.5 * SILENCE_S:
            self._heard = now
        self._looked = now
        return 0.0 if self._heard is None else now - self._heard

    def make_ring(self, slots: int, pixels: PixelFormat) -> None:
        """Create and map a ring file, in memory where there is room, and tell the decoder."""
        size = slots * slot_bytes(pixels)
        self._folder, path = _ring_file(size)
        with path.open("r+b") as file:
            self._ring = mmap.mmap(file.fileno(), size)
        self._planes = [slot_planes(self._ring, pixels, slot) for slot in range(slots)]
        self.send({"ring": str(path), "slots": slots})

    def planes(self, slot: int) -> tuple[NDArray[Any], ...]:
        return self._planes[slot]

    def remove_ring_file(self) -> None:
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def kill(self, cause: str) -> None:
        self._cause = cause
        self.process.kill()

    def close(self) -> None:
        """Ask it to quit, insist after a second, and free everything but the ring that frames may still show."""
        self.send({"quit": True})
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        try:
            self.process.wait(1.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._listener.join()
        assert self.process.stdout is not None
        self.process.stdout.close()
        self._errors.close()
        self.remove_ring_file()
        self._planes = []
        if self._ring is not None:
            with contextlib.suppress(BufferError):  # a frame is still held: the mapping lives as long as it
                self._ring.close()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._heard = time.monotonic()
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


def start_child(module: str, argument: str, errors: IO[bytes] | int) -> subprocess.Popen[bytes]:
    """Run a module with this interpreter, in a process group of its own: Ctrl-C is for the parent to handle."""
    package_folder = str(Path(__file__).resolve().parents[2])
    search = os.pathsep.join(filter(None, [package_folder, os.environ.get("PYTHONPATH")]))
    # One BLAS thread and few arenas: each would reserve address space, which the decoder limits for itself.
    environment = os.environ | {"PYTHONPATH": search, "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "4"}
    return subprocess.Popen(
        [sys.executable, "-P", "-m", module, argument],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        env=environment,
        process_group=0 if os.name == "posix" else None,
    )


def _ring_file(size: int) -> tuple[str, Path]:
    """A new folder and in it a file of `size` bytes that are really there: a full /dev/shm would end in SIGBUS."""
    for parent in ("/dev/shm", tempfile.gettempdir()):
        if not os.access(parent, os.W_OK):
            continue
        folder = tempfile.mkdtemp(prefix=f"counterlight-{os.getpid()}-", dir=parent)
        path = Path(folder, "ring")
        try:
            with path.open("wb") as file:
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(file.fileno(), 0, size)
                file.truncate(size)
            return folder, path
        except OSError:
            shutil.rmtree(folder, ignore_errors=True)
    place = tempfile.gettempdir()
    raise InputError(f"no room for {size >> 20} MiB of decoded frames in {place}; free some, or set TMPDIR")


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return "unknown"
