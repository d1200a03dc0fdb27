"""What tests of hostile files share: little memory, and a user without rights."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NOBODY = 65534
LITTLE = 384 << 20  # bytes beside what the process has


@contextmanager
def little_memory(more: int = LITTLE) -> Iterator[None]:
    """The process gets no more than so many further bytes of address space: who asks for gigabytes fails for that."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * os.sysconf("SC_PAGE_SIZE") + more, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@contextmanager
def without_rights() -> Iterator[None]:
    """As a user whom no file belongs to, where the tests run as root, who may read everything."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)
