"""A film rendered in segments equals the film rendered at once: whole commands, killed workers, interruptions."""

import json
import os
import pickle
import signal
import subprocess
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path

import av
import numpy as np
import pytest

from counterlight import app
from counterlight.jobs.workers import Here, T
from counterlight.media.video import MediaReader
from counterlight.show import into_file
from counterlight.show.rendering import Stretch
from counterlight.show.segmented import Film, divide, look_through, within_shots
from tests.media import write_video
from tests.programs import descendants, error_here, here, running, verb, wait_until
from tests.rooms import write_blurred_room

SHOT, SHOTS = 8, 3
FRAMES = SHOT * SHOTS
BACKEND = "--backend", "cpu"


@pytest.fixture(scope="module")
def furnished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a room with its maps, a film of three moving shots, and a film of one shot."""
    folder, rng = tmp_path_factory.mktemp("film"), np.random.default_rng(11)
    write_blurred_room(folder / "room", rng)
    here("build", folder / "room", "--regularize", "0.1")
    write_video(folder / "film.mkv", [picture for _ in range(SHOTS) for picture in shot(rng, SHOT)])
    write_video(folder / "shot.mkv", shot(rng, FRAMES))
    return folder


def shot(rng: np.random.Generator, length: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return pictures of 34 x 46 pixels whose light and dark patches move to the right."""
    patches = np.kron(rng.permutation(np.linspace(16, 235, 48)).reshape(6, 8), np.ones((6, 6)))[:34, :46]
    neutral = np.full((17, 23), 128, np.uint8)
    return [(np.roll(patches, step, axis=1).astype(np.uint8), neutral, neutral) for step in range(length)]


def packets(path: Path) -> list[tuple[bytes, int | None]]:
    """Return the packets and times of a film, because whole files differ by Matroska's random identifiers."""
    with av.open(str(path)) as container:
        return [(bytes(packet), packet.pts) for packet in container.demux() if packet.size]


class InTurn(Here):
    """Runs jobs one after the other in this process, where the code is loaded, but sends them as to another."""

    def completed(self, jobs: Sequence[Callable[[], T]]) -> Generator[tuple[int, T]]:
        return super().completed([pickle.loads(pickle.dumps(job)) for job in jobs])


@pytest.fixture(autouse=True)
def in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(into_file, "Processes", lambda count: InTurn())


def render(folder: Path, output: Path, *words: object, film: str = "film.mkv") -> str:
    return here("play", folder / "room", folder / film, *BACKEND, "--output", output, *words)


@pytest.fixture(scope="module")
def whole(furnished: Path) -> Path:
    render(furnished, furnished / "whole.mkv")
    return furnished / "whole.mkv"


def test_segments_are_joined_into_what_one_process_writes(furnished: Path, tmp_path: Path) -> None:
    words = "--flicker", "0.5", "--adapt", "5", "--view", "camera"
    render(furnished, tmp_path / "one.mkv", *words)
    render(furnished, tmp_path / "many.mkv", *words, "--segments", "2", "--stats", tmp_path / "stats.json")
    assert_counted(tmp_path / "stats.json", 2)
    assert packets(tmp_path / "many.mkv") == packets(tmp_path / "one.mkv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["many.mkv", "one.mkv", "stats.json"]


def assert_counted(path: Path, count: int) -> None:
    stats = json.loads(path.read_text())
    assert stats["segments"] == {"count": count, "within_shots": []}
    assert stats["frames"] == FRAMES


def test_a_lossy_film_has_the_same_pictures_at_the_same_times(furnished: Path, tmp_path: Path, whole: Path) -> None:
    """Packets may differ: libx264 with several threads sometimes encodes the same pictures differently."""
    render(furnished, tmp_path / "o.mp4", "--segments", "2")
    (lossy, times), (pictures, exact_times) = shown(tmp_path / "o.mp4"), shown(whole)
    np.testing.assert_allclose(times, exact_times, atol=1e-3)  # Matroska states times in milliseconds
    apart = np.abs(lossy[:, None].astype(float) - pictures[None]).mean(axis=(2, 3, 4))
    assert apart.argmin(axis=1).tolist() == list(
        range(FRAMES)
    )  # pictures move by a pixel per frame, so each picture differs from the next


def shown(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return pictures, (frames, height, width, 3), and the time at which each is due."""
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
    return np.stack([frame.to_ndarray(format="rgb24") for frame in frames]), np.array([frame.time for frame in frames])


@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_numbered_pictures_are_the_same_with_an_offset_laps_and_a_limit(
    furnished: Path, tmp_path: Path, suffix: str
) -> None:
    """The run lasts from the fifth frame to the second lap, and includes the dither, which counts frames."""
    words = "--start", "0.2", "--loop", "--frames", "26", "--dither", "noise"
    for name, more in (("one", ()), ("many", ("--segments", "2"))):
        (tmp_path / name).mkdir()
        render(furnished, tmp_path / name / f"%03d{suffix}", *words, *more)
    one, many = ({path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ("one", "many"))
    assert len(one) == 26
    assert many == one


def test_where_nothing_is_carried_from_frame_to_frame_any_frame_may_begin_a_segment(
    furnished: Path, tmp_path: Path
) -> None:
    render(furnished, tmp_path / "one.mkv", "--refine", "0", film="shot.mkv")
    render(furnished, tmp_path / "many.mkv", "--refine", "0", "--segments", "2", film="shot.mkv")
    assert packets(tmp_path / "many.mkv") == packets(tmp_path / "one.mkv")


def test_a_film_of_one_shot_is_divided_only_if_asked_and_what_differs_is_said(
    furnished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = "--segments", "2", "--stats", tmp_path / "stats.json"
    render(furnished, tmp_path / "o.mkv", *words, film="shot.mkv")
    said = capsys.readouterr().err
    assert f"--segments 2: only 1, for want of cuts (0 in {FRAMES} frames); --lead-in" in said
    alone = packets(tmp_path / "o.mkv")
    done = render(furnished, tmp_path / "o.mkv", *words, "--lead-in", "3", film="shot.mkv")
    joint = json.loads((tmp_path / "stats.json").read_text())["segments"]["within_shots"][0]
    assert joint["frame"] == FRAMES // 2
    assert joint["of"] == 30 * 40 * 3
    assert joint["differing"] > 0  # three frames of lead-in do not remove the effect of the start
    assert f"divided within a shot at frame {FRAMES // 2}: {joint['differing']} of" in done
    assert packets(tmp_path / "o.mkv") != alone


@pytest.fixture
def began(furnished: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a command in segments, with worker processes."""
    words = *verb("play"), furnished / "room", furnished / "film.mkv", *BACKEND, "--output", tmp_path / "o.mkv"
    with running(*words, "--segments", "3", "--stats", tmp_path / "stats.json") as process:
        yield process


def rendering_workers(pid: int) -> list[int]:
    """Return the processes that have begun to decode the film."""
    return [child for child in descendants(pid) if "spawn_main" in cmdline(child) and descendants(child)]


def cmdline(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""


def test_a_worker_that_is_killed_is_replaced(
    furnished: Path, tmp_path: Path, whole: Path, began: subprocess.Popen[str]
) -> None:
    wait_until(lambda: bool(rendering_workers(began.pid)), "no worker began", began)
    os.kill(rendering_workers(began.pid)[0], signal.SIGKILL)
    _, errors = began.communicate(timeout=120)
    assert began.returncode == 0, errors
    assert_counted(tmp_path / "stats.json", 3)
    assert packets(tmp_path / "o.mkv") == packets(whole)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["o.mkv", "stats.json"]


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_run_goes_on_with_what_was_whole(
    furnished: Path,
    tmp_path: Path,
    whole: Path,
    began: subprocess.Popen[str],
    how: signal.Signals,
    capsys: pytest.CaptureFixture[str],
) -> None:
    kept = tmp_path / "o.mkv.segments"
    wait_until(lambda: any(kept.glob("[0-9]*.json")), "no segment was made", began)
    began.send_signal(how)
    _, errors = began.communicate(timeout=60)
    assert not (tmp_path / "o.mkv").exists()
    if how == signal.SIGINT:
        assert "whole segments; the same command goes on with them" in errors
        assert {path.suffix for path in kept.iterdir()} == {".json", ".mkv"}  # no file is half-written
    count = len(list(kept.glob("[0-9]*.json")))
    render(furnished, tmp_path / "o.mkv", "--segments", "3")
    assert f"{count} of 3 segments are there already" in capsys.readouterr().err
    assert packets(tmp_path / "o.mkv") == packets(whole)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["o.mkv"]


def test_segments_of_another_rendering_are_not_taken(
    furnished: Path, tmp_path: Path, whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "o.mkv.segments"
    kept.mkdir()
    (kept / "plan.json").write_text('{"format": 1, "of": "", "stretches": []}')
    (kept / "000.json").write_text('{"frames": 24}')
    render(furnished, tmp_path / "o.mkv", "--segments", "2")
    assert "segments of another rendering; begun anew" in capsys.readouterr().err
    assert packets(tmp_path / "o.mkv") == packets(whole)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--segments", "2", "--within", "0.1"), "--budget and --within carry steps from frame to frame"),
        (("--segments", "0"), "--segments"),
        (("--segments", "2", "--lead-in", "-1"), "--lead-in"),
        (("--lead-in", "5"), "--lead-in 5: is for segments; add --segments N"),
    ],
)
def test_what_cannot_be_divided_is_one_line(
    furnished: Path, tmp_path: Path, words: tuple[str, ...], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    files = furnished / "room", furnished / "film.mkv", "--output", tmp_path / "o.mkv"
    assert expected in error_here(app.main, capsys, *files, *BACKEND, *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("plan", "expected"),
    [
        ("{}", "o.mkv.segments: is in the way of the segments; move it away"),
        ("[", "o.mkv.segments: is in the way of the segments; move it away"),
        ('{"format": 1, "of": "", "stretches": []}', "letter.txt: is no part of segments and would be lost"),
    ],
)
def test_a_folder_that_is_not_ours_stays(
    furnished: Path, tmp_path: Path, plan: str, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "o.mkv.segments").mkdir()
    (tmp_path / "o.mkv.segments" / "letter.txt").write_text("dear")
    (tmp_path / "o.mkv.segments" / "plan.json").write_text(plan)
    words = furnished / "room", furnished / "film.mkv", *BACKEND, "--output", tmp_path / "o.mkv", "--segments", "3"
    assert expected in error_here(app.main, capsys, *words)
    assert (tmp_path / "o.mkv.segments" / "letter.txt").read_text() == "dear"


def test_a_single_picture_has_no_segments(furnished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    render(furnished, tmp_path / "o.png", "--segments", "2")
    assert f"--segments: {tmp_path / 'o.png'} is a single picture" in capsys.readouterr().err


def test_in_a_window_segments_mean_nothing(furnished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = furnished / "room", furnished / "film.mkv", "--segments", "2"
    assert "--segments 2: is for --output" in error_here(app.main, capsys, *words)


def test_a_film_is_looked_through_for_its_cuts(furnished: Path) -> None:
    with MediaReader.open(furnished / "film.mkv") as reader:
        film = look_through(reader, None)
    assert film.cuts == (0, SHOT, 2 * SHOT)
    np.testing.assert_allclose(film.times_s, np.arange(FRAMES) / 25, atol=1e-3)  # Matroska states times in milliseconds


def film_of(length: int, *cuts: int) -> Film:
    return Film(tuple(float(n) for n in range(length)), (0, *cuts))


def test_stretches_begin_at_the_nearest_cuts_and_together_are_the_film() -> None:
    film = film_of(100, 20, 48, 53, 90)
    assert divide(film, 2, carries=True, lead_in=None) == [Stretch(0, 0, 48), Stretch(48, 48, 100)]
    # frame 90 is too far from 75
    assert [each.begin for each in divide(film, 4, carries=True, lead_in=None)] == [0, 20, 48]
    within = divide(film, 4, carries=True, lead_in=10)
    assert within[-1] == Stretch(65, 75, 100)
    assert within_shots(within, film) == [3]
    assert within_shots(divide(film, 4, carries=True, lead_in=30), film) == []  # frames are drawn from the cut at 53 on


@pytest.mark.parametrize("count", [1, 2, 7, 100, 999])
def test_no_frame_is_lost_or_written_twice(count: int, rng: np.random.Generator) -> None:
    film = film_of(60, *sorted(rng.choice(np.arange(1, 60), 5, replace=False).tolist()))
    for carries in (True, False):
        for lead_in in (None, 0, 7, 1000):
            stretches = divide(film, count, carries=carries, lead_in=lead_in)
            assert len(stretches) <= count
            assert [n for each in stretches for n in range(each.begin, each.end or 0)] == list(range(60))
            assert all(0 <= each.lead <= each.begin < (each.end or 0) for each in stretches)
