"""Workers, and those of this machine: this very thread, or processes, each of which is replaced if it dies."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, as_completed
from multiprocessing.connection import Connection
from queue import SimpleQueue
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

from counterlight.errors import InputError

T = TypeVar("T")

MOST_DEATHS = 3  # of the workers that a job is given to
THREADS = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
_SPAWN = multiprocessing.get_context("spawn")  # OpenGL and threads do not survive a fork


class Workers(Protocol):
    """Whoever does jobs, at most `count` at a time; a context, at whose end none works any more."""

    @property
    def count(self) -> int: ...

    def completed(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        """The number and the result of each job, as they end.

        A job whose worker dies is given to another. Raises what a job raises, InputError where its workers die again
        and again; whatever is left is given up then.
        """

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None: ...


class Here:
    """This thread of this process, one job after the other."""

    count = 1

    def completed(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        yield from ((number, job()) for number, job in enumerate(jobs))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Processes:
    """Processes of this machine, which share its cores."""

    def __init__(self, count: int) -> None:
        self.count, self._over = count, False
        self._threads = ThreadPoolExecutor(count)
        self._free: SimpleQueue[_Process | None] = SimpleQueue()
        self._started: list[_Process] = []
        for _ in range(count):
            self._free.put(None)  # started when it is needed

    def completed(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        numbers: dict[Future[T], int] = {self._threads.submit(self._do, job): n for n, job in enumerate(jobs)}
        for future in as_completed(numbers):
            yield numbers[future], future.result()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._over = True
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in self._started:
            process.end()
        self._threads.shutdown()

    def _do(self, job: Callable[[], T]) -> T:
        for _ in range(MOST_DEATHS):
            process = self._free.get() or self._start()
            try:
                result: T = process.do(job)
            except _DeadError:
                process.end()
                self._free.put(None)
            except BaseException:
                self._free.put(process)
                raise
            else:
                self._free.put(process)
                return result
        raise InputError(
            f"a job's process died {MOST_DEATHS} times (killed, or out of memory); free some memory, or use fewer"
        )

    def _start(self) -> "_Process":
        process = _Process(max((os.cpu_count() or 1) // self.count, 1))
        self._started.append(process)
        if self._over:  # and nobody ends those that come after the end
            process.end()
            raise CancelledError
        return process


class _DeadError(Exception):
    """A process has died at its job."""


class _Process:
    """threads : that it may use."""

    def __init__(self, threads: int) -> None:
        self._pipe, theirs = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=_serve, args=(theirs, threads), daemon=True)
        self._process.start()
        theirs.close()

    def do(self, job: Callable[[], Any]) -> Any:
        try:
            self._pipe.send(job)
            ended_well, outcome = self._pipe.recv()
        except (EOFError, OSError):
            raise _DeadError from None
        if not ended_well:
            raise outcome
        return outcome

    def end(self) -> None:
        """Whatever it is doing."""
        self._process.kill()
        self._process.join()


def _serve(pipe: Connection, threads: int) -> None:
    """Do what comes through the pipe, as long as there is somebody at its other end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's to handle
    os.environ.update(dict.fromkeys(THREADS, str(threads)))  # before a job is read, whose modules ask for it
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        try:
            outcome = True, job()
        except Exception as error:
            outcome = False, error
        pipe.send(outcome)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
