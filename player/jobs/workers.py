"""Workers, and the workers of this machine: this thread, or processes that are replaced if they die."""

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

MOST_DEATHS = 3  # deaths of workers after which a job is given up
THREADS = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
_SPAWN = multiprocessing.get_context("spawn")  # OpenGL and threads do not survive a fork


class Workers(Protocol):
    """Runs jobs, at most `count` at a time. As a context manager, stops all work at the end."""

    @property
    def count(self) -> int: ...

    def completed(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        """Yield the number and the result of each job, in the order of completion.

        Another worker repeats a job whose worker dies. Raises a job's exception, and InputError if a job's workers keep
        dying. The remaining jobs are then cancelled.
        """

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None: ...


class Here:
    """Runs jobs in this thread, one after the other."""

    count = 1

    def completed(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        yield from ((number, job()) for number, job in enumerate(jobs))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Processes:
    """Runs jobs in processes of this machine, which share its cores."""

    def __init__(self, count: int) -> None:
        self.count, self._over = count, False
        self._threads = ThreadPoolExecutor(count)
        self._free: SimpleQueue[_Process | None] = SimpleQueue()
        self._started: list[_Process] = []
        for _ in range(count):
            self._free.put(None)  # the process is started when a job needs it

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
        if self._over:  # `__exit__` has already ended all others
            process.end()
            raise CancelledError
        return process


class _DeadError(Exception):
    """A process died during its job."""


class _Process:
    """A worker process.

    threads : number of threads that it may use.
    """

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
        """Kill the process, even during a job."""
        self._process.kill()
        self._process.join()


def _serve(pipe: Connection, threads: int) -> None:
    """Run the jobs from the pipe until its other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    # set before a job is unpickled, because the imported modules read it
    os.environ.update(dict.fromkeys(THREADS, str(threads)))
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
