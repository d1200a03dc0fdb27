"""Whether what is to be done fits into memory, asked before it starts: a refusal is kinder than a swapping machine.

And what is freed, given back to the system.
"""

import ctypes
import os
from pathlib import Path

from counterlight.errors import InputError


def available_bytes() -> int:
    """Memory that can be had without swapping; what Linux estimates, else all that is installed."""
    try:
        lines = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text().splitlines())
        return int(lines["MemAvailable"].split()[0]) << 10
    except (OSError, KeyError, ValueError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def check(needed: float, what: str, remedy: str) -> None:
    """InputError if `needed` bytes are not available."""
    available = available_bytes()
    if needed > available:
        raise InputError(
            f"{what} needs about {needed / 2**30:.1f} GiB of memory, {available / 2**30:.1f} GiB are available; "
            f"{remedy}"
        )


def give_back() -> None:
    """Return freed memory to the system, where its C library can (glibc, 2 ms).

    Compiling shaders leaves holes in the heap that glibc keeps: 60 MiB after 20 reloads of a small room, else 6 MiB.
    Arrays of up to 32 MiB lie in such heaps, too, one for each thread.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "malloc_trim"):
        libc.malloc_trim(0)
