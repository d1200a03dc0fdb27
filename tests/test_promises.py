"""Time budgets and quality promises, in a session with stand-ins and when a user plays a room into a file."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from counterlight import calibration
from counterlight.files import exr
from counterlight.show.registry import CommandError
from counterlight.tools.shipped import CLIP
from counterlight.tools.solve.box import Box
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.storage import read_transport
from tests.programs import command, fail, succeed
from tests.rooms import write_blurred_room
from tests.stage import Reader, Stage


def test_a_promise_is_kept_by_the_estimates_and_shown_on_the_page() -> None:
    stage = Stage(Reader(count=10_000), usual=2)
    stage.below = lambda steps: 4 / (1 + steps) ** 2
    stage.advance(0.2)
    assert stage.screen.snapshots == 0  # no client asks
    stage.commands.set("within", 0.05)
    until(stage, lambda: stage.below(stage.screen.steps[-1]) <= 0.05)
    assert stage.commands.get("refine") == "auto"
    assert stage.commands.get("steps") == stage.screen.steps[-1] <= 40
    assert stage.commands.get("below-optimum") <= 4 / 9
    stage.press("i")
    stage.advance(0.5)
    page = stage.screen.pages[-1]
    assert page is not None
    assert any(line.endswith("from previous, within 0.05") for line in page.lines)
    assert any("steps more" in line and " dB nearer" in line for line in page.lines)
    with pytest.raises(CommandError, match=r"within: expected no or decibels from 0\.001 to 100, found 0"):
        stage.commands.set("within", 0)


def test_a_remote_that_asks_where_a_picture_stands_learns_when_it_is_known() -> None:
    stage = Stage(Reader(count=10_000), usual=3)
    stage.advance(0.1)
    assert stage.commands.get("below-optimum") is None
    until(stage, lambda: stage.commands.get("below-optimum") is not None)
    assert stage.commands.get("below-optimum") == pytest.approx(1 / 4)
    assert stage.commands.get("doubling") == {"steps": 3, "db": pytest.approx(1 / 8), "ms": None}
    stage.session.governor.took(0.02, 3, {"linear": 0.01, "start": 0.004, "steps": 0.006})
    assert stage.commands.get("step-ms") == pytest.approx(2)
    assert stage.commands.get("doubling")["ms"] == pytest.approx(6)
    assert stage.commands.get("stage-ms").keys() >= {"decode", "gpu", "present"}
    stage.advance(20.0, step=0.1)  # no client has asked for 20 s
    count = stage.screen.snapshots
    stage.advance(5.0, step=0.1)
    assert stage.screen.snapshots == count


def test_a_still_is_drawn_again_until_its_promise_is_kept_and_then_stays() -> None:
    stage = Stage(Reader(still=True, count=1), usual=2, within=0.05)
    stage.below = lambda steps: 4 / (1 + steps) ** 2
    until(stage, lambda: stage.below(stage.screen.steps[-1]) <= 0.05)
    drawn = len(stage.screen.steps)
    stage.advance(3.0, step=0.1)
    assert len(stage.screen.steps) <= drawn + 2  # a few frames are drawn again, because fewer steps may suffice
    assert stage.below(stage.screen.steps[-1]) <= 0.05


def test_maps_without_refinement_take_no_budget() -> None:
    stage = Stage()
    stage.refinable = False
    for name in ("budget", "within"):
        with pytest.raises(CommandError, match="the maps were built without it"):
            stage.commands.set(name, 1)
        stage.commands.set(name, "no")


def until(stage: Stage, reached: Callable[[], bool]) -> None:
    """Play until a condition holds. Estimates come from a thread."""
    for _ in range(2000):
        stage.advance(0.04, step=0.04)
        if reached():
            return
        time.sleep(0.001)
    raise AssertionError("never")


def test_statistics_at_the_end_of_a_show_say_where_its_pictures_stood() -> None:
    stage = Stage(Reader(count=3), usual=4, appraised=True)
    facts = stage.show.run(limit=1).facts["refinement"]
    assert facts["below_optimum_db"] == pytest.approx(1 / 5)
    assert (facts["steps"], facts["squares_solved"], facts["squares"]) == (4, 4, 4)
    assert "below_optimum_db" not in Stage(Reader(count=3), usual=4).show.run(limit=1).facts["refinement"]


def test_no_estimate_delays_the_first_frames_of_a_medium() -> None:
    stage = Stage(Reader(count=15), Reader(path="b.mp4", count=1000), usual=2, within=0.05)
    stage.advance(0.04, step=0.04)
    while stage.commands.get("path") != "b.mp4":
        before = stage.screen.snapshots
        stage.advance(0.04, step=0.04)
    stage.advance(0.3, step=0.04)
    assert stage.screen.snapshots == before
    until(stage, lambda: stage.screen.snapshots > before)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("promises") / "room"
    write_blurred_room(folder, np.random.default_rng(11), (54, 66), (48, 58), cells=6)
    succeed("build", folder)
    return folder


@pytest.mark.parametrize("within", [1.0, 0.1, 0.01])
def test_a_picture_in_a_file_is_as_near_to_the_best_one_as_was_promised(
    room: Path, tmp_path: Path, within: float
) -> None:
    stored = calibration.read(room)
    objective = objective_of(read_transport(stored), stored.calibration, DEFAULT_AIMS).unweighted
    blocks = np.random.default_rng(4).choice([0.02, 0.3], (9, 11, 3))
    c = np.kron(blocks, np.ones((6, 6, 1))).astype(np.float32)
    exr.write_rgb(tmp_path / "c.exr", c)
    b = (c - stored.calibration.ambient).reshape(-1, 3).astype(float)
    best = Box(objective, tolerance=1e-6).solve(b).drive
    out, stats = tmp_path / "p.exr", tmp_path / "stats.json"
    succeed("play", room, tmp_path / "c.exr", "--output", out, "--within", within, "--stats", stats)
    drive = exr.read_rgb(out).reshape(-1, 3).astype(float)
    least, error = (objective.certificate(each, b).squared_error.sum() for each in (best, drive))
    facts = json.loads(stats.read_text())["refinement"]
    # the estimate is within a few percent of the truth (test_survey.py)
    assert 10 * np.log10(error / least) <= 1.1 * within
    assert facts["below_optimum_db"] <= facts["worst_below_optimum_db"] <= within
    assert 0 <= facts["steps"] < 256


def test_frames_of_film_keep_a_promise_or_one_line_says_why(room: Path, tmp_path: Path) -> None:
    film, stats = tmp_path / "film.mkv", tmp_path / "stats.json"
    common = "play", room, CLIP, "--output", film, "--frames", 3, "--stats", stats
    succeed(*common, "--within", 0.05)
    assert json.loads(stats.read_text())["refinement"]["worst_below_optimum_db"] <= 0.05
    done = command(*common, "--within", 0.001, "--budget", 0.01)
    assert done.returncode == 0
    assert done.stderr.count("--within 0.001 cannot be kept: at most") == 1
    facts = json.loads(stats.read_text())
    assert {"linear_ms", "place_ms", "start_ms", "view_ms", "encode_ms"} <= facts.keys()


def test_a_still_within_a_budget_that_is_large_gets_many_steps(room: Path, tmp_path: Path) -> None:
    stats = tmp_path / "stats.json"
    exr.write_rgb(tmp_path / "c.exr", np.full((54, 66, 3), 0.2, np.float32))
    succeed("play", room, tmp_path / "c.exr", "--output", tmp_path / "p.exr", "--budget", 100_000, "--stats", stats)
    assert json.loads(stats.read_text())["refinement"]["steps"] == 256


def test_wrong_budgets_and_promises_are_refused(room: Path, tmp_path: Path) -> None:
    play = "play", room, CLIP, "--output", tmp_path / "o.png"
    assert "--budget and --within choose the steps themselves" in fail(*play, "--within", 0.1, "--refine", 4)
    assert "--budget: expected no or milliseconds from 0.01, found '0'" in fail(*play, "--budget", 0)
    assert "--within: expected no or decibels from 0.001 to 100" in fail(*play, "--within", "nan")
    assert "give a number of steps, --budget or --within" in fail(*play, "--refine", "auto")
    assert not (tmp_path / "o.png").exists()
