"""The option --cluster of several commands, which lets many machines share the work (counterlight/jobs)."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from counterlight.command import Arguments
from counterlight.jobs.workers import Workers


def add_cluster(parser: Arguments, what: str) -> None:
    """Add --cluster; `what` names the shared work in the help text, such as `trace the scene`."""
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help=f"{what} on the dask scheduler at HOST:PORT, or in N local processes with local:N (extra cluster, "
        "docs/size.md; default: in this process)",
    )


@contextmanager
def workers_of(address: str | None, files: Sequence[Path], shared: Path | None) -> Iterator[Workers | None]:
    """Open the workers; None if the work stays in this process.

    files : files that all workers must be able to read.
    shared : folder for results that all workers must see, if any.
    """
    if address is None:
        yield None
        return
    from counterlight.jobs.cluster import open_cluster  # dask.distributed takes a second

    with open_cluster(address, files, shared) as workers:
        yield workers
