"""Workers of dask.distributed (extra `cluster`): `local:N` processes of this machine, or a scheduler's address.

Jobs name files instead of containing their data. Therefore every worker is checked first: it must run this exact
program and see the same files. dask replaces dead workers: another worker takes the job, and a nanny, if there is one,
starts a new process.
"""

import asyncio
import hashlib
import os
import re
import sys
import tempfile
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import ExitStack, suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from counterlight.errors import InputError, one_line
from counterlight.jobs.workers import MOST_DEATHS, THREADS

T = TypeVar("T")

ANSWER_S = 5.0
LOCAL = re.compile(r"local:(\d{1,3})")
INSTALL = "install it with: pip install 'counterlight[cluster]'"
LIBRARIES = "numpy", "scipy", "numba", "av"  # libraries that determine results to the last bit


class Cluster:
    """A connection to a cluster, opened on creation.

    Raises InputError if no scheduler answers, no worker exists, the package is missing, or a worker's version differs.

    address : `local:N` or HOST:PORT.
    """

    def __init__(self, address: str) -> None:
        self._address, self._stack = address, ExitStack()
        try:
            self._client = self._connected()
            self._workers = self._checked_workers()
        except BaseException:
            self.close()
            raise

    @property
    def count(self) -> int:
        """Number of jobs that run at a time."""
        return sum(self._workers.values())

    def check_files(self, files: Iterable[Path], shared: Path | None) -> None:
        """Raise InputError unless every worker sees the same files under the same names.

        files : files that jobs read.
        shared : folder in which every worker must see new files; None for none.
        """
        wanted = {str(path.absolute()): content_of(str(path.absolute())) for path in files}
        for path, content in wanted.items():
            for worker, found in self._ask(content_of, path).items():
                if found != content:
                    what = "does not see it" if found is None else "sees another one under that name"
                    raise InputError(f"{path}: the worker {worker} {what}; share its folder with all workers")
        if shared is None:
            return
        with tempfile.NamedTemporaryFile(dir=shared, prefix=".counterlight-") as token:
            for worker, found in self._ask(os.path.exists, token.name).items():
                if not found:
                    raise InputError(f"{shared}: the worker {worker} does not see it; share it with all workers")

    def completed(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        """See Workers."""
        from distributed import KilledWorker

        executor = self._client.get_executor(pure=False)
        try:
            numbers = {executor.submit(job): number for number, job in enumerate(jobs)}
            for future in as_completed(numbers):
                yield numbers[future], future.result()
        except KilledWorker:
            raise InputError(
                f"--cluster {self._address}: a job's worker died {MOST_DEATHS + 1} times (killed, or out of memory); "
                "give workers more memory, or look into their logs"
            ) from None
        finally:
            executor.shutdown(wait=False)  # cancels the remaining jobs

    def close(self) -> None:
        """End a local cluster, or disconnect from an external cluster.

        On a busy machine, a local worker may take longer to end than dask waits. All results have arrived by then.
        """
        with suppress(TimeoutError):
            self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def _connected(self) -> Any:
        try:
            import dask
            import distributed
        except ImportError:
            raise InputError(f"--cluster {self._address}: needs dask.distributed; {INSTALL}") from None
        dask.config.set({"distributed.scheduler.allowed-failures": MOST_DEATHS})
        where: Any = self._address
        try:
            if local := LOCAL.fullmatch(self._address):
                where = self._stack.enter_context(_local_cluster(int(local[1])))
            else:
                asyncio.run(_greet(self._address))
            client = distributed.Client(where, timeout=ANSWER_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"--cluster {self._address}: nobody answers there ({one_line(error)}); start one with: dask scheduler, "
                "and on every machine: dask worker HOST:PORT --nthreads 1 --nworkers N"
            ) from None
        self._stack.enter_context(client)
        return client

    def _checked_workers(self) -> Mapping[str, int]:
        """Return the number of threads per worker. Raises InputError if a worker runs another program."""
        threads: Mapping[str, int] = self._client.nthreads()
        if not threads:
            raise InputError(
                f"--cluster {self._address}: no worker is there; start some with: dask worker HOST:PORT --nthreads 1"
            )
        for worker, version in self._ask(metadata.version, "counterlight").items():
            if version is None:
                raise InputError(
                    f"--cluster {self._address}: the worker {worker} has no counterlight; install it there"
                )
            if version != metadata.version("counterlight"):
                raise self._unlike(
                    worker, f"counterlight {version}", f"counterlight {metadata.version('counterlight')}"
                )
        ours = program()
        for worker, theirs in self._ask(program).items():
            if theirs != ours:
                names = [name for name in ours if (theirs or {}).get(name) != ours[name]]
                found = ", ".join(f"{name} {(theirs or {}).get(name)}" for name in names)
                raise self._unlike(worker, found, ", ".join(f"{name} {ours[name]}" for name in names))
        return threads

    def _unlike(self, worker: str, found: str, expected: str) -> InputError:
        return InputError(
            f"--cluster {self._address}: the worker {worker} has {found}, here is {expected}; install the same there, "
            "for the same result"
        )

    def _ask(self, question: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Return the answer of each worker, None for a worker that fails."""
        answers = self._client.run(question, *arguments, on_error="return")
        return {worker: None if isinstance(found, BaseException) else found for worker, found in answers.items()}


def open_cluster(address: str, files: Iterable[Path], shared: Path | None = None) -> Cluster:
    """Open a cluster whose workers see these files, and new files in the folder `shared` if it is given."""
    cluster = Cluster(address)
    try:
        cluster.check_files(files, None if shared is None else shared.absolute())
    except BaseException:
        cluster.close()
        raise
    return cluster


async def _greet(address: str) -> None:
    """Raise OSError or ValueError unless a scheduler answers. A dask client without an answer takes long to give up."""
    from distributed.comm import connect

    comm = await asyncio.wait_for(connect(address, timeout=ANSWER_S), ANSWER_S + 1)  # the listener may not answer
    await comm.close()


def _local_cluster(count: int) -> Any:
    import distributed

    if not count:
        raise InputError("--cluster local:0: expected at least one worker, such as local:2")
    threads = dict.fromkeys(THREADS, str(max((os.cpu_count() or 1) // count, 1)))
    settings = {
        "threads_per_worker": 1,
        "dashboard_address": "127.0.0.1:0",  # any free port for status requests; None would mean port 8787
        "scheduler_kwargs": {"dashboard": False},
        "silence_logs": 50,
        "memory_limit": 0,
    }
    try:
        return distributed.LocalCluster(n_workers=count, env=threads, **settings)
    except RuntimeError as error:
        raise InputError(
            f"--cluster local:{count}: a worker could not start ({one_line(error)}); free memory, or use fewer"
        ) from None


@cache
def program() -> dict[str, str]:
    """Return the versions that determine a result to the last bit, except for the processor."""
    folder = Path(__file__).parents[1]
    sources = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(folder.rglob("*.py")))).hexdigest()
    python = ".".join(map(str, sys.version_info[:2]))
    libraries = {name: metadata.version(name) for name in LIBRARIES}
    return {"python": python, **libraries, "of sources": sources[:8]}


def content_of(path: str) -> str | None:
    """Return the SHA-256 of a file's content, None if it cannot be read."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return None
