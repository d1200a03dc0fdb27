"""Conditions for tests of hostile files: little memory, and a user without rights."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NOBODY = 65534
LITTLE = 384 << 20  # bytes in addition to the process's present size


@contextmanager
def little_memory(more: int = LITTLE) -> Iterator[None]:
    """Limit the process to `more` further bytes of address space, so that requests for gigabytes fail."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * os.sysconf("SC_PAGE_SIZE") + more, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@contextmanager
def without_rights() -> Iterator[None]:
    """Run as a user who owns no files if the tests run as root, because root may read everything."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)
