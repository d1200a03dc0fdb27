"""Libraries that write to the process's own error output, below Python."""

import os
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
    with _ONE:
        try:
            before = os.dup(STDERR)
        except OSError:  # closed
            yield
            return
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, STDERR)
            yield
        finally:
            os.dup2(before, STDERR)
            os.close(before)
            os.close(nowhere)
