"""Looking something up on a disk that may not answer, beside the show."""

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

from counterlight.errors import InputError

MOST_WAITING = 8  # threads that a dead disk holds; what is looked up then is not there yet
_waiting = threading.BoundedSemaphore(MOST_WAITING)

T = TypeVar("T")


class LookUp(Generic[T]):
    """What a function finds, by a thread of its own that is left behind if it never ends."""

    def __init__(self, find: Callable[[], T]) -> None:
        self._found: SimpleQueue[T | BaseException] = SimpleQueue()
        if _waiting.acquire(blocking=False):
            threading.Thread(target=self._run, args=(find,), name="look-up", daemon=True).start()

    def result(self, wait_s: float = 0.0) -> T | None:
        """What was found, None while that is not known; raises what the function raised."""
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
