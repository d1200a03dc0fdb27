"""Worker processes: results, failures, and that no worker remains."""

import math
import os
import time
from functools import partial
from pathlib import Path

import pytest

from counterlight.errors import InputError
from counterlight.jobs.workers import MOST_DEATHS, Processes
from tests.programs import descendants, is_running


def written(folder: Path, number: int) -> int:
    """Leave a file named after the worker's process id, and return the square."""
    (folder / str(os.getpid())).touch()
    return number**2


def dies_at_first(folder: Path) -> str:
    if (folder / "died").exists():
        return "done"
    (folder / "died").touch()
    os._exit(1)


def dies(folder: Path) -> None:
    (folder / str(os.getpid())).touch()
    os._exit(1)


def test_every_job_comes_back_with_its_number_and_no_process_stays(tmp_path: Path) -> None:
    with Processes(2) as workers:
        found = dict(workers.completed([partial(written, tmp_path, number) for number in range(7)]))
    assert found == {number: number**2 for number in range(7)}
    pids = [int(path.name) for path in tmp_path.iterdir()]
    assert 1 <= len(pids) <= 2
    assert not any(map(is_running, pids))


def test_a_job_whose_process_dies_is_done_by_another(tmp_path: Path) -> None:
    with Processes(1) as workers:
        assert list(workers.completed([partial(dies_at_first, tmp_path)])) == [(0, "done")]


def test_a_job_that_always_kills_its_process_is_given_up_in_one_line(tmp_path: Path) -> None:
    with Processes(1) as workers, pytest.raises(InputError, match=f"a job's process died {MOST_DEATHS} times"):
        list(workers.completed([partial(dies, tmp_path)]))
    assert len(list(tmp_path.iterdir())) == MOST_DEATHS


def test_what_a_job_raises_is_raised_and_who_is_at_work_is_ended() -> None:
    with Processes(2) as workers, pytest.raises(ValueError, match=r"math|nonnegative"):
        list(workers.completed([partial(math.sqrt, -1.0), *[partial(time.sleep, 3600.0)] * 3]))
    assert not [pid for pid in descendants(os.getpid()) if "spawn_main" in Path(f"/proc/{pid}/cmdline").read_text()]
