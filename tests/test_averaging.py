"""How often pictures are captured: what noise does to T is foretold, and averaging brings it to what was aimed at."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.raster import Shape
from counterlight.tools.acquire_transport import main
from counterlight.tools.acquisition.acquire import Acquisition, acquire
from counterlight.tools.acquisition.averaging import Aim, Averaging, error_by_noise, random_pixels
from counterlight.tools.acquisition.cameras.camera import Exposures
from counterlight.tools.acquisition.cameras.live import LiveCamera
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, MemoryScreen, SimulatedCamera, SimulatedEye
from counterlight.tools.acquisition.memory import MemoryStore
from counterlight.tools.acquisition.plan import Level, MakeScheme, Noise, Reference
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme
from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme
from counterlight.tools.acquisition.store import Wanted, open_store
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.transport.transport import Transport
from tests.acquired_rooms import NOISY, PROJECTOR, error, room_of, run, sharp_wall, with_far_light
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
    # One number for all schemes; multiplexed pictures give two thirds of it, far light goes by the threshold.
    assert 0.5 * found < done.averaged.once < 2.0 * found


def test_averaging_brings_the_transports_error_to_what_was_aimed_at(rng: np.random.Generator) -> None:
    truth = sharp_wall(rng)
    once = run(room_of(truth), HierarchicalScheme(), DIM)
    done = averaged(truth, DIM, HierarchicalScheme())
    assert done.averaged
    assert error(once.measured.transport, truth) > 0.02
    assert error(done.measured.transport, truth) < 0.0057  # 0.005 aimed at
    assert done.averaged.error <= 0.005
    assert done.exposures - done.pictures == done.averaged.added


def test_a_camera_without_noise_takes_each_picture_once(rng: np.random.Generator) -> None:
    done = averaged(sharp_wall(rng), CameraSettings(Sensor(0, 0, 16)), HierarchicalScheme())
    assert done.averaged
    assert (done.averaged.most, done.averaged.added) == (1, 0)
    assert str(done.averaged).endswith("each picture captured once")


def test_the_finest_pictures_are_captured_as_often_as_time_allows() -> None:
    averaging = Averaging(Aim(error=0.01, seconds=100.0), 0.05)  # 25 times for the aim
    last = Level("last", [np.zeros((2, 2), np.bool_)] * 10, further=0, cover=1, share=1.0)
    assert averaging.chosen(last, 0.1) == 25  # 1 s a round
    assert averaging.chosen(replace(last, share=0.25), 0.1) == 7
    assert averaging.chosen(last, 1.0) == 11  # 10 s a round beside the first
    assert averaging.chosen(replace(last, further=1), 1.0) == 6  # the other half is the next level's
    assert averaging.chosen(last, 100.0) == 1
    assert averaging.chosen(replace(last, share=0.0), 0.1) == 1
    assert averaging.take(last, 11, 1.0) == "last: each of 10 pictures is captured 11 times, 100 s more"
    assert averaging.chosen(last, 0.1) == 1  # the time is spent
    assert (averaging.done.most, averaging.done.added, averaging.done.wanted) == (11, 100, 25)
    assert "25 times were wanted" in str(averaging.done)


def test_the_size_of_the_transport_is_read_off_one_picture(rng: np.random.Generator) -> None:
    """Without noise of light, what noise of the dark does is its size by the number of entries: closed form."""
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
    # √0.9 for what the levels share; 600 camera pixels tell ‖T‖² to 6 %.
    assert error_by_noise(room, seen) == pytest.approx(0.949 * exact, rel=0.08)


# On disk, and by the command.


def test_what_was_chosen_stays_chosen(tmp_path: Path) -> None:
    session = {"camera": "test", "repeats": list[int]()}
    for later in (3, 9):  # another run, which has more time
        with open_store(tmp_path / "captures", dict(session), Exposures(), Wanted(tmp_path / "room")) as store:
            assert store.averaged
            assert [store.repeats(level, partial(int, later)) for level in (0, 1)] == [3, 3]
    with open_store(tmp_path / "captures", {"camera": "test"}, Exposures(), Wanted(tmp_path / "room")) as store:
        assert store.averaged  # by another option, but begun so
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


class CountingEye(SimulatedEye):
    def __init__(self, projector: Shape, settings: CameraSettings, truth: Transport) -> None:
        super().__init__(room_of(truth, projector=projector), settings, MemoryScreen(projector))
        self.waited = -1  # a frame skips to itself

    def skip(self) -> None:
        super().skip()
        self.waited += 1


def test_captures_of_a_picture_that_stands_follow_each_other_without_a_wait(rng: np.random.Generator) -> None:
    eye = CountingEye(PROJECTOR, NOISY, sharp_wall(rng))
    camera = LiveCamera(MemoryScreen(PROJECTOR), eye, Exposures(), lag=3)
    white, black = (np.full((*PROJECTOR, 3), level, np.uint8) for level in (255, 0))
    waits = []
    for number, picture in enumerate((white, white.copy(), black, white)):
        before = eye.waited
        camera.capture(number, picture)
        waits.append(eye.waited - before - 1)
    camera.show(black)  # somebody else, as the checks do
    camera.capture(4, white)
    assert [*waits, eye.waited - before - 1 - (3 + 1)] == [3, 0, 3, 3, 3]


@pytest.mark.parametrize("electrons", [20000.0, 5000.0])
def test_judged_by_the_rigs_own_transport(electrons: float) -> None:
    """T as somebody else has made it, whose channels are not all as noisy."""
    rig = noisy_rig(small_room("wall"), electrons)
    once, chosen = (
        error_of(acquired(rig, HierarchicalScheme(), averaged=averaged).measured.transport, rig)
        for averaged in (False, True)
    )
    assert once > 0.009 * (20000 / electrons) ** 0.5
    assert chosen < 0.0055  # 0.005 aimed at
