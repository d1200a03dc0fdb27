"""Pictures first: T, response and far light from a few pictures, and a room whenever acquisition stops."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import ndimage, sparse
from scipy.special import erf
from threadpoolctl import threadpool_limits

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.pipeline.content import camera_psnr
from counterlight.raster import side_by_side
from counterlight.response import RasterResponse, Response
from counterlight.tools import acquire_transport
from counterlight.tools.acquisition.acquire import Acquisition
from counterlight.tools.acquisition.cameras.camera import Shot
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, SimulatedRoom
from counterlight.tools.acquisition.few.acquire import acquire_pictures, check_count
from counterlight.tools.acquisition.few.order import BLACK, PRIMARIES, RAMPS, Order, Turns
from counterlight.tools.acquisition.plan import Picture
from counterlight.tools.acquisition.store import MemoryStore
from counterlight.tools.joining.projectors import join_transports
from counterlight.tools.transport.interval import fit_interval, read_interval
from counterlight.tools.transport.transport import Transport
from tests.acquired_rooms import LINEAR, NOISY, QUIET, error, shown_by, with_far_light
from tests.programs import command, fail, succeed
from tests.rooms import write_blurred_room


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Use one thread, as the command does. Two threads made small products several times slower."""
    with threadpool_limits(limits=1):
        yield


CAMERA, PROJECTOR = (18, 24), (32, 40)  # the camera sees whole periods of the sines
AMBIENT = 0.01
GAMMAS = 2.1, 2.2, 2.35


def wall(rng: np.random.Generator, sigma: float = 0.7, apart: float = 0.0) -> Transport:
    """Return Gaussian spots, with a random paint for each camera pixel and channel.

    apart : projector pixels between the two halves of a spot, along a diagonal.
    """
    y, x = np.mgrid[: CAMERA[0], : CAMERA[1]].reshape(2, -1)
    down, across = 3.5 + (y + 0.5) * 24 / CAMERA[0], 3.5 + (x + 0.5) * 32 / CAMERA[1]
    spots = 0
    for half in (-apart / 2, apart / 2):
        lines = [_line(place + half, size, sigma) for place, size in zip((down, across), PROJECTOR, strict=True)]
        spots = spots + (lines[0][:, :, None] * lines[1][:, None]).reshape(len(y), -1) / 2
    spots = np.where(spots > 1e-4, spots, 0)
    paint = rng.uniform(0.3, 1, (3, len(spots), 1))
    return Transport.from_matrices([sparse.csr_array((spots * each).astype(np.float32)) for each in paint])


def _line(place: np.ndarray, size: int, sigma: float) -> np.ndarray:
    """Return a Gaussian's share of each pixel of a line."""
    edges = np.arange(size + 1) - 0.5 - place[:, None]
    return np.diff(erf(edges / (np.sqrt(2) * sigma)), axis=1) / 2


def room_of(transport: Transport, response: Response | None = None) -> SimulatedRoom:
    ambient = np.full((*CAMERA, 3), AMBIENT, np.float32)
    return SimulatedRoom("test", transport, ambient, (PROJECTOR,), (response or Response("linear")).over(PROJECTOR))


def acquired(
    room: SimulatedRoom, count: int, settings: CameraSettings = NOISY, given: Response | None = LINEAR
) -> Acquisition:
    camera = SimulatedCamera(room, settings)
    return acquire_pictures(camera, MemoryStore(camera.exposures), count, [PROJECTOR], given)[0]


def predicted(done: Acquisition, truth: Transport, drive: np.ndarray) -> float:
    """Return the PSNR in dB between T applied to a picture and the truth."""
    shape = (*CAMERA, 3)
    seen, expected = (T.apply(drive).reshape(shape) for T in (done.measured.transport, truth))
    return camera_psnr(expected, seen, np.ones(CAMERA, np.bool_), 1.0)


def soft_picture(rng: np.random.Generator) -> np.ndarray:
    """Return a picture, (projector pixels, 3), 0..1, with detail two projector pixels wide."""
    noise = ndimage.gaussian_filter(rng.normal(size=(*PROJECTOR, 3)), (1, 1, 0))
    return np.clip(0.5 + noise, 0, 1).reshape(-1, 3)


# Which pictures.


def test_more_pictures_begin_with_the_same_ones() -> None:
    few, many = Order(PROJECTOR).pictures(12), Order(PROJECTOR).pictures(50)
    assert all(np.array_equal(few[number], many[number]) for number in range(12))
    assert len({many[number].tobytes() for number in range(50)}) == 49  # only white occurs twice


def test_the_first_pictures_are_black_and_primaries() -> None:
    order = Order(PROJECTOR)
    assert order.least == 9
    assert not order.codes(BLACK).any()
    np.testing.assert_array_equal(sum(order.codes(number).astype(int) for number in PRIMARIES), 255)
    assert [number for number in range(70) if order.is_white(number)] == [9, 31, 63]
    assert (order.codes(9) == 255).all()
    assert (np.diff(order.codes(RAMPS)[..., 0].astype(int), axis=1) > 0).all()


def test_large_projectors_need_four_more() -> None:
    assert Order((768, 1024)).least == 13
    assert Order((200, 1024)).least == 11


# Known answers.


def test_gaussian_spots_are_found_exactly_without_noise(rng: np.random.Generator) -> None:
    truth = wall(rng)
    found = acquired(room_of(truth), 9, QUIET)
    # A sine's codes are rounded, by up to 0.5 % of light near its crest. Spots are cut where they fall below 1/250.
    assert error(found.measured.transport, truth) < 0.03


def test_random_pictures_tell_the_shape_of_spots(rng: np.random.Generator) -> None:
    """Spots in two halves are no Gaussians along rows and columns, so places and widths alone do not describe them."""
    truth = wall(rng, apart=1.6)
    errors = [error(acquired(room_of(truth), count, QUIET).measured.transport, truth) for count in (9, 20, 48)]
    assert errors[0] > 0.15
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.1 * errors[0]  # the fit has 111 equations for 49 unknowns, and 16-bit noise


def test_even_far_light_is_distinguished_from_wide_spots(rng: np.random.Generator) -> None:
    near = wall(rng)
    truth = with_far_light(near, 0.3)
    drive = np.zeros((PROJECTOR[0] * PROJECTOR[1], 3))
    drive[: len(drive) // 4] = 1  # the dark part shows only far light
    for count, least in ((9, 29), (16, 32)):
        found = acquired(room_of(truth), count)
        assert found.measured.transport.far is not None
        assert predicted(found, truth, drive) > least
    assert predicted(acquired(room_of(near), 16), near, drive) > 45


def test_the_response_is_measured_by_the_same_pictures(rng: np.random.Generator) -> None:
    codes = np.repeat(np.linspace(0, 1, 256)[:, None], 3, axis=1)
    table = codes ** np.array(GAMMAS)
    response = Response("table", table=tuple(tuple(float(v) for v in row) for row in table))
    truth = wall(rng)
    for count in (9,):
        found = acquired(room_of(truth, response), count, given=None)
        assert found.light is not None
        # A place is wrong by 0.02 of 40 pixels, and 432 camera pixels have 1 % noise: 0.05 %.
        np.testing.assert_allclose(found.light.response.to_linear(codes), table, atol=0.01)
        assert predicted(found, truth, soft_picture(rng)) > 38


def test_held_out_pictures_say_how_good_it_is_and_more_are_better(rng: np.random.Generator) -> None:
    truth = wall(rng, apart=1.6)
    drive = soft_picture(rng)
    few, many = (acquired(room_of(truth), count) for count in (12, 48))
    assert predicted(few, truth, drive) + 3 < predicted(many, truth, drive)
    assert few.check.error > 1.5 * many.check.error
    assert many.check.error < 2.5 * many.check.noise
    assert "held out: 4 random pictures, predicted to" in many.measured.notes[1]


def test_about_nine_of_ten_values_are_inside_the_interval_of_held_out_pictures(rng: np.random.Generator) -> None:
    truth = wall(rng)
    found, camera, inside = acquired(room_of(truth), 48), SimulatedCamera(room_of(truth), NOISY), []
    assert found.check.lights is not None
    interval = fit_interval(*found.check.lights.reshape(2, 4, *CAMERA, 3), np.ones(CAMERA, bool))
    for number in range(6):
        codes = rng.integers(0, 256, (*PROJECTOR, 3), np.uint8)
        seen = camera.exposures.radiance(camera.capture(100 + number, codes)) - AMBIENT
        expected = found.measured.transport.apply(codes.reshape(-1, 3) / 255).reshape(seen.shape)
        inside.append(interval.inside(expected, seen).mean())
    # The fit of all pictures is better than the fit by the others: 0.93, and 0.96 for spots that are torn apart.
    assert np.mean(inside) == pytest.approx(0.92, abs=0.03)


def test_all_pictures_are_counted(rng: np.random.Generator) -> None:
    room = room_of(wall(rng))
    camera = Counting(room, NOISY)
    done = acquire_pictures(camera, MemoryStore(camera.exposures), 12, [PROJECTOR], None)[0]
    assert done.pictures == camera.taken == 12
    assert done.light is not None
    assert done.light.adds_up


class Counting(SimulatedCamera):
    """Counts its captures, and raises KeyboardInterrupt before capture `interrupted`."""

    def __init__(self, room: SimulatedRoom, settings: CameraSettings, interrupted: int | None = None) -> None:
        super().__init__(room, settings)
        self.taken, self._interrupted = 0, interrupted

    def capture(self, number: int, picture: Picture) -> tuple[Shot, ...]:
        if number == self._interrupted:
            raise KeyboardInterrupt
        self.taken += 1
        return super().capture(number, picture)


# Stopping.


def test_stopped_early_the_room_is_that_of_so_many_pictures(
    rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    room = room_of(wall(rng))
    camera = Counting(room, NOISY, interrupted=11)
    (stopped,) = acquire_pictures(camera, MemoryStore(camera.exposures), 48, [PROJECTOR])
    assert "stopped after 11 of 48 pictures" in capsys.readouterr().err
    whole = acquired(room, 11, given=None)
    assert stopped.pictures == 11
    np.testing.assert_array_equal(stopped.measured.transport.near.weights, whole.measured.transport.near.weights)


def test_stopped_before_there_are_enough_it_is_an_interruption(rng: np.random.Generator) -> None:
    camera = Counting(room_of(wall(rng)), NOISY, interrupted=8)
    with pytest.raises(KeyboardInterrupt):
        acquire_pictures(camera, MemoryStore(camera.exposures), 48, [PROJECTOR])


# Refusals.


def test_too_few() -> None:
    with pytest.raises(InputError, match=r"--pictures 8: a projector of 40x32 needs 9 or more"):
        check_count(8, [PROJECTOR])


def test_too_few_for_two() -> None:
    check_count(17, [PROJECTOR, (20, 24)])
    with pytest.raises(InputError, match=r"--pictures 16: projectors of 40x32 and 24x20 need 17 or more"):
        check_count(16, [PROJECTOR, (20, 24)])


def test_a_projector_that_is_off(rng: np.random.Generator) -> None:
    with pytest.raises(InputError, match="check that the projector is on"):
        acquired(room_of(wall(rng).scaled(np.zeros(CAMERA[0] * CAMERA[1]))), 12)


def test_a_camera_that_moved_between_whites(rng: np.random.Generator) -> None:
    class Moved(SimulatedCamera):
        def capture(self, number: int, picture: Picture) -> tuple[Shot, ...]:
            shots = super().capture(number, picture)
            return tuple(np.roll(shot, 2, axis=1) for shot in shots) if number > 20 else shots

    camera = Moved(room_of(wall(rng)), NOISY)
    with pytest.raises(InputError, match="camera, projector or scene moved"):
        acquire_pictures(camera, MemoryStore(camera.exposures), 40, [PROJECTOR], None)


# The command.


def test_a_room_of_nine_pictures_plays_and_goes_on(tmp_path: Path, rng: np.random.Generator) -> None:
    write_blurred_room(tmp_path / "there", rng, CAMERA, PROJECTOR)
    words = "--camera", f"simulated:{tmp_path / 'there'}", "-o", tmp_path / "room"
    said = succeed("acquire", *words, "--pictures", 9, "--averaging", 0)
    assert "9 pictures, 9 exposures" in said
    assert "check: the ramps of the acquisition" in said
    assert "expected on the wall: " not in said
    said = succeed("acquire", *words, "--pictures", 12, "--force", "--reuse-captures")
    assert "12 pictures, 12 exposures, 9 of them from before" in said
    assert "check: a random pattern is predicted to" in said
    assert said.startswith("expected on the wall: ")
    assert read_interval(calibration.read(tmp_path / "room")) is not None
    succeed("build", tmp_path / "room")
    picture = np.full((*CAMERA, 3), 128, np.uint8)
    assert cv2.imwrite(str(tmp_path / "grey.png"), picture)
    succeed("play", tmp_path / "room", tmp_path / "grey.png", "--no-config", "--output", tmp_path / "drive.png")
    assert cv2.imread(str(tmp_path / "drive.png")).shape[:2] == PROJECTOR


def test_a_folder_that_ends_makes_a_room_of_what_is_there(tmp_path: Path, rng: np.random.Generator) -> None:
    room, exchange = room_of(wall(rng)), tmp_path / "exchange"
    camera = SimulatedCamera(room, NOISY)
    words = "--camera", f"folder:{exchange}", "--projector", "40x32", "-o", tmp_path / "room", "--pictures", 16
    assert "waiting for 16 captures" in fail("acquire", *words)
    for number in range(10):
        codes = shown_by(exchange / "patterns" / f"{number:05}.png")
        (shot,) = camera.capture(number, codes)
        assert cv2.imwrite(str(exchange / "captures" / f"{number:05}.png"), np.ascontiguousarray(shot[..., ::-1]))
    assert "or make the room of those that are there: --pictures 10" in fail("acquire", *words)
    done = command("acquire", *words, "--wait", 0.1)
    assert done.returncode == 0, done.stderr
    assert "stopped after 10 of 16 pictures" in done.stderr
    assert calibration.read(tmp_path / "room").calibration.mask.mean() > 0.8


@pytest.mark.parametrize(("option", "value"), [("--scheme", "hierarchical"), ("--threshold", "5"), ("--tile", "6")])
def test_what_has_no_meaning_beside_it(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = "--camera", "v4l2:0", "--pictures", "9", option, value, "-o", "nowhere"
    assert acquire_transport.main(list(words)) == 2
    assert "--pictures" in capsys.readouterr().err


def test_captured_light_of_a_check_has_noise_where_the_projector_lights_nothing(rng: np.random.Generator) -> None:
    dark = np.tile(np.arange(CAMERA[1]) < 12, CAMERA[0])
    room = room_of(wall(rng).scaled(np.where(dark, 0, 1)))
    found, camera = acquired(room, 17), SimulatedCamera(room, NOISY)
    black = np.zeros((*PROJECTOR, 3), np.uint8)
    first, second = (camera.exposures.radiance(camera.capture(number, black)) for number in (100, 101))
    assert found.check.lights is not None
    captured = found.check.lights[1][:, dark]
    assert captured.std() == pytest.approx((first - second).std(), rel=0.15)  # deviations of 648 and 1296 values


# Several projectors, several cameras.


def test_projectors_take_turns_and_black_is_shown_once() -> None:
    other, turns = (20, 24), Turns((PROJECTOR, (20, 24)))
    shown = turns.pictures(21)
    assert not shown[0].any()
    for projector, size, left in ((0, PROJECTOR, 0), (1, other, PROJECTOR[1])):
        part = slice(size[0]), slice(left, left + size[1])
        alone = Order(size).pictures(11)
        numbers = turns.numbers(projector, turns.of_each(21))
        assert len(numbers) == 11
        for number, codes in zip(numbers, alone, strict=True):
            np.testing.assert_array_equal(shown[number][part], codes)
            beside = shown[number].copy()
            beside[part] = 0
            assert not beside.any()
    assert sorted({*turns.numbers(0, 11), *turns.numbers(1, 11)}) == list(range(21))
    assert [turns.of_each(count) for count in (20, 21, 22)] == [10, 11, 11]


def test_two_projectors_and_two_cameras(rng: np.random.Generator) -> None:
    """Each pair's T equals a separate acquisition of it, and is empty where the projector lights nothing."""
    truth = [[wall(rng, 0.7), wall(rng, 0.5)], [wall(rng, 0.6).scaled(np.zeros(CAMERA[0] * CAMERA[1])), wall(rng, 0.6)]]
    rooms = [two_lit(join_transports(each, [PROJECTOR] * 2)) for each in truth]
    camera = SimulatedCamera(rooms[0], QUIET, None, rooms[1:])
    store, both = MemoryStore(camera.exposures), [PROJECTOR] * 2
    done = acquire_pictures(camera, store, 17, both, LINEAR)
    assert [each.pictures for each in done] == [9, 8]
    for projector, each in enumerate(done):
        T = each.measured.transport
        assert T.shape == (2 * CAMERA[0] * CAMERA[1], PROJECTOR[0] * PROJECTOR[1])
        for number in range(2):
            rows = np.arange(CAMERA[0] * CAMERA[1]) + number * CAMERA[0] * CAMERA[1]
            found, meant = T.at(rows), truth[number][projector]
            if not meant.near.indices.size:
                assert not found.near.indices.size
            else:
                alone = acquired(room_of(meant), 9, QUIET).measured.transport
                assert error(found, alone) < 0.002  # exposures are rounded differently
                assert error(found, meant) < 0.08  # nine pictures, none of them random
    # of 20 pictures, 19 are used, because only whole rounds count
    again = acquire_pictures(camera, store, 20, both, LINEAR)
    assert [(each.pictures, each.resumed) for each in again] == [(10, 9), (9, 8)]


def two_lit(transport: Transport) -> SimulatedRoom:
    ambient = np.full((*CAMERA, 3), AMBIENT, np.float32)
    _, regions = side_by_side([PROJECTOR] * 2)
    response = RasterResponse((LINEAR, LINEAR), regions, (None, None))
    return SimulatedRoom("test", transport, ambient, (PROJECTOR, PROJECTOR), response)
