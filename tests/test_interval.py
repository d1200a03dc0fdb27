"""Prediction intervals: on noise of known size, and stored with a room."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import app, calibration
from counterlight.calibration import INTERVAL
from counterlight.errors import InputError
from counterlight.pipeline.room import read_room
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.transport.interval import (
    Expected,
    Interval,
    coverage,
    expected_quality,
    fit_interval,
    read_interval,
    write_interval,
)
from tests.mutants import READ, REFUSED, DamagedRoom, mutant, outcome
from tests.rooms import write_one_to_one_room

SHAPE = (51, 67)  # not a multiple of a cell
COUNTED = np.zeros(SHAPE, bool)
COUNTED[3:45, 5:60] = True


def noise(light: np.ndarray) -> np.ndarray:
    """Return the deviation of known noise: it grows with the light, and is three times as large on the right."""
    rough = np.where(np.arange(SHAPE[1]) < 32, 1.0, 3.0)[:, None]
    return np.asarray(np.sqrt(1e-5 + 4e-4 * light) * rough)


def captures(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return predictions and captures with noise of Laplace's distribution, whose tails a normal interval misses."""
    light = rng.uniform(0, 1, (count, *SHAPE, 3)) ** 2 * rng.uniform(0.3, 1, (count, 1, 1, 3))
    return light, light + rng.laplace(0, noise(light) / np.sqrt(2))


def test_nine_of_ten_values_of_new_captures_are_inside_in_every_part(rng: np.random.Generator) -> None:
    interval = fit_interval(*captures(rng, 24), COUNTED)
    predicted, captured = captures(rng, 24)
    widths = np.stack([interval.half_width(each) for each in predicted])
    found = coverage(widths, predicted, captured, COUNTED)
    # error of a share over 166 000 values, with q and m from 24 captures
    assert found.share == pytest.approx(0.9, abs=0.006)
    np.testing.assert_allclose(found.thirds, 0.9, atol=0.015)
    inside = np.abs(captured - predicted) <= widths
    sides = [inside[:, 3:45, columns].mean() for columns in (slice(5, 24), slice(40, 60))]
    np.testing.assert_allclose(sides, 0.9, atol=0.05)  # m is averaged with 4 usual captures; 0.98 and 0.8 without m


def test_the_width_is_the_quantile_of_the_noise(rng: np.random.Generator) -> None:
    """Of Laplace's distribution, nine of ten values are within ln 10 / √2 deviations."""
    interval = fit_interval(*captures(rng, 64), COUNTED)  # m is averaged with 4 captures of 5 times the least m
    light = rng.uniform(0, 1, (*SHAPE, 3)) ** 2
    ratio = interval.half_width(light) / (noise(light) * np.log(10) / np.sqrt(2))
    away = COUNTED & (np.abs(np.arange(SHAPE[1]) - 32) > 8)  # m is interpolated between cells
    assert np.median(ratio[away]) == pytest.approx(1, abs=0.06)
    np.testing.assert_allclose(np.percentile(ratio[away], [5, 95]), 1, atol=0.2)  # without m, the ratio is 0.55 to 1.7


def test_an_interval_is_narrower_than_one_width(rng: np.random.Generator) -> None:
    predicted, captured = captures(rng, 16)
    interval = fit_interval(predicted, captured, COUNTED)
    widths = np.stack([interval.half_width(each) for each in predicted])
    found, error = coverage(widths, predicted, captured, COUNTED), np.abs(captured - predicted)[:, COUNTED]
    assert np.mean(error <= found.constant / 2) == pytest.approx(found.share, abs=1e-4)
    assert found.width == pytest.approx(2 * widths[:, COUNTED].mean())
    assert found.width < 0.95 * found.constant


def test_errors_of_whole_captures_count_as_captures(rng: np.random.Generator) -> None:
    """A gain per capture is alike in all its pixels; new captures are covered on average nevertheless."""

    def unsteady(count: int) -> tuple[np.ndarray, np.ndarray]:
        predicted, captured = captures(rng, count)
        return predicted, captured * np.exp(rng.normal(0, 0.05, (count, 1, 1, 3)))

    interval = fit_interval(*unsteady(60), COUNTED)
    inside = [interval.inside(p, c)[COUNTED].mean() for p, c in zip(*unsteady(60), strict=True)]
    assert np.mean(inside) == pytest.approx(0.9, abs=0.03)  # the gain of a capture has a deviation of 0.1
    assert np.min(inside) < 0.85


def test_every_third_of_a_black_picture_has_values() -> None:
    black = np.zeros((1, *SHAPE, 3))
    found = coverage(np.full_like(black, 0.1), black, black + 0.01, COUNTED)
    assert found.thirds == (1.0, 1.0, 1.0)


def test_gains_that_the_held_back_captures_do_not_have_are_added(rng: np.random.Generator) -> None:
    """Held-back captures are divided by their gains; new captures are not, and their errors grow with the light."""
    gains = np.array([0.06, 0.05, 0.08])
    interval = fit_interval(*captures(rng, 24), COUNTED, gains)
    predicted, captured = captures(rng, 60)
    captured = captured * (1 + gains * rng.normal(size=(60, 1, 1, 3)))
    widths = np.stack([interval.half_width(each) for each in predicted])
    found = coverage(widths, predicted, captured, COUNTED)
    # the gain of a capture has a deviation of 0.1
    np.testing.assert_allclose([found.share, *found.thirds], 0.9, atol=0.035)
    steady = np.stack([fit_interval(*captures(rng, 24), COUNTED).half_width(each) for each in predicted[:9]])
    assert coverage(steady, predicted[:9], captured[:9], COUNTED).thirds[2] < 0.8


@pytest.mark.filterwarnings("error")
def test_captures_without_error_have_an_interval_of_almost_no_width(rng: np.random.Generator) -> None:
    light = captures(rng, 8)[0]
    interval = fit_interval(light, light, COUNTED)
    assert interval.inside(light[0], light[0]).all()
    assert interval.half_width(light[0]).max() < 1e-3


def test_the_expected_quality_leaves_out_the_cameras_noise(rng: np.random.Generator) -> None:
    """Errors of 1 % of white and a camera's noise of twice as much: 40 dB, and 33 dB with the noise."""
    light = rng.uniform(0.2, 1, (6, *SHAPE, 3)) * 3
    captured = light + 0.03 * rng.normal(size=light.shape) + 0.06 * rng.normal(size=light.shape)
    interval = fit_interval(light, captured, COUNTED)
    found = [expected_quality(interval, light, captured, COUNTED, 3.0, noise) for noise in (0.0, 0.8)]
    assert [each.decibels for each in found] == pytest.approx([33.01, 40], abs=0.05)
    assert [Expected(decibels, 0).words for decibels in (40, 39.9, 27.9)] == [
        "hardly visible errors",
        "small errors",
        "clear errors",
    ]
    # quantiles of a Gaussian
    np.testing.assert_allclose([each.within for each in found], 1.645 * np.sqrt(5) * 0.01, rtol=0.02)


def test_an_interval_is_stored_with_a_room_and_damage_is_refused(rng: np.random.Generator, tmp_path: Path) -> None:
    plain, folder = tmp_path / "plain", tmp_path / "room"
    write_one_to_one_room(plain, SHAPE)
    assert read_interval(calibration.read(plain)) is None
    interval = fit_interval(*captures(rng, 8), COUNTED, np.array([0.01, 0, 0.02]))
    with calibration.writing(folder, calibration.read(plain).calibration) as stage:
        write_interval(interval, stage)
    found = read_interval(calibration.read(folder))
    assert found is not None
    np.testing.assert_array_equal(found.growth, interval.growth)
    np.testing.assert_array_equal(found.local, interval.local)
    np.testing.assert_array_equal(found.gains, [0.01, 0, 0.02])
    damaged = DamagedRoom.of(folder)
    outcomes = set()
    for i in range(40):
        damaged.put(INTERVAL, mutant(damaged.files[INTERVAL], INTERVAL, np.random.default_rng([37, i])))
        outcomes.add(outcome(lambda: read_interval(calibration.read(folder))))
    assert outcomes <= {READ, REFUSED}
    wrong = {
        "expected 0 to": Interval(-interval.growth, interval.local),
        "nan to nan": Interval(interval.growth * np.nan, interval.local),
        "expected real numbers, 7x9x3": Interval(interval.growth, interval.local[:5]),
    }
    for complaint, other in wrong.items():
        write_interval(other, tmp_path)
        damaged.put(INTERVAL, (tmp_path / INTERVAL).read_bytes())
        with pytest.raises(InputError, match=rf"interval\.npz: not the prediction interval .*{complaint}"):
            read_interval(calibration.read(folder))


def test_the_view_error_of_a_built_room_says_how_far_pictures_arrive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, folder, shape = tmp_path / "plain", tmp_path / "room", (21, 30)
    write_one_to_one_room(plain, shape)
    growth, local = np.full((3, 2), (1e-4, 3e-4)), np.ones((3, 4, 3))
    room = calibration.read(plain).calibration
    ambient = 0.2
    with calibration.writing(folder, replace(room, ambient=np.full_like(room.ambient, ambient))) as stage:
        for path in plain.glob("transport_*.npz"):
            shutil.copy(path, stage)
        write_interval(Interval(growth, local), stage)
    cv2.imwrite(str(tmp_path / "picture.png"), np.full((*shape, 3), 128, np.uint8))
    for each in (plain, folder):
        build_room_maps(calibration.read(each), InverseOptions(), refine=False)
    assert read_room(plain, None).expected is None
    words = [str(folder), str(tmp_path / "picture.png"), "--no-config", "--view", "error"]
    assert app.main([*words, "--output", str(tmp_path / "error.png")]) == 0
    said = capsys.readouterr().out
    white = float(re.findall(r"white is a camera radiance of (\S+)", said)[-1])
    black, bright = re.findall(r"9 of 10 pixels arrive within (\S+) % \(black\) to (\S+) % \(white\)", said)[0]
    assert float(black) == pytest.approx(100 * np.sqrt(1e-4 + 3e-4 * ambient) / white, rel=0.02)
    assert float(bright) == pytest.approx(100 * np.sqrt(1e-4 + 3e-4 * white) / white, rel=0.02)
    manifest = folder / "correction" / "manifest.toml"
    manifest.write_text(re.sub(r"(\[interval\]\nblack = ).*", r"\1-1", manifest.read_text()))
    with pytest.raises(InputError, match=r"manifest.toml: \[interval\].*black.*rebuild"):
        read_room(folder, None)
