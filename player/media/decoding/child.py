"""Decoder processes: how the player starts and ends them, and how they limit their memory.

A decoder imports this module before any large module, so that its first heartbeat comes as soon as Python runs.
"""

import atexit
import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

from counterlight.errors import InputError

MAX_ADDRESS_SPACE = 6 << 30
MAX_UNSENT = 1 << 20  # most bytes that wait for a child that does not read
LAST_WORDS_S = 1.0  # time from the request to end until the process is killed
_ending: set[threading.Thread] = set()


def start_child(module: str, errors: IO[bytes] | int, files: Sequence[int] = ()) -> subprocess.Popen[bytes]:
    """Run a module with this interpreter, in its own process group, because the parent handles Ctrl-C.

    The child reads its task as the first line of stdin, because every user can read command lines.
    Raises InputError if no process can be started.

    module : name of the module.
    errors : receives stderr.
    files : descriptors that the child inherits.
    """
    # links are not resolved, because the package may be laid out in links
    package_folder = str(Path(__file__).absolute().parents[3])
    search = os.pathsep.join(filter(None, [package_folder, os.environ.get("PYTHONPATH")]))
    # One BLAS thread and few arenas, because each reserves address space, which the decoder limits.
    environment = os.environ | {"PYTHONPATH": search, "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "4"}
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=environment,
            process_group=0 if os.name == "posix" else None,
            pass_fds=files,
        )
    except OSError as error:
        raise InputError(f"no decoder can be started ({error.strerror}); end other programs, or try again") from None


class Letters:
    """Sends lines to a child without ever waiting. Bytes that the pipe does not accept are kept for the next call."""

    def __init__(self, child: subprocess.Popen[bytes]) -> None:
        assert child.stdin is not None
        self._child, self._pipe, self._unsent = child, child.stdin, bytearray()
        os.set_blocking(self._pipe.fileno(), False)

    def send(self, line: bytes) -> None:
        self._unsent += line + b"\n"
        self.flush()
        if len(self._unsent) > MAX_UNSENT:
            self._child.kill()  # the child does not read; its listener will report its death

    def flush(self) -> None:
        """Write the remaining bytes, as far as the pipe accepts them."""
        # the pipe is full, or the child is dead, which arrives as an event
        with contextlib.suppress(ValueError, OSError):
            while self._unsent:
                del self._unsent[: os.write(self._pipe.fileno(), self._unsent)]


def end_child(child: subprocess.Popen[bytes], afterwards: Callable[[], None]) -> None:
    """End a child in the background, by force after LAST_WORDS_S. Then call `afterwards`."""
    assert child.stdin is not None
    with contextlib.suppress(OSError):
        child.stdin.close()

    def wait() -> None:
        try:
            child.wait(LAST_WORDS_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        assert child.stdout is not None
        afterwards()
        child.stdout.close()
        _ending.discard(threading.current_thread())

    thread = threading.Thread(target=wait, name=f"end of {child.pid}", daemon=True)
    _ending.add(thread)
    thread.start()


def all_ended(patience_s: float = 2 * LAST_WORDS_S) -> None:
    """Wait for all children that were asked to end. Give up on processes that the kernel blocks."""
    until = time.monotonic() + patience_s
    for thread in list(_ending):
        thread.join(max(until - time.monotonic(), 0.0))


atexit.register(all_ended)


def private_stdout() -> IO[bytes]:
    """Reserve the pipe to the parent for events, because libraries print warnings to file descriptor 1."""
    pipe = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    return os.fdopen(pipe, "wb")


def limit_memory(most: float = MAX_ADDRESS_SPACE) -> None:
    """Limit the address space, so that a hostile header fails here instead of making the machine swap.

    most : bytes; infinity removes the limit.
    """
    try:
        import resource
    except ImportError:  # not a POSIX system
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = hard if most == float("inf") else int(most) if hard == resource.RLIM_INFINITY else min(int(most), hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
