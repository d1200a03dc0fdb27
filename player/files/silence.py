"""Libraries that write to the process's own error output, below Python."""

import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager

STDERR = 2
_ONE = threading.Lock()


@contextmanager
def silence() -> Iterator[None]:
    """Nothing goes to the process's error output: OpenEXR and libpng write a line there for each thing they dislike.

    What is wrong is said in one line by whoever called them. One thread at a time: the output is the process's.
    """
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        with _redirected(nowhere):
            yield
    finally:
        os.close(nowhere)


@contextmanager
def overheard() -> Iterator[list[str]]:
    """Silence; the list holds, at the end, the lines that would have been: LibRaw tells damage in no other way."""
    lines = list[str]()
    with tempfile.TemporaryFile() as file:
        with _redirected(file.fileno()):
            yield lines
        file.seek(0)
        lines += file.read().decode("utf-8", "replace").splitlines()


@contextmanager
def _redirected(descriptor: int) -> Iterator[None]:
    """The process's error output goes there."""
    with _ONE:
        try:
            before = os.dup(STDERR)
        except OSError:  # closed
            yield
            return
        try:
            os.dup2(descriptor, STDERR)
            yield
        finally:
            os.dup2(before, STDERR)
            os.close(before)
