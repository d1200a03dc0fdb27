"""Keeps garbage collections short while a show runs for months."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def short_collections() -> Iterator[None]:
    """Exclude the objects that exist now from garbage collections, which then take a fraction of a frame's time."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
