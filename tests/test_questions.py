"""The study's questions about a room: coarser devices recomputed, answers with known ends, verdicts of made-up rows."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from counterlight import calibration
from counterlight.tools.acquire_transport import _choose_scheme as choose_scheme
from counterlight.tools.acquire_transport import _parser as acquire_parser
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme, Threshold
from counterlight.tools.joining.cameras import CameraOptions, joined_cameras
from counterlight.tools.joining.projectors import joined
from counterlight.tools.study.pictures import find_pictures
from counterlight.tools.study.questions import acquiring, coarser, colours, drifting, figures, moving
from counterlight.tools.study.questions.answers import Answer, cheapest, sentence
from counterlight.tools.study.questions.page import headed
from counterlight.tools.study.questions.place import (
    MOST_PIXELS,
    Blocks,
    Place,
    below_each_other,
    coarse,
    made_coarser,
    next_to_each_other,
)
from counterlight.tools.study.questions.room_answers import RoomAnswers, Tried, answered, tried
from counterlight.tools.study.results import Row
from counterlight.tools.transport.objective import DEFAULT_AIMS
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import Transport
from tests.rooms import write_blurred_room

CAMERA, PROJECTOR, CELLS = (19, 22), (17, 19), 4
ROW = Row("a", "p", "f", "", None, "", 0.1, 20.0, 0.9, 1.0, 0.0, 1.0, None, None, 1.0, None, 1.0, 1.0)


def blurred_place(folder: Path, camera: tuple[int, int], projector: tuple[int, int], cells: int) -> Place:
    write_blurred_room(folder, np.random.default_rng(5), camera, projector, cells)
    stored = calibration.read(folder)
    return Place(stored.calibration, read_transport(stored), find_pictures(["photograph", "text"]))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Return a wall slightly out of focus, with far light."""
    return blurred_place(tmp_path_factory.mktemp("questions") / "blurred", CAMERA, PROJECTOR, CELLS)


def test_blocks_take_what_is_left_over_and_keep_light_and_means(rng: np.random.Generator) -> None:
    blocks = Blocks(((7, 5),), 3)
    assert blocks.coarse == (2, 1)
    np.testing.assert_array_equal(np.bincount(blocks.of_pixel), [15, 20])
    picture = rng.random((7, 5, 3))
    means = blocks.mean(picture)
    np.testing.assert_allclose(means[0, 0], picture[:3].mean(axis=(0, 1)), rtol=1e-6)  # weights are float32
    assert blocks.spread(means.reshape(-1, 3)).shape == (35, 3)


def test_each_device_has_blocks_of_its_own(rng: np.random.Generator) -> None:
    beside, under = (Blocks(((7, 5), (4, 6)), 3, layout) for layout in (next_to_each_other, below_each_other))
    assert (beside.coarse, under.coarse) == ((2, 3), (3, 2))
    for blocks, second, nowhere in (
        (beside, np.s_[:4, 5:], np.s_[4:, 5:]),
        (under, np.s_[7:, :], np.s_[:7, 5:]),
    ):
        raster = blocks.layout(blocks.shapes).shape
        of_pixel = blocks.of_pixel.reshape(raster)
        assert set(of_pixel[second].ravel()).isdisjoint(of_pixel[:7, :5].ravel())
        assert set(of_pixel[nowhere].ravel()) == {-1}
        np.testing.assert_array_equal(np.bincount(of_pixel[second].ravel())[-1], 12)  # four rows of three
        picture = rng.random((*raster, 3))
        whole = blocks.spread(blocks.mean(picture).reshape(-1, 3)).reshape(picture.shape)
        assert np.all(whole[nowhere] == 0)
        np.testing.assert_allclose(whole[second].mean(axis=(0, 1)), picture[second].mean(axis=(0, 1)), rtol=1e-6)


@pytest.mark.parametrize("factor", range(2, 8))
def test_blocks_are_of_a_mask_if_all_their_pixels_are(factor: int) -> None:
    blocks, mask = Blocks(((35, 42),), factor), np.ones((35, 42), np.bool_)
    assert blocks.whole(mask).all()
    mask[0, 0] = False
    assert (~blocks.whole(mask)).sum() == 1
    assert not blocks.whole(mask)[0, 0]


def test_coarser_devices_see_means_and_light_all_that_they_stand_for(place: Place, rng: np.random.Generator) -> None:
    small, T = made_coarser(place.calibration, place.transport, 3, 2)
    seen, shown = Blocks((CAMERA,), 3), Blocks((PROJECTOR,), 2)
    assert (small.camera.shape, small.projector.shape) == (seen.coarse, shown.coarse)
    assert T.far is not None
    drive = rng.random((shown.coarse[0] * shown.coarse[1], 3))
    whole = place.transport.apply(shown.spread(drive)).reshape(*CAMERA, 3)
    # float32 sums of up to 36 entries, and their means
    np.testing.assert_allclose(T.apply(drive), seen.mean(whole).reshape(-1, 3), rtol=1e-5)


def test_a_large_room_is_asked_as_a_small_one(place: Place) -> None:
    room = place.calibration
    wide = replace(room.camera, height=2 * 120, width=2 * 160)
    assert wide.pixels > MOST_PIXELS
    huge = np.zeros((240, 320, 3), np.float32)
    many = replace(room, camera=wide, ambient=huge, mask=np.ones((240, 320), np.bool_), primaries=None)
    dark = Transport.from_matrices((sparse.csr_array((wide.pixels, room.projector.pixels), dtype=np.float32),) * 3)
    found = coarse(Place(many, dark, place.pictures))
    assert (found.factor, found.calibration.camera.shape, found.transport.camera) == (2, (120, 160), (120, 160))


def test_the_whole_room_loses_nothing_and_less_of_it_more(place: Place) -> None:
    answers = {answer.setting: answer for answer in coarser.sizes(place).answers}
    assert answers["camera whole, projector whole"].below < 0.02  # the cost of priors
    assert answers["camera whole, projector half"].below > 0.1
    assert "camera whole, projector a quarter" not in answers  # fewer than 8 pixels would be left


def test_what_has_not_moved_costs_nothing_and_a_pixel_is_a_pixel(place: Place) -> None:
    question = drifting.drift(place)
    usual = {
        answer.cost: answer.below for answer in question.answers if answer.series == f"--drift {DEFAULT_AIMS.drift:g}"
    }
    assert usual[0.0] == pytest.approx(0, abs=0.02)  # the cost of priors; both are solved to 0.004 dB
    assert sorted(usual.values()) == list(usual.values())
    ready = {answer.cost: answer.below for answer in question.answers if answer.series == "--drift 0.5"}
    assert ready[0.0] > usual[0.0]
    drive = np.zeros((*PROJECTOR, 3))
    drive[4, 5] = 1
    moved = drifting._moved(drive.reshape(-1, 3), place.calibration, np.sqrt(2.0)).reshape(drive.shape)
    np.testing.assert_allclose(moved[5, 6], 1, atol=1e-9)  # √2 on the diagonal is a pixel right and down


def test_frames_of_film_go_on_from_the_one_before(place: Place) -> None:
    question = moving.film(place)
    below = {(answer.series, answer.cost): answer.below for answer in question.answers}
    for begin in ("T⁺", "direct mapping"):
        for steps in moving.STEPS:  # carried momentum helps; where nothing is left to gain, it disappears in float32
            assert below[f"film, from {begin}", steps] <= below[f"stills, from {begin}", steps] + 0.005
        assert below[f"film, from {begin}", 1] < 0.9 * below[f"stills, from {begin}", 1]
        assert below[f"film, from {begin}", 16] < 0.03  # the cost of priors
    assert question.verdict.startswith("Within 0.1 dB of the best from T⁺, film after ")


def test_a_room_without_primaries_is_not_asked_for_colours(place: Place) -> None:
    assert place.calibration.primaries is None
    assert colours.colours(place) is None


def test_more_shots_come_closer_to_the_rooms_own_transport(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = blurred_place(tmp_path / "small", (12, 14), (10, 12), 0)
    named = {way.options: way for way in acquiring.WAYS}
    ways = [named[options] for options in ("--scheme graycode --shots 1", "--shots 1", "--shots 4")]
    monkeypatch.setattr(acquiring, "WAYS", ways)
    question = acquiring.pictures(place)
    gray, one, more = question.answers
    assert gray.below > one.below > more.below  # one place per pixel; noise of one shot; half of this noise
    assert more.below < 0.1
    assert (one.cost or 0) < (more.cost or 0)
    assert question.verdict.endswith("dB of what the true T gives.")


def test_more_pictures_first_come_closer_and_are_an_answer(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(acquiring, "WAYS", [way for way in acquiring.WAYS if way.make is None][:3])
    question = acquiring.pictures(place)
    assert [answer.cost for answer in question.answers] == [9, 16, 48]
    assert {answer.series for answer in question.answers} == {"pictures first"}
    nine, _, most = (answer.below for answer in question.answers)
    assert most < 0.2 < nine
    assert question.verdict == (
        "9 exposures (pictures first, 9) are within 1 dB; "
        "16 exposures (pictures first, 16) are within 0.1 dB of what the true T gives."
    )


@pytest.mark.parametrize("factor", [1, 2])
def test_projectors_are_acquired_one_by_one(tmp_path: Path, factor: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """If projectors were lit together, camera pixels would see two places at once, and codes would identify neither."""
    one, other = (blurred_place(tmp_path / name, (24, 28), (22, 25), 0) for name in ("one", "other"))
    both = joined([one.calibration, other.calibration], [one.transport, other.transport], ["one", "other"])
    place = Place(*made_coarser(*both, factor, factor), one.pictures, "independent")
    assert [each.shape for each in place.calibration.projectors] == [(22 // factor, 25 // factor)] * 2
    monkeypatch.setattr(acquiring, "WAYS", [acquiring.MULTIPLEXED, acquiring.WAYS[0]])
    question = acquiring.pictures(place)
    (multiplexed,) = question.answers
    assert multiplexed.below < 0.1
    assert "pictures first, 9: --pictures 9: projectors of" in question.how


def test_several_cameras_are_asked_as_one_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = (blurred_place(tmp_path / f"{width}", (24, width), (22, 25), 0) for width in (28, 30))
    shared = joined_cameras(
        [one.calibration, other.calibration], [one.transport, other.transport], "both", CameraOptions()
    )
    small = made_coarser(shared.calibration, shared.transport, 2, 1)
    assert small[0].cameras == ((12, 14), (12, 15))
    place = Place(shared.calibration, shared.transport, one.pictures, "independent")
    monkeypatch.setattr(acquiring, "WAYS", [acquiring.MULTIPLEXED])
    found = tried(place)
    assert min(place.reached) > 15
    by_title = {question.title: question for question in found.questions}
    assert by_title["Pictures of an acquisition"].answers[0].below < 0.1
    halves = {answer.setting: answer.below for answer in by_title["Pixels of camera and projector"].answers}
    assert 0 < halves["camera half, projector whole"] < 20


def test_each_way_of_acquiring_is_a_command() -> None:
    for way in acquiring.WAYS:
        options = acquire_parser().parse_args(["--camera", "simulated:x", "-o", "room", *way.options.split()])
        assert options.pictures == (way.pictures or None)
        if way.make is None:
            continue
        choose_scheme(options)
        made = way.make()
        assert options.scheme in ("hierarchical", "multiplexed", "graycode")
        assert options.shots == (None if way.averaged else way.shots)
        if isinstance(made, HierarchicalScheme):
            assert made == HierarchicalScheme(Threshold(float(options.threshold)))


def test_the_verdict_names_the_cheapest_that_is_good_enough() -> None:
    tried = [Answer("dear", 9.0, 0.01), Answer("good", 3.0, 0.09), Answer("poor", 1.0, 0.2), Answer("free", None, 0.0)]
    found = cheapest(tried, 0.1)
    assert found is not None
    assert found.setting == "good"
    assert cheapest(tried[:1], 0.001) is None
    rows = [
        replace(
            ROW, family="refined from direct", knob="steps", value=float(n), frame_ms=float(n), below_optimum_db=1 / n
        )
        for n in (1, 4, 16)
    ]
    question = figures.steps(rows)
    assert question.verdict == (
        "The fastest within 0.1 dB of the best: refined from direct, steps 16, 16 ms a frame, 0.06 dB below."
    )
    assert figures.steps(rows[:1]).verdict.startswith("No number of steps")
    assert sentence("a dB") == "A dB."


def test_the_verdict_is_of_the_room_at_its_own_size() -> None:
    """The best reachable figure comes from the methods' results in the full-size room, not from the small copy."""
    rows = [
        replace(ROW, family=family, picture=picture, psnr_db=db, below_optimum_db=best - db)
        for picture, best in (("photograph", 48.0), ("text", 34.7))
        for family, db in (("uncompensated", 5.0), ("direct", 30.0))
    ]
    assert answered("room", Tried((), "each of its pixels 11 a side of the room's own"), rows).verdict == (
        "The best that this room can show is 48.0 dB (photograph), 34.7 dB (text); an uncorrected picture is 36.35 dB "
        "below that, direct mapping is 11.35 dB below that."
    )


def test_the_page_begins_with_the_verdict() -> None:
    room = RoomAnswers("room", "It is good <enough>.", (figures.steps([]),), "camera 2x2")
    sections = headed([room], {"asked room": "asked_room.png"})
    assert [section.title.partition(": ")[2] for section in sections] == [
        "the verdict",
        "what costs, and what gives",
        "answers",
    ]
    assert "It is good &lt;enough&gt;." in sections[0].html()
    assert re.findall(r'src="([^"]+)"', sections[1].html()) == ["asked_room.png"]
