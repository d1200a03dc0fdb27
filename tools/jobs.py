"""Run work on all cores."""

import os
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from counterlight.command import track

T = TypeVar("T")


def run_jobs(jobs: Sequence[Callable[[], T]], label: str) -> Generator[T]:
    """Run jobs on all cores, one BLAS thread each (two per job made small factorisations five times slower)."""
    with threadpool_limits(limits=1), ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            yield from track(pool.map(lambda job: job(), jobs), label, len(jobs))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def side_by_side(function: Callable[..., T], *each: Iterable[Any]) -> list[T]:
    """Apply a function that releases Python's lock to each argument on all cores; BLAS keeps its threads."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(function, *each))
