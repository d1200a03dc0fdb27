"""Run work on all cores."""

import os
import sys
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

from counterlight.command import track

T = TypeVar("T")


def one_thread() -> AbstractContextManager[object]:
    """Limit the threads of BLAS and OpenMP to one until the context is left."""
    limiter: AbstractContextManager[object] = _libraries(len(sys.modules)).limit(limits=1)
    return limiter


@lru_cache(maxsize=1)
def _libraries(_: int) -> ThreadpoolController:
    """Find the loaded libraries that have threads (1 to 6 ms). Libraries are loaded by modules, which are counted."""
    return ThreadpoolController()


def run_jobs(jobs: Sequence[Callable[[], T]], label: str) -> Generator[T]:
    """Run jobs on all cores, one BLAS thread each (two per job made small factorisations five times slower)."""
    with one_thread(), ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            yield from track(pool.map(lambda job: job(), jobs), label, len(jobs))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def side_by_side(function: Callable[..., T], *each: Iterable[Any]) -> list[T]:
    """Apply a function that releases Python's lock to each argument on all cores; BLAS keeps its threads."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(function, *each))
