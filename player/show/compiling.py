"""Compiles the passes for the processor at startup, and prints this."""

import sys

from counterlight.command import tell
from counterlight.passes import kernel
from counterlight.pipeline import cpu_renderer  # noqa: F401  # registers every kernel (passes/kernel.py, KERNELS)


def compile_passes() -> None:
    """Compile the passes of `--backend cpu`, and keep them for later processes if a folder is writable."""
    how = "once" if kernel.is_kept() else "at every start, since no folder can be written (set NUMBA_CACHE_DIR)"
    said = None

    def say(left: int) -> None:
        nonlocal said
        if left != said:  # the loops of a pass are compiled separately
            tell(f"compiling for this processor, {how}: {left} passes left", sys.stdout)
        said = left

    kernel.prepare(say)
