"""CPU functions of passes that run every frame, compiled by Numba on first use.

Pictures are (rows, columns, channels) float32, contiguous. Each kernel fills `out` and allocates at most a few rows.
Cores share the rows, and one core computes each value in a fixed order. The output is therefore the same bytes on every
run, for any number of threads. Arithmetic is float32, as in the shaders; long sums are accumulated in float64. Kernels
hold Python's lock, so that the show and the estimating thread never start parallel loops at the same time. Simultaneous
loops would end the process with Numba's own thread pool ("workqueue").
"""

from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property, partial
from types import FunctionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

Whole = NDArray[np.integer]
PICTURE, PLANE, LINE = "float32[:, :, ::1]", "float32[:, ::1]", "float32[::1]"
UNPACKING = f"uint32[:, ::1], {PICTURE}, uint32[:, ::1], int64[::1], int32[::1], {PLANE}"
prange = range  # becomes numba.prange in a compiled function


class Compiled:
    """A function that Numba compiles on the first call, because importing Numba takes half a second.

    compile_by : compiles the function.
    """

    def __init__(self, function: Callable[..., Any], compile_by: Callable[[Any], Any]) -> None:
        self._function: Any = function
        self._compile_by = compile_by

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's version of the function; functions that it calls are compiled with it."""
        import numba

        given = self._function
        names = {
            name: value.dispatcher if isinstance(value, Compiled) else value
            for name, value in given.__globals__.items()
            if name in given.__code__.co_names or name.startswith("__")
        }
        function = FunctionType(given.__code__, names | {"prange": numba.prange}, given.__name__)
        function.__module__, function.__qualname__ = given.__module__, given.__qualname__
        return self._compile_by(function)

    def __call__(self, *arguments: Any) -> Any:
        return self.dispatcher(*arguments)


def unpacking() -> tuple[Any, tuple[str, ...]]:
    """Return the kernel that unpacks maps, with its signature."""
    from counterlight.maps.products import unpack_entries

    return unpack_entries, (UNPACKING,)


KERNELS: list[Callable[[], tuple[Any, tuple[str, ...]]]] = [unpacking]


def kernel(*signatures: str) -> Callable[[Callable[..., None]], Compiled]:
    """Decorator: compile on first use or by `prepare`, and cache for the next start if a writable folder exists."""

    def listed(function: Callable[..., None]) -> Compiled:
        made = Compiled(function, _kept)
        KERNELS.append(lambda: (made.dispatcher, signatures))
        return made

    return listed


def inlined(function: Callable[..., Any]) -> Compiled:
    """Decorator: inline the function into the kernels that call it."""
    return Compiled(function, _inlined)


def _kept(function: Any) -> Any:
    from counterlight.maps.products import kept

    return kept(parallel=True, error_model="numpy")(function)


def _inlined(function: Any) -> Any:
    import numba

    return numba.njit(inline="always", error_model="numpy")(function)


def dispatchers() -> list[tuple[Any, tuple[str, ...]]]:
    """Return every kernel of the imported passes with its signatures, and the kernel that unpacks maps."""
    return [each() for each in KERNELS]


def prepare(compiling: Callable[[int], None] = lambda left: None) -> None:
    """Load every cached kernel, and compile the others.

    compiling : called before each compilation with the number of remaining kernels. Numba's own event triggers the
        call. Load time does not show a compilation: loading all kernels takes a second, and longer on a busy machine.
    """
    from numba.core import event

    class Compiles(event.Listener):
        """Calls `started` when Numba compiles a function, but not when Numba loads one from the cache."""

        def __init__(self, started: Callable[[], None]) -> None:
            self._started = started

        def on_start(self, event: Any) -> None:
            self._started()

        def on_end(self, event: Any) -> None:
            """Required by the interface; does nothing."""

    wanted = [(made, signature) for made, signatures in dispatchers() for signature in signatures]
    for number, (made, signature) in enumerate(wanted):
        types = _parsed(signature)
        # an OSError says that the disk is full, after the kernel was compiled
        listener = Compiles(partial(compiling, len(wanted) - number))
        with suppress(OSError), event.install_listener("numba:compile", listener):
            made.compile(types)


@cache
def _parsed(signature: str) -> tuple[Any, ...]:
    """Return the types of a signature; as text, Numba would cache it separately from what a call compiles.

    Parsing all takes 1.2 ms, which every renderer of a process would spend again.
    """
    from numba.core.sigutils import normalize_signature

    types, _ = normalize_signature(f"({signature})")  # type: ignore[no-untyped-call]
    return tuple(types)


def is_kept() -> bool:
    """Return whether a folder exists that caches kernels for the next start."""
    return all(made.stats.cache_path is not None for made, _ in dispatchers())


@inlined
def within(value: Any, low: Any, high: Any) -> Any:
    return min(max(value, low), high)


@inlined
def looked_up(table: Any, share: Any) -> Any:
    """Look up a share 0..1 in a (samples,) table, interpolated linearly. Unsigned indices need no wraparound check."""
    at = share * np.float32(table.size - 1)
    low = np.uint32(min(np.int32(at), np.int32(table.size - 2)))
    return table[low] + (table[low + np.uint32(1)] - table[low]) * (at - np.float32(low))


@inlined
def projected(H: Any, x: Any, y: Any) -> Any:
    """Return the position to which H maps a pixel centre, and the third homogeneous component."""
    w = H[2, 0] * (x + 0.5) + H[2, 1] * (y + 0.5) + H[2, 2]
    u = H[0, 0] * (x + 0.5) + H[0, 1] * (y + 0.5) + H[0, 2]
    v = H[1, 0] * (x + 0.5) + H[1, 1] * (y + 0.5) + H[1, 2]
    return u / w, v / w, w
