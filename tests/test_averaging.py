"""How often pictures are captured: the effect of noise on T is predicted, and averaging reduces it to the aim."""

import io
import re
from contextlib import redirect_stderr
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.raster import Shape
from counterlight.tools.acquire_transport import main
from counterlight.tools.acquisition.acquire import Acquisition, acquire
from counterlight.tools.acquisition.averaging import MOST_REPEATS, Aim, Averaging, error_by_noise, random_pixels
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.tools.acquisition.cameras.live import LiveCamera
from counterlight.tools.acquisition.cameras.simulated import (
    CameraSettings,
    MemoryScreen,
    SimulatedCamera,
    SimulatedDevice,
)
from counterlight.tools.acquisition.pace import CHECKS_S, Pace, computing_s, duration
from counterlight.tools.acquisition.plan import Expected, Level, MakeScheme, Noise, Picture, Reference
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme
from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme
from counterlight.tools.acquisition.store import MemoryStore, Wanted, open_store
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.transport.transport import Transport
from tests.acquired_rooms import NOISY, PROJECTOR, error, mirror, room_of, run, sharp_wall, with_far_light
from tests.small_rigs import small_room
from tests.studies.noise import acquired, error_of, noisy_rig

DIM = CameraSettings(Sensor(4000, 5, 14))
HOURS = Aim(seconds=1e5)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(14)


def averaged(truth: Transport, settings: CameraSettings, scheme: MakeScheme, aim: Aim = HOURS) -> Acquisition:
    room = room_of(truth)
    camera = SimulatedCamera(room, settings)
    return acquire(camera, MemoryStore(camera.exposures, averaged=True), scheme, room.projectors, None, aim)[0]


@pytest.mark.parametrize("settings", [NOISY, DIM], ids=["20 000 electrons", "4 000 electrons"])
@pytest.mark.parametrize("far", [0.0, 0.2])
@pytest.mark.parametrize("scheme", [HierarchicalScheme(), MultiplexedScheme(8)], ids=["hierarchical", "multiplexed"])
def test_what_noise_does_to_the_transport_is_foretold(
    scheme: MakeScheme, far: float, settings: CameraSettings, rng: np.random.Generator
) -> None:
    truth = sharp_wall(rng)
    truth = with_far_light(truth, far) if far else truth
    done = averaged(truth, settings, scheme, Aim(seconds=0))
    assert done.averaged
    found = error(run(room_of(truth), scheme, settings).measured.transport, truth)
    assert done.averaged.most == 1
    # One figure serves all schemes; multiplexed pictures give two thirds of it, and far light follows the threshold.
    assert 0.5 * found < done.averaged.once < 2.0 * found


def test_averaging_brings_the_transports_error_to_what_was_aimed_at(rng: np.random.Generator) -> None:
    truth = sharp_wall(rng)
    once = run(room_of(truth), HierarchicalScheme(), DIM)
    done = averaged(truth, DIM, HierarchicalScheme())
    assert done.averaged
    assert error(once.measured.transport, truth) > 0.02
    assert error(done.measured.transport, truth) < 0.0057  # the aim is 0.005
    assert done.averaged.error <= 0.005
    assert done.exposures - done.pictures == done.averaged.added


def test_a_camera_without_noise_takes_each_picture_once(rng: np.random.Generator) -> None:
    done = averaged(sharp_wall(rng), CameraSettings(Sensor(0, 0, 16)), HierarchicalScheme())
    assert done.averaged
    assert (done.averaged.most, done.averaged.added) == (1, 0)
    assert str(done.averaged).endswith("each picture captured once")


def paced(each_s: float) -> Pace:
    pace = Pace(1)
    pace.took(each_s, again=False)
    return pace


def finest(pictures: int) -> Level:
    return Level("finest", [np.zeros((2, 2), np.bool_)] * pictures, cover=1, share=1.0)


def test_the_finest_pictures_are_captured_as_often_as_time_allows() -> None:
    aim = Aim(error=0.01)
    averaging = Averaging(aim, 0.05, paced(1.0), until_s=251.0)  # the aim needs 25 captures; one second remains
    assert averaging.chosen(finest(10)) == 25
    assert Averaging(aim, 0.05, paced(1.0), 250.9).chosen(finest(10)) == 24
    assert Averaging(aim, 0.05, paced(1.0), 5.0).chosen(finest(10)) == 1
    assert Averaging(aim, 0.05, paced(1.0), 251.0).chosen(replace(finest(10), share=0.25)) == 7
    assert Averaging(aim, 0.05, paced(1.0), 251.0).chosen(replace(finest(10), share=0.0)) == 1
    later = (Expected(10, share=1.0), Expected(5))  # these levels take 20 n + 5 seconds
    assert Averaging(aim, 0.05, paced(1.0), 251.0).chosen(replace(finest(10), later=later)) == 12
    # limited to the pace of a camera with 7 exposures per second
    assert Averaging(aim, 0.05, paced(1e-6), 251.0).chosen(finest(100)) == 17
    assert averaging.take(finest(10), 11) == "finest: 10 pictures, captured 11 times each"
    assert (averaging.done.most, averaging.done.added, averaging.done.wanted) == (11, 100, 25)
    assert "25 times were wanted" in str(averaging.done)


@pytest.mark.parametrize(("pictures", "times"), [(10, 25), (20, 16), (100, 3), (5, 46), (1, MOST_REPEATS)])
def test_the_length_is_kept_if_levels_have_other_numbers_of_pictures(pictures: int, times: int) -> None:
    """The plan is 1 + 60 + 25 · 10 seconds; the acquisition may take 295 to 389."""
    pace = paced(1.0)
    averaging = Averaging(Aim(error=0.01), 0.05, pace, until_s=1e6)
    assert averaging.chosen(Level("first", [np.zeros((2, 2), np.bool_)] * 60, (Expected(10, share=1.0),))) == 1
    for _ in range(60):
        pace.took(1.0, again=False)
    assert averaging.chosen(finest(pictures)) == times


def test_captures_once_stay_captures_once_whatever_was_settled() -> None:
    averaging = Averaging(Aim(error=0.01), 0.005, paced(1.0), until_s=1e6)
    assert averaging.chosen(Level("first", [np.zeros((2, 2), np.bool_)] * 60, (Expected(100, share=1.0),))) == 1
    assert averaging.chosen(finest(2)) == 1


class PacedCamera(SimulatedCamera):
    """Camera that takes a seventh of a second per capture, by its own clock."""

    now_s = 0.0

    def capture(self, number: int, picture: Picture) -> tuple[Shot, ...]:
        self.now_s += 1 / 7
        return super().capture(number, picture)


class TimedLines(io.StringIO):
    """Printed lines, each with its time."""

    def __init__(self, camera: PacedCamera) -> None:
        super().__init__()
        self._camera, self.lines = camera, list[tuple[float, str]]()

    def write(self, text: str) -> int:
        self.lines += [(self._camera.now_s, line) for line in text.splitlines() if line]
        return len(text)


@pytest.mark.parametrize(
    ("scheme", "kind", "settings"),
    [  # each scheme with each kind; each noise with each scheme and with each kind
        pytest.param(scheme, kind, (NOISY, DIM)[(row + column) % 2], id=f"{name}-{kind}")
        for row, (name, scheme) in enumerate(
            [("hierarchical", HierarchicalScheme()), ("multiplexed", MultiplexedScheme())]
        )
        for column, kind in enumerate(["sharp", "blurred", "far light", "mirror"])
    ],
)
def test_the_time_left_is_foretold_from_the_first_minute_on(
    scheme: MakeScheme, kind: str, settings: CameraSettings, rng: np.random.Generator
) -> None:
    truth = {
        "sharp": lambda: sharp_wall(rng),
        "blurred": lambda: sharp_wall(rng, 1.5),
        "far light": lambda: with_far_light(sharp_wall(rng), 0.2),
        "mirror": lambda: mirror(rng),
    }[kind]()
    room = room_of(truth)
    camera = PacedCamera(room, settings)
    said = TimedLines(camera)
    with redirect_stderr(said):
        store = MemoryStore(camera.exposures, averaged=True)
        (done,) = acquire(camera, store, scheme, room.projectors, clock=lambda: camera.now_s)
    computing = computing_s(truth.shape[0])  # solving takes no time by the camera's clock
    whole_s = camera.now_s + computing
    assert whole_s <= 600 - CHECKS_S
    estimates = [(at, seconds_left(line)) for at, line in said.lines if "left" in line or "acquisition" in line]
    assert all(at + left == pytest.approx(whole_s, rel=0.25) for at, left in estimates if at >= 60)
    most, about = (
        re.search(r"(up to about|about) (\d+) exposures of \d+ pictures, ", line) for _, line in said.lines[:2]
    )
    assert most
    assert about
    assert (most[1], about[1]) == ("up to about", "about")
    assert done.exposures <= 1.05 * int(most[2])  # one more capture of each of the finest pictures would be too many


def seconds_left(line: str) -> float:
    found = re.search(r"(?:about|,) (?:(\d+) min)? ?(?:(\d+) s)?(?: left|$)", line)
    assert found, line
    return 60 * int(found[1] or 0) + int(found[2] or 0)


def test_durations_in_words() -> None:
    said = [duration(seconds) for seconds in (0.4, 99.4, 99.6, 120, 599, 3599, 7500)]
    assert said == ["0 s", "99 s", "1 min 40 s", "2 min", "10 min", "1 h 0 min", "2 h 5 min"]


def test_the_size_of_the_transport_is_read_off_one_picture(rng: np.random.Generator) -> None:
    """With dark noise only, its effect follows in closed form from the size of T and the number of entries."""
    camera, projector = (20, 30), (40, 50)
    entries, value, dark = 5, 0.2, 1e-3
    T = np.zeros((camera[0] * camera[1], projector[0] * projector[1]))
    for row in T:
        row[rng.choice(len(row), entries, replace=False)] = value
    black = np.zeros((*camera, 3))
    floodlight = np.repeat(T.sum(axis=1).reshape(*camera, 1), 3, axis=2)
    room = Reference(black, floodlight, Noise(np.full(3, dark), np.zeros(3)), np.zeros(camera, np.bool_), 16)
    seen = np.repeat((T @ random_pixels(projector).ravel()).reshape(*camera, 1), 3, axis=2)
    exact = dark / value  # √(n · 5 · dark²) / √(n · 5 · value²)
    # √0.9 is the noise left after levels are combined (AGREEMENT); 600 camera pixels give ‖T‖² to 6 %.
    assert error_by_noise(room, seen) == pytest.approx(0.949 * exact, rel=0.08)


# The choice is stored on disk, and applies to later runs of the command.


def test_what_was_chosen_stays_chosen(tmp_path: Path) -> None:
    session = {"camera": "test", "repeats": list[int]()}
    for later in (3, 9):  # another run, with more time
        with open_store(tmp_path / "captures", dict(session), Exposures(), Wanted(tmp_path / "room")) as store:
            assert store.averaged
            assert [store.repeats(level, partial(int, later)) for level in (0, 1)] == [3, 3]
    with open_store(tmp_path / "captures", {"camera": "test"}, Exposures(), Wanted(tmp_path / "room")) as store:
        assert store.averaged  # the option differs, but the session began this way
    path = tmp_path / "captures" / "session.toml"
    path.write_text(path.read_text().replace("3,", "-3,", 1))
    with (
        pytest.raises(InputError, match=r"repeats \[-3, 3\], expected numbers from 1 to 128"),
        open_store(tmp_path / "captures", session, Exposures(), Wanted(tmp_path / "room")),
    ):
        pass


def test_captures_that_were_begun_without_are_gone_on_with_without(tmp_path: Path) -> None:
    for session in ({"camera": "test"}, {"camera": "test", "repeats": list[int]()}):
        with open_store(tmp_path / "captures", session, Exposures(), Wanted(tmp_path / "room")) as store:
            assert not store.averaged


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--camera", "simulated:x", "--averaging", "-1"], "expected a number of minutes, 0 or more, found '-1'"),
        (
            ["--camera", "simulated:x", "--averaging", "5", "--shots", "2"],
            "--averaging 5: of no meaning with --shots 2",
        ),
        (["--camera", "folder:x", "--averaging", "5"], "--averaging 5: of no meaning with --camera folder: without"),
        (["--camera", "simulated:x", "--averaging", "5", "--pictures", "9"], "--averaging 5.0: of no meaning to"),
    ],
)
def test_options_that_contradict_are_refused(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*options, "-o", str(tmp_path / "room")]) == 2
    assert message in capsys.readouterr().err


class CountingDevice(SimulatedDevice):
    def __init__(self, projector: Shape, settings: CameraSettings, truth: Transport) -> None:
        super().__init__(room_of(truth, projector=projector), settings, MemoryScreen(projector))
        self.waited = -1  # a frame skips all frames up to its own

    def skip(self) -> None:
        super().skip()
        self.waited += 1


def test_captures_of_a_picture_that_stands_follow_each_other_without_a_wait(rng: np.random.Generator) -> None:
    device = CountingDevice(PROJECTOR, NOISY, sharp_wall(rng))
    camera = LiveCamera(MemoryScreen(PROJECTOR), device, Exposures(), lag=3)
    white, black = (np.full((*PROJECTOR, 3), level, np.uint8) for level in (255, 0))
    waits = []
    for number, picture in enumerate((white, white.copy(), black, white)):
        before = device.waited
        camera.capture(number, picture)
        waits.append(device.waited - before - 1)
    camera.show(black)  # the checks also show pictures between captures
    camera.capture(4, white)
    assert [*waits, device.waited - before - 1 - (3 + 1)] == [3, 0, 3, 3, 3]


@pytest.mark.parametrize("electrons", [20000.0, 5000.0])
def test_judged_by_the_rigs_own_transport(electrons: float) -> None:
    """T of the independent rig, whose channels differ in noise."""
    rig = noisy_rig(small_room("wall"), electrons)
    once, chosen = (
        error_of(acquired(rig, HierarchicalScheme(), averaged=averaged).measured.transport, rig)
        for averaged in (False, True)
    )
    assert once > 0.009 * (20000 / electrons) ** 0.5
    assert chosen < 0.0055  # the aim is 0.005
