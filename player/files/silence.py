"""Silences libraries that write to the process's error output, below Python."""

import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager

STDERR = 2
_ONE = threading.Lock()


@contextmanager
def silence() -> Iterator[None]:
    """Suppress the process's error output, because OpenEXR and libpng print a line there for each problem.

    The caller reports errors in one line. Only one thread at a time, because the output belongs to the process.
    """
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        with _redirected(nowhere):
            yield
    finally:
        os.close(nowhere)


@contextmanager
def overheard() -> Iterator[list[str]]:
    """Suppress the process's error output, and yield a list that receives its lines at the end.

    LibRaw reports damage in no other way.
    """
    lines = list[str]()
    with tempfile.TemporaryFile() as file:
        with _redirected(file.fileno()):
            yield lines
        file.seek(0)
        lines += file.read().decode("utf-8", "replace").splitlines()


@contextmanager
def _redirected(descriptor: int) -> Iterator[None]:
    """Redirect the process's error output to a descriptor."""
    with _ONE:
        try:
            before = os.dup(STDERR)
        except OSError:  # the error output is already closed
            yield
            return
        try:
            os.dup2(descriptor, STDERR)
            yield
        finally:
            os.dup2(before, STDERR)
            os.close(before)
