"""A decoder's process from both sides: how the player starts and buries it, what the process does to itself.

Imported before anything large, so that a decoder's first sign of life comes as soon as Python runs.
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
MAX_UNSENT = 1 << 20  # bytes
LAST_WORDS_S = 1.0  # from the wish that a decoder ends to its end by force
_graves: set[threading.Thread] = set()


def start_child(module: str, errors: IO[bytes] | int, files: Sequence[int] = ()) -> subprocess.Popen[bytes]:
    """Run a module with this interpreter, in a process group of its own: Ctrl-C is for the parent to handle.

    What it is to do is the first line that it reads, and not on its command line, which everybody can read.

    files : descriptors that it inherits.
    Raises InputError when the system gives no process.
    """
    package_folder = str(Path(__file__).absolute().parents[3])  # links stay: the package may be laid out in them
    search = os.pathsep.join(filter(None, [package_folder, os.environ.get("PYTHONPATH")]))
    # One BLAS thread and few arenas: each would reserve address space, which the decoder limits for itself.
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
    """Lines to a child, written without ever waiting: what its pipe does not take now is kept for the next time."""

    def __init__(self, child: subprocess.Popen[bytes]) -> None:
        assert child.stdin is not None
        self._child, self._pipe, self._unsent = child, child.stdin, bytearray()
        os.set_blocking(self._pipe.fileno(), False)

    def send(self, line: bytes) -> None:
        self._unsent += line + b"\n"
        self.flush()
        if len(self._unsent) > MAX_UNSENT:
            self._child.kill()  # it does not read; its listener will hear that it has died

    def flush(self) -> None:
        """Write what is left, as far as it is taken."""
        with contextlib.suppress(ValueError, OSError):  # full, or dead, which arrives as an event
            while self._unsent:
                del self._unsent[: os.write(self._pipe.fileno(), self._unsent)]


def bury(child: subprocess.Popen[bytes], afterwards: Callable[[], None], patience_s: float = LAST_WORDS_S) -> None:
    """See a child to its end beside the show, killing it after a while; then do what is left to do."""
    assert child.stdin is not None
    with contextlib.suppress(OSError):
        child.stdin.close()

    def wait() -> None:
        try:
            child.wait(patience_s)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        assert child.stdout is not None
        afterwards()
        child.stdout.close()
        _graves.discard(threading.current_thread())

    grave = threading.Thread(target=wait, name=f"end of {child.pid}", daemon=True)
    _graves.add(grave)
    grave.start()


def all_buried(patience_s: float = 2 * LAST_WORDS_S) -> None:
    """Wait until every child that was to end has ended; one that the kernel holds is given up."""
    until = time.monotonic() + patience_s
    for grave in list(_graves):
        grave.join(max(until - time.monotonic(), 0.0))


atexit.register(all_buried)


def private_stdout() -> IO[bytes]:
    """Keep the pipe to the parent for events: libraries print warnings to file descriptor 1."""
    pipe = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    return os.fdopen(pipe, "wb")


def limit_memory(most: float = MAX_ADDRESS_SPACE) -> None:
    """Bound the address space, so that a hostile header fails here and does not swap the machine to death.

    most : bytes; infinity takes the bound back.
    """
    try:
        import resource
    except ImportError:  # not a POSIX system
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = hard if most == float("inf") else int(most) if hard == resource.RLIM_INFINITY else min(int(most), hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
