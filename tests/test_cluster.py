"""Jobs on dask.distributed: real schedulers and workers, one of them killed; jobs that cannot run print one line."""

import csv
import os
import re
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from distributed import Client

from counterlight.tools.shipped import CLIP
from tests.programs import PATIENCE_S, descendants, fail, here, running, script, succeed, verb, wait_until
from tests.rooms import write_blurred_room
from tests.test_segments import packets

SCENE = "corner"
LOCAL = "--cluster", "local:2"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cluster") / "room"
    write_blurred_room(folder, np.random.default_rng(3), (48, 60), (40, 50))
    here("build", folder, "--regularize", "0.05")
    return folder


def names_of_workers(scheduler: str) -> list[str]:
    with Client(scheduler, set_as_default=False) as client:
        return sorted(each["name"] for each in client.scheduler_info()["workers"].values())


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a scheduler."""
    folder = tmp_path_factory.mktemp("scheduler")
    address_file = folder / "scheduler.json"
    words = script("dask"), "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"
    with running(*words, "--scheduler-file", address_file, folder=folder, errors=None) as process:
        wait_until(lambda: address_file.exists() and '"address"' in address_file.read_text(), "no scheduler", process)
        yield str(address_file.read_text().split('"address": "')[1].split('"')[0])


def test_a_scheduler_without_workers_is_one_line(room: Path, scheduler: str) -> None:
    assert "no worker is there; start some with: dask worker" in fail("build", room, "--cluster", scheduler)


BLIND = "import counterlight.jobs.cluster as c; c.content_of = lambda path: None"
OLDER = "import counterlight.jobs.cluster as c; c.LIBRARIES = ('numpy',); c.program.cache_clear()"
STRANGE = "import importlib.metadata as m; v = m.version; m.version = lambda n: v('no-' * (n == 'counterlight') + n)"


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (STRANGE, "has no counterlight; install it there"),
        (OLDER, "has scipy None, numba None, av None, here is scipy "),
        (BLIND, "calibration.toml: the worker tcp://.* does not see it; share its folder with all workers"),
    ],
)
def test_a_worker_that_cannot_do_the_same_is_one_line(room: Path, scheduler: str, made: str, expected: str) -> None:
    """A worker lacks a dependency or a file, because of the way in which its process was started."""
    begun = f"{made}; from distributed.cli.dask_worker import main; main()"
    name = expected.split()[1]
    words = sys.executable, "-c", begun, scheduler, "--no-nanny", "--nthreads", "1", "--no-dashboard", "--name", name
    with running(*words, errors=None) as worker:  # the scheduler may still know the worker that was killed before
        wait_until(lambda: names_of_workers(scheduler) == [name], "it never came", worker)
        line = fail("build", room, "--cluster", scheduler)
    assert re.search(expected, line), line


@pytest.fixture(scope="module")
def workers(scheduler: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Process id of the program that keeps two workers of the scheduler."""
    words = script("dask"), "worker", scheduler, "--nworkers", "2", "--nthreads", "1", "--no-dashboard", "--name", "w"
    with running(*words, folder=tmp_path_factory.mktemp("workers"), errors=None) as process:
        wait_until(lambda: names_of_workers(scheduler) == ["w-0", "w-1"], "no workers", process)
        yield process.pid


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.usefixtures("workers")
def test_windows_inverted_elsewhere_are_the_same_to_the_last_bit(room: Path, scheduler: str) -> None:
    words = "build", room, "--inverse", "whole", "--regularize", "0.05", "--verbose"
    assert "windowed: one cluster of 2 000 projector pixels" in here(*words)
    expected = contents(room)
    succeed(*words, "--cluster", scheduler)
    assert contents(room) == expected


@pytest.mark.usefixtures("workers")
def test_bands_traced_elsewhere_are_the_same_to_the_last_bit(scheduler: str, tmp_path: Path) -> None:
    words = SCENE, "--camera", "288x120", "--projector", "72x40"
    here("simulate", *words, "-o", tmp_path / "here")
    succeed("simulate", *words, "-o", tmp_path / "there", "--cluster", scheduler)
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


def rendering(pid: int) -> list[int]:
    """Process ids of workers that decode."""
    workers = [child for child in descendants(pid) if called(child, "spawn_main")]
    return [worker for worker in workers if any(called(child, "decoding.decoder") for child in descendants(worker))]


def called(pid: int, name: str, facts: str = "cmdline") -> bool:
    """Whether a process has a name in its command line, or in another file of /proc."""
    try:
        return name in Path(f"/proc/{pid}/{facts}").read_text()
    except OSError:
        return False


def test_a_worker_that_is_killed_is_replaced_and_the_film_is_the_same(
    room: Path, scheduler: str, workers: int, tmp_path: Path
) -> None:
    words = *verb("play"), room, CLIP, "--backend", "cpu", "--refine", "0", "--frames", "40", "--output"
    here(*words[1:], tmp_path / "one.mkv")
    with running(*words, tmp_path / "many.mkv", "--cluster", scheduler, "--segments", "4") as process:
        wait_until(lambda: bool(rendering(workers)), "no worker began", process)
        os.kill(rendering(workers)[-1], signal.SIGKILL)
        _, errors = process.communicate(timeout=240)
    assert process.returncode == 0, errors
    assert packets(tmp_path / "many.mkv") == packets(tmp_path / "one.mkv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["many.mkv", "one.mkv"]


FEW = (
    "import counterlight.tools.study.jobs as j; from counterlight.tools.study_accuracy import main; box, _, *some = "
    "j.catalogue(); few = [box, *some[:3]]; j.catalogue = lambda: few; knob = j.uncut_knobs()[:1]; "
    "j.uncut_knobs = lambda: knob; "
    "import counterlight.tools.study.sheets, counterlight.tools.study.plots as p; "
    "p.save = lambda path, figure: path.name; "  # plots of times differ, and test_study.py draws them
    "raise SystemExit(main())"
)
TIMED = {"preparation_s", "cpu_s", "frame_ms"}


def studying(report: Path, *more: object) -> list[object]:
    """Command that studies a scene with few methods."""
    words = "--scenes", "wall", "--size", "24x16", "--pictures", "text", "-o", report
    return [sys.executable, "-c", FEW, *words, *more]


def figures(report: Path) -> list[dict[str, str]]:
    """Figures of a study, without times."""
    with (report / "results.csv").open(encoding="utf-8") as file:
        return [{k: v for k, v in row.items() if k not in TIMED} for row in csv.DictReader(file)]


def drawing(pid: int) -> list[int]:
    """Process ids of workers that try methods, recognised by their OpenGL library."""
    return [child for child in descendants(pid) if called(child, "spawn_main") and called(child, "libEGL", "maps")]


def test_a_study_elsewhere_finds_the_same_though_a_worker_is_killed(tmp_path: Path) -> None:
    with running(*studying(tmp_path / "here")) as process:
        _, errors = process.communicate(timeout=240)
    assert process.returncode == 0, errors
    with running(*studying(tmp_path / "there", *LOCAL)) as process:
        wait_until(lambda: bool(drawing(process.pid)), "no worker began", process)
        os.kill(drawing(process.pid)[-1], signal.SIGKILL)
        _, errors = process.communicate(timeout=240)
    assert process.returncode == 0, errors
    found = figures(tmp_path / "here")
    assert [row["family"] for row in found] == ["box optimum", "uncompensated", "direct", "direct, triangulated", "T⁺"]
    assert figures(tmp_path / "there") == found
    sheet = "pictures_wall.png"
    assert (tmp_path / "there" / sheet).read_bytes() == (tmp_path / "here" / sheet).read_bytes()


SLOW_TO_END = """
import os, signal
from distributed import Nanny
from counterlight.jobs.cluster import Cluster

async def kill(*_, **__):
    raise TimeoutError

if __name__ == "__main__":
    with Cluster("local:1") as cluster:
        Nanny.kill = kill
        ((_, worker),) = cluster.completed([os.getpid])
    os.kill(worker, signal.SIGKILL)
"""


def test_a_worker_that_does_not_end_in_time_costs_no_result() -> None:
    with running(sys.executable, "-c", SLOW_TO_END) as process:
        assert process.communicate(timeout=PATIENCE_S) == ("", "")
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("127.0.0.1:1", "nobody answers there"),
        ("nonsense", "nobody answers there (missing port number"),
        ("local:0", "expected at least one worker, such as local:2"),
    ],
)
def test_an_address_where_nobody_is_is_one_line(room: Path, address: str, expected: str) -> None:
    before = contents(room)
    assert f"--cluster {address}: {expected}" in fail("build", room, "--cluster", address)
    assert contents(room) == before
