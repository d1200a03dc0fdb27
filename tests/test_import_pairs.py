"""counterlight import-pairs: rooms from pictures and photographs, by construction, and refusals in one line."""

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from counterlight import calibration
from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.files.picture_files import read_picture
from counterlight.tools import build_correction_map
from counterlight.tools.import_pairs import main
from counterlight.tools.pairs.fitting import Border, Fitted, agreement, capture_gains, fit_pairs
from counterlight.tools.pairs.geometry import regression
from counterlight.tools.pairs.matching import matched
from counterlight.tools.pairs.model import CELLS, WIDE_HALO, Level, Model, fit
from counterlight.tools.pairs.photographs import read_photograph, read_photographs
from counterlight.tools.pairs.processing import OTHER, OWN, Processing, fit_processing
from counterlight.tools.pairs.room import ambient_of, transport_of
from counterlight.tools.transport.interval import read_interval
from counterlight.tools.transport.storage import read_transport
from tests.pairs_of_rooms import AMBIENT, CAMERA, GAMMA, PROJECTOR, Wall, natural_pictures, write, write_pairs
from tests.programs import refusal_here
from tests.real.measures import srgb

INNER = np.s_[16:80, 20:104]  # camera pixels inside the projector's picture


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    rng = np.random.default_rng(3)
    pictures = natural_pictures(rng, 16)
    wall = Wall(halo=0.1)
    captures = np.stack([wall.capture(each, rng) for each in pictures]) / np.float32(65535)
    return fit_pairs(pictures, captures, additive=True)


def refusal(capsys: pytest.CaptureFixture[str], pictures: Path, photographs: Path, *words: str) -> str:
    """Returns the only line of a refused import; checks that it leaves no files."""
    folder = pictures.parent
    return refusal_here(main, capsys, folder, pictures, photographs, *words, "-o", folder / "room")


def test_places_are_found(fitted: Fitted) -> None:
    error = np.linalg.norm(fitted.places.places[1] - Wall().places, axis=-1)[INNER]
    assert np.median(error) < 0.15  # in projector pixels; the captures have noise of 0.2 % of white
    assert np.percentile(error, 95) < 0.5


def test_the_response_is_found(fitted: Fitted) -> None:
    codes = np.repeat(np.linspace(0, 1, 18)[:, None], 3, axis=1)
    # φ has 17 levels, fitted to 16 pictures
    np.testing.assert_allclose(fitted.processing.light(codes), codes**GAMMA, atol=0.03)


def test_the_halo_is_separated_from_the_response() -> None:
    """A halo lifts dark parts next to bright parts, which a response alone would explain as light of dark codes."""
    rng = np.random.default_rng(4)
    pictures = natural_pictures(rng, 12)
    captures = np.stack([Wall(halo=0.5).capture(each, rng) for each in pictures]) / np.float32(65535)
    found = fit_pairs(pictures, captures, additive=True)
    codes = np.repeat(np.linspace(0, 1, 18)[:, None], 3, axis=1)
    error = found.processing.light(codes) - codes**GAMMA
    # as a share of white: 0.037 here, and 0.048 if the response explains the halo
    assert np.sqrt(np.mean(error**2)) < 0.042


def test_the_halo_is_what_blurs_add(rng: np.random.Generator) -> None:
    shown = rng.uniform(0, 1, (2, 30, 41, 3)).astype(np.float32)
    level = Level.empty(12, shown.shape[1:3])
    level.coefficients[..., WIDE_HALO - 1 :] = rng.uniform(0, 0.1, level.coefficients[..., WIDE_HALO - 1 :].shape)
    slope, offset = np.full((2, 30, 41, 3), 0.5, np.float32)
    model = Model(slope, offset, (level,))
    added = model.predict(shown) - (slope * shown + offset)
    assert added.min() > 0
    np.testing.assert_allclose(model.halo(shown), added, rtol=1e-4, atol=1e-6)  # rounding to float32


def test_colour_processing_is_found_without_the_offset_of_its_light(rng: np.random.Generator) -> None:
    """Each primary gives less light next to bright other primaries. Captures suggest light below 0 at black."""

    def light(codes: FloatArray) -> FloatArray:
        return np.asarray(codes**GAMMA * (1.2 - 0.1 * np.roll(codes, -1, axis=1) - 0.1 * np.roll(codes, 1, axis=1)))

    codes = rng.uniform(0, 1, (20_000, 3))
    found = fit_processing(codes, light(codes) - 0.12, np.ones_like(codes))
    np.testing.assert_allclose(found.light(np.array([[0.0] * 3, [1.0] * 3])), [[0] * 3, [1] * 3], atol=1e-6)
    np.testing.assert_allclose(found.light(codes), light(codes), atol=0.03)  # φ has 17 and 7 levels, and a smooth prior


def test_light_of_one_code_is_read_from_a_curve_as_from_the_table(rng: np.random.Generator) -> None:
    curves = np.sort(rng.uniform(0, 1, (3, OWN)))
    table = np.broadcast_to(curves[:, :, None, None], (3, OWN, OTHER, OTHER)).copy()
    codes = rng.integers(0, 256, (50, 3)) / 255
    found = Processing(table).light(codes)
    expected = [np.interp(codes[:, k], np.linspace(0, 1, OWN), curves[k]) for k in range(3)]
    np.testing.assert_allclose(found, np.stack(expected, axis=-1), atol=1e-7)  # rounding to float32
    table[0, 0, OTHER - 1, OTHER - 1] += 1e-9  # too little to see, but the light now depends on other codes
    np.testing.assert_array_equal(Processing(table).light(codes), found)


def test_a_picture_that_the_fit_did_not_see_is_predicted(fitted: Fitted) -> None:
    pictures = natural_pictures(np.random.default_rng(99), 4)
    true = np.stack([Wall(halo=0.1).light(each) for each in pictures])
    predicted = fitted.predict(pictures)
    error = np.sqrt(np.mean((predicted - true)[:, INNER[0], INNER[1]] ** 2))
    shown = fitted.shown(pictures)
    slope, offset, _ = regression(shown, true.astype(np.float32))
    assert error < 0.012  # as a share of white; places, response and spread come from 16 noisy captures
    assert error < 1.2 * np.sqrt(np.mean((slope * shown + offset - true)[:, INNER[0], INNER[1]] ** 2))


def test_a_pixel_whose_pictures_hardly_vary_takes_its_slope_from_its_neighbours(rng: np.random.Generator) -> None:
    shown = rng.uniform(0, 1, (6, 30, 41, 3)).astype(np.float32)
    shown[:, 12, 20] = 0.5 + rng.normal(0, 4e-3, (6, 3))  # less than the noise of captures
    model = fit(shown, 0.6 * shown + rng.normal(0, 0.01, shown.shape).astype(np.float32), cells=CELLS[:1], linear=True)
    # the noise of neighbours; regression alone is off by up to 3
    np.testing.assert_allclose(model.slope[12, 20], 0.6, atol=0.03)


def test_light_next_to_the_picture_falls_with_the_picture(fitted: Fitted) -> None:
    """The pairs have no black picture, so that the wall's darkness without light follows only from the halo."""
    black = np.zeros((1, *PROJECTOR, 3), np.uint8)
    error = (fitted.predict(black)[0] - Wall(halo=0.1).light(black[0]))[~fitted.lit]
    assert np.sqrt(np.mean(error**2)) < 0.003  # as a share of white: 0.0016 here, and 0.008 without a free offset


def test_the_transport_predicts_what_the_fit_predicts(fitted: Fitted) -> None:
    """T p + e differs from the model only where faint or negative entries of T were dropped."""
    picture = natural_pictures(np.random.default_rng(7), 1)
    light = fitted.processing.light(picture[0] / 255).reshape(-1, 3)
    T = transport_of(fitted, PROJECTOR)
    assert T.far is not None
    found = (T @ light).reshape(*CAMERA, 3) + ambient_of(fitted)
    error = (found - fitted.predict(picture)[0])[INNER]
    assert np.sqrt(np.mean(error**2)) < 0.01  # as a share of white; dropped entries are below 2 % of the largest one


def test_content_identifies_the_pairs() -> None:
    rng = np.random.default_rng(5)
    pictures = natural_pictures(rng, 14)
    order = rng.permutation(14)[:11]
    captures = [Wall().capture(pictures[number], rng) / 65535 for number in order]
    found = matched(pictures / 255.0, [capture ** (1 / GAMMA) for capture in captures])
    assert found is not None
    np.testing.assert_array_equal(found, order)


def test_the_command_makes_a_room_that_build_accepts(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures, photographs = write_pairs(tmp_path, Wall(), rng)
    room = tmp_path / "room"
    words = [str(pictures), str(photographs), "-o", str(room), "--quality", str(tmp_path / "quality.png")]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert re.search(
        r"16 pairs matched by number; a fit without 2 of them predicts their captures to \d+\.\d dB,", printed
    )
    first, *_, last = printed.splitlines()
    said = re.fullmatch(
        r"captures match the prediction to (\d+\.\d) dB \((\w+ errors)\)", last.split(";")[0].split(" s, ")[1]
    )
    assert said
    assert (
        f": expected on the wall: {said[2]}. A capture matches its prediction to about {said[1]} dB, and 9 of 10 camera"
        in first
    )
    assert last.endswith(f"next: counterlight build {room}")
    assert read_picture(tmp_path / "quality.png").shape == (CAMERA[0], 3 * CAMERA[1], 3)
    stored = calibration.read(room)
    assert (stored.calibration.projector.shape, stored.calibration.camera.shape) == (PROJECTOR, CAMERA)
    # the ambient light is extrapolated to black
    assert np.percentile(np.abs(stored.calibration.ambient[INNER] - AMBIENT), 99) < 0.03
    white = read_transport(stored).composition().reshape(*CAMERA, 3)[INNER]
    np.testing.assert_allclose(np.median(white / (0.9 * Wall().albedo[INNER])), 1, atol=0.05)
    inside, interval, T = [], read_interval(stored), read_transport(stored)
    assert interval is not None
    for codes in natural_pictures(rng, 12):
        drive = stored.calibration.response.to_linear(codes).reshape(-1, 3)
        predicted = (T @ drive).reshape(*CAMERA, 3) + stored.calibration.ambient
        inside.append(interval.inside(predicted, Wall().capture(codes, rng) / 65535)[stored.calibration.mask].mean())
    assert np.mean(inside) == pytest.approx(0.92, abs=0.04)  # fits of 12 pairs predict worse than the room of 16
    assert build_correction_map.main([str(room), "--inverse", "none"]) == 0


def test_a_room_from_8_bit_jpeg_with_a_black_photograph_and_a_smaller_camera(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """8-bit photographs are sRGB. Read as linear, they would show twice the light or more."""
    pictures, photographs = write_pairs(tmp_path, Wall(), rng, 12)
    black = tmp_path / "black.jpg"
    write(photographs / "black.png", Wall().capture(np.zeros((*PROJECTOR, 3), np.uint8), rng))
    for path in sorted(photographs.iterdir()):
        codes = np.rint(255 * srgb(read_picture(path) / 65535)).astype(np.uint8)
        path.unlink()
        Image.fromarray(codes).save(black if path.stem == "black" else path.with_suffix(".jpg"), quality=95)
    words = [str(pictures), str(photographs), "-o", str(tmp_path / "room"), "--camera", "96x72", "--black", str(black)]
    assert main(words) == 0
    found = re.search(r"predicts their captures to (\d+\.\d) dB", capsys.readouterr().out)
    assert found is not None
    assert float(found[1]) > 28  # measured: 29.9, by a fit of 11 pairs with subsampled colour
    stored = calibration.read(tmp_path / "room").calibration
    assert stored.camera.shape == (72, 96)
    assert np.percentile(np.abs(stored.ambient - AMBIENT), 99) < 0.006  # codes of 8 bits are 0.0008 apart; JPEG
    white = cv2.resize(0.9 * Wall().albedo, (96, 72), interpolation=cv2.INTER_AREA)[12:60, 15:78]
    T = read_transport(calibration.read(tmp_path / "room")).composition().reshape(72, 96, 3)[12:60, 15:78]
    # T is extrapolated to white; photographs read as linear would give 1.3 or more
    assert np.median(T / white) == pytest.approx(1, abs=0.12)


def test_a_pair_that_does_not_belong_is_named_and_left_out(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures, photographs = write_pairs(tmp_path, Wall(), rng, 10)
    write(photographs / "IMG_006.png", Wall().capture(natural_pictures(rng, 1)[0], rng))
    assert main([str(pictures), str(photographs), "--camera", "64x48", "-o", str(tmp_path / "room")]) == 0
    printed = capsys.readouterr().out
    assert "left out: frame006.png with IMG_006.png, which do not belong together" in printed
    assert printed.count("left out") == 1


def test_too_few_pairs_are_refused(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures, photographs = write_pairs(tmp_path, Wall(), rng, 7)
    assert "7 pairs, expected at least 8" in refusal(capsys, pictures, photographs)
    heif = tmp_path / "heif"
    heif.mkdir()
    (heif / "IMG_1.HEIC").touch()
    complaint = "IMG_1.HEIC: HEIC pictures are not read; convert it, for example: heif-convert IMG_1.HEIC IMG_1.png"
    assert complaint in refusal(capsys, pictures, heif)


def test_photographs_of_other_pictures_are_refused(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures, photographs = write_pairs(tmp_path, Wall(), rng, 10)
    for number, codes in enumerate(natural_pictures(rng, 10)):
        write(photographs / f"IMG_{number:03}.png", Wall().capture(codes, rng))
    assert "do not show these pictures" in refusal(capsys, pictures, photographs)


def test_pictures_that_are_all_alike_are_refused(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures, photographs = write_pairs(tmp_path, Wall(), rng, 9)
    for number in range(1, 9):
        shutil.copy(pictures / "frame000.png", pictures / f"frame{number:03}.png")
        shutil.copy(photographs / "IMG_000.png", photographs / f"IMG_{number:03}.png")
    assert "all alike" in refusal(capsys, pictures, photographs)


def test_saturated_photographs_are_refused(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures, photographs = write_pairs(tmp_path, Wall(), rng, 9)
    for path in photographs.iterdir():
        bright = np.minimum(read_picture(path).astype(np.float64) * 8, 65535).astype(np.uint16)
        write(path, bright)
    assert "saturated" in refusal(capsys, pictures, photographs)


def test_a_camera_that_moved_is_refused(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures, photographs = write_pairs(tmp_path, Wall(), rng, 16)
    for number in range(11, 16):
        codes = read_picture(pictures / f"frame{number:03}.png")
        write(photographs / f"IMG_{number:03}.png", Wall(shift=(4.0, 2.0)).capture(codes, rng))
    line = refusal(capsys, pictures, photographs, "--camera", "64x48")
    assert "IMG_011.png: shifted by" in line
    assert "camera moved" in line


def test_a_list_of_pairs_is_read_and_checked(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures, photographs = write_pairs(tmp_path, Wall(), rng, 8)
    listed = tmp_path / "pairs.txt"
    listed.write_text("frame000.png, IMG_000.png\nframe001.png\n")
    assert "line 2 has 1 names" in refusal(capsys, pictures, photographs, "--pairs", str(listed))
    listed.write_text("frame000.png, IMG_100.png\n")
    assert "IMG_100.png, which does not exist" in refusal(capsys, pictures, photographs, "--pairs", str(listed))
    listed.write_text("frame000.png, IMG_000.png\nframe001.png, IMG_000.png\n", "utf-8-sig")
    assert "line 2 names IMG_000.png again" in refusal(capsys, pictures, photographs, "--pairs", str(listed))


def test_the_border_tells_the_gain_of_a_capture(rng: np.random.Generator) -> None:
    """The border's own wander has a third of the gains' deviation, and its light is 20 % above the prediction."""
    lit = np.zeros((40, 60), bool)
    lit[10:30, 10:50] = True
    predicted = np.where(lit[..., None], 0.4, 0.05) * rng.uniform(0.5, 1.5, (24, 1, 1, 1)) * np.ones((24, 40, 60, 3))
    gains = np.exp(rng.normal(0, 0.03, (24, 3)))
    wander = np.where(lit[..., None], 1, np.exp(rng.normal(0, 0.01, (24, 1, 1, 3))))
    captures = predicted * gains[:, None, None] * wander * np.where(lit[..., None], 1, 1.2)
    border = Border.fit(predicted[:16], captures[:16], gains[:16], lit)
    found = border.gains(predicted[16:], captures[16:])
    assert 0.8 < border.share < 1
    np.testing.assert_allclose(border.usual, 1.2, rtol=0.03)
    error = np.log(found) - np.log(gains[16:] / np.exp(np.log(gains[:16]).mean(axis=0)))
    assert error.std() < 0.5 * np.log(gains[16:]).std()  # a third is expected


def test_a_border_without_relation_to_the_gain_is_not_used(rng: np.random.Generator) -> None:
    lit = np.zeros((40, 60), bool)
    lit[10:30, 10:50] = True
    predicted = np.full((16, 40, 60, 3), 0.3)
    gains = np.tile(np.where(np.arange(16) % 2, 1.03, 1 / 1.03)[:, None], 3)
    border = np.where(np.arange(16) // 2 % 2, 1.03, 1 / 1.03)[:, None, None, None]
    captures = predicted * np.where(lit[..., None], gains[:, None, None], border)
    assert Border.fit(predicted, captures, gains, lit).share == pytest.approx(0, abs=1e-9)
    everywhere = Border.fit(predicted, captures, gains, np.ones((40, 60), bool))
    np.testing.assert_array_equal(everywhere.gains(predicted, captures), np.ones((16, 3)))


@pytest.mark.filterwarnings("error")
def test_gains_come_from_pixels_that_are_bright_and_not_saturated() -> None:
    expected = np.tile(np.linspace(0.1, 0.8, 4000).reshape(40, 100, 1), (4, 1, 1, 3))
    captures = 1.2 * expected
    captures[1] = np.where(expected[1] > 0.4, 1, captures[1])  # the brighter half is saturated
    expected[2] = captures[2] = 0.001  # an entirely black pair
    gains = capture_gains(expected, captures, np.ones((40, 100), bool))
    np.testing.assert_allclose(gains[:, 0], [1.2, 1, 1, 1.2])


def test_saturated_captures_stay_saturated_at_another_gain(rng: np.random.Generator) -> None:
    shown = rng.uniform(0, 1, (20, 12, 12, 3)).astype(np.float32)
    captures = np.minimum(1.4 * shown, 1)
    gains = np.full((20, 3), 1.1)
    clipped = captures >= 0.98
    changed = np.where(clipped, 1.0, captures).astype(np.float32)
    model = fit(shown, changed, gains=gains, linear=True)
    unsaturated = np.abs(model.predict(shown) - captures / 1.1)[~clipped]
    wrong = np.abs(fit(shown, changed / np.float32(1.1), linear=True).predict(shown) - captures / 1.1)[~clipped]
    assert unsaturated.mean() < 0.7 * wrong.mean()


def test_a_reduced_pixel_is_saturated_where_any_site_is(tmp_path: Path) -> None:
    picture = np.full((64, 64, 3), 20000, np.uint16)
    picture[0, 0] = 65535
    write(tmp_path / "a.png", picture)
    found = read_photographs([tmp_path / "a.png"], None, (32, 32))[0]
    assert (found[0, 0] == 1).all()
    assert (found[1:] < 0.4).all()


def test_a_shift_of_a_small_lit_region_is_unclear() -> None:
    lit = np.zeros((40, 40), bool)
    lit[5:15, 5:15] = True
    both = np.random.default_rng(1).uniform(0, 1, (3, 40, 40, 3)).astype(np.float32)
    assert (agreement(both, both, lit).shift == 0).all()


def test_the_black_photograph_and_the_quality_picture_are_checked_first(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures, photographs = write_pairs(tmp_path, Wall(), rng, 8)
    black = tmp_path / "black.png"
    write(black, np.zeros((10, 12, 3), np.uint16))
    assert "black.png: 12x10, but IMG_000.png is" in refusal(capsys, pictures, photographs, "--black", str(black))
    inside = tmp_path / "room" / "quality.png"
    assert refusal(capsys, pictures, photographs, "--quality", str(inside))


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_tiff_of_16_bits_is_read_as_png_is(tmp_path: Path, rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    picture = rng.integers(0, 65536, shape, np.uint16)
    for suffix in ("png", "tiff"):
        assert cv2.imwrite(str(tmp_path / f"picture.{suffix}"), picture)
    read = [read_photograph(tmp_path / f"picture.{suffix}") for suffix in ("png", "tiff")]
    np.testing.assert_array_equal(*read)
    (tmp_path / "cut.tiff").write_bytes((tmp_path / "picture.tiff").read_bytes()[:60])
    with pytest.raises(InputError, match="cannot be read as TIFF"):
        read_photograph(tmp_path / "cut.tiff")
