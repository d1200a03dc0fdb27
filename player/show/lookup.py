"""Runs disk accesses in threads, so that a disk that does not answer cannot delay the show."""

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

from counterlight.errors import InputError

MOST_WAITING = 8  # threads that a dead disk may block; further look-ups never return a result
_waiting = threading.BoundedSemaphore(MOST_WAITING)

T = TypeVar("T")


class LookUp(Generic[T]):
    """Runs a function in its own daemon thread, which is abandoned if it never ends."""

    def __init__(self, find: Callable[[], T]) -> None:
        self._found: SimpleQueue[T | BaseException] = SimpleQueue()
        if _waiting.acquire(blocking=False):
            threading.Thread(target=self._run, args=(find,), name="look-up", daemon=True).start()

    def result(self, wait_s: float = 0.0) -> T | None:
        """Return the function's result, None while it is unknown. Raises the exception that the function raised."""
        try:
            found = self._found.get(timeout=wait_s) if wait_s else self._found.get_nowait()
        except Empty:
            return None
        if isinstance(found, BaseException):
            raise found
        return found

    def _run(self, find: Callable[[], T]) -> None:
        try:
            self._found.put(find())
        except Exception as error:
            self._found.put(error if isinstance(error, InputError) else InputError(f"cannot be looked up: {error!r}"))
        finally:
            _waiting.release()
