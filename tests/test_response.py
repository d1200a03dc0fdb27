"""Transfer curves: known values, inverses, and refusals."""

from collections.abc import Callable

import numpy as np
import pytest

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.files.tables import Table
from counterlight.passes.encode import encoded, reached
from counterlight.processing import LEVELS
from counterlight.raster import side_by_side
from counterlight.response import RasterResponse, Response, parse_response, read_response, transfer_table
from tests.oracles.encoding import encode
from tests.rooms import SEGMENT


@pytest.mark.parametrize("value", ["linear", "srgb", 0.6, 1.0, 1.8, 2.2, 2.4, "2.2", [[0.0], [0.1], [0.5], [1.0]]])
def test_encoding_then_the_response_gives_the_light_back(value: object) -> None:
    response = parse_response(value)
    light = np.linspace(0, 1, 4001)[None, :, None].repeat(3, axis=2)
    codes = encode(light, response.inverse_table()).astype(float) / 255
    neighbours = [response.to_linear(np.clip(codes + step / 255, 0, 1)) for step in (-0.51, 0.51)]
    # Half a code to either side of the nearest code brackets the light. 0.01 allows for interpolation in the table.
    assert np.all(neighbours[0] <= light + 1e-9)
    assert np.all(light <= neighbours[1] + 1e-9)


@pytest.mark.parametrize(
    "samples",
    [
        [[0, 0, 0], [0.4, 0.4, 0.4]],
        [[0, 0, 0], [0.02, 0.05, 0], [0.3, 0.2, 0.9]],
        [[0, 0, 0], [0.3, 0.3, 0.3], [0.3, 0.3, 0.3]],
    ],
)
def test_what_a_white_segment_adds_is_taken_out(rng: np.random.Generator, samples: list[list[float]]) -> None:
    """The test recomputes the projector's light p + s(min p)."""
    table = Table({"response": "linear", "white_segment": samples}, "here", "fix")
    response = read_response(table)
    levels = np.linspace(0, 1, len(samples))
    wanted = rng.uniform(size=(40, 30, 3)) ** np.array([1, 2, 3])
    codes = encoded(wanted, response.over((40, 30))) / 255
    darkest = codes.min(axis=2)
    shown = codes + np.stack([np.interp(darkest, levels, column) for column in np.transpose(samples)], axis=2)
    assert np.abs(shown - wanted).max() < 2.5 / 255  # half a code, and its effect on the segment
    np.testing.assert_allclose(response.to_linear(codes), shown, atol=1e-12)


@pytest.mark.parametrize(
    "samples",
    [
        5,
        [],
        [[0, 0, 0]],
        [[0, 0], [1, 1]],
        [[0.1, 0, 0], [1, 1, 1]],
        [[0, 0, 0], [0, float("nan"), 1]],
        [[0, 0, 0], [1, 1, 1], [0.2, 1, 1]],
        [[0, 0, 0], [99, 1, 1]],
        [[0, 0, 0], ["a", 1, 1]],
    ],
)
def test_a_white_segment_that_cannot_be_is_refused(samples: object) -> None:
    with pytest.raises(InputError, match=r"^here: white segment: expected"):
        read_response(Table({"white_segment": samples}, "here", "fix"))


def vivid(codes: FloatArray) -> FloatArray:
    """Return B of a projector whose saturated colours are brighter by up to a quarter, and 1 at white."""
    others = np.array([0.7, 0.4, 0.6]) * np.roll(codes, -1, axis=-1) + [0.3, 0.6, 0.4] * np.roll(codes, -2, axis=-1)
    return np.asarray(1 + [0.25, 0.2, 0.15] * (1 - others))


def test_colour_processing_is_undone(rng: np.random.Generator) -> None:
    """The test recomputes the projector's light r(c) B(c); B is linear in each code, as between the samples."""
    response = processed(vivid)
    wanted = rng.uniform(size=(40, 30, 3)) ** np.array([1, 2, 3])
    codes = encoded(wanted, response.over((40, 30))) / 255
    shown = codes**2.2 * vivid(codes)
    assert np.abs(shown - wanted).max() < 2.2 / 255  # half a code at gamma 2.2 is 1.1 codes of light
    np.testing.assert_allclose(response.to_linear(codes), shown, atol=1e-12)


def dull(codes: FloatArray) -> FloatArray:
    """Return B of a projector whose primaries alone give 70, 75 and 80 % of their share of white."""
    others = np.array([0.7, 0.4, 0.6]) * np.roll(codes, -1, axis=-1) + [0.3, 0.6, 0.4] * np.roll(codes, -2, axis=-1)
    return np.asarray(1 - [0.3, 0.25, 0.2] * (1 - others))


def processed(factor: Callable[[FloatArray], FloatArray]) -> Response:
    """Return a projector of gamma 2.2 with colour processing."""
    steps = np.linspace(0, 1, LEVELS)
    codes = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return read_response(Table({"response": 2.2, "processing": factor(codes).tolist()}, "here", "fix"))


def test_colours_that_no_codes_give_arrive_darker_and_all_others_as_wanted(rng: np.random.Generator) -> None:
    wanted = np.concatenate([np.eye(3), 1 - np.eye(3), np.ones((1, 3)), rng.uniform(0, 1, (100, 3)) ** 2])[None]
    shape = wanted.shape[:2]
    np.testing.assert_array_equal(reached(wanted, processed(vivid).over(shape)), wanted)
    np.testing.assert_array_equal(reached(wanted, Response("gamma", segment=SEGMENT).over(shape)), wanted)
    found = reached(wanted, processed(dull).over(shape))[0]
    np.testing.assert_allclose(found[:3], np.diag([0.7, 0.75, 0.8]), atol=1e-9)
    np.testing.assert_array_equal(found[6], 1)
    steps = np.linspace(0, 1, 33)
    codes = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    given, missed = codes**2.2 * dull(codes), np.any(found != wanted[0], axis=1)
    assert 10 < missed.sum() < 80
    for light in wanted[0, ~missed]:
        assert np.abs(given - light).max(axis=1).min() < 0.05  # a step of codes changes the light by up to 0.09
    assert np.all(encoded(wanted, processed(dull).over(shape))[0][found < wanted[0]] == 255)


@pytest.mark.parametrize(
    "samples", [5, [[1, 1, 1]], [[1, 1]] * LEVELS**3, [[1, 1, 0]] * LEVELS**3, [[1, 1, float("nan")]] * LEVELS**3]
)
def test_colour_processing_that_cannot_be_is_refused(samples: object) -> None:
    with pytest.raises(InputError, match=r"^here: processing: expected"):
        read_response(Table({"processing": samples}, "here", "fix"))


def test_a_projector_has_a_white_segment_or_colour_processing() -> None:
    both = {"white_segment": [[0, 0, 0], [1, 1, 1]], "processing": [[1, 1, 1]] * LEVELS**3}
    with pytest.raises(InputError, match="not both"):
        read_response(Table(both, "here", "fix"))


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("widest", [14, 9])  # in one row, or the last two below the first two
def test_a_raster_is_encoded_and_read_back_projector_by_projector(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, widest: int, mixed: bool
) -> None:
    monkeypatch.setattr("counterlight.raster.MAX_SIDE", widest)
    responses = tuple(parse_response(value) for value in ("srgb", 1.4, [[0, 0, 0], [0.2, 0.5, 0.7], [1, 1, 1]], "srgb"))
    turned = ((0.75, 0.25, 0.0), (0.0, 0.875, 0.125), (0.125, 0.125, 0.75))
    colours = (None, turned, None, turned) if mixed else ()
    shape, regions = side_by_side(((6, 3), (4, 5), (5, 2), (6, 4)))
    raster = RasterResponse(responses, regions, colours)
    drive = rng.uniform(size=(*shape, 3))
    codes = encoded(drive, raster)
    for number, (response, region) in enumerate(zip(responses, regions, strict=True)):
        own = region.part
        D = np.array(colours[number]) if mixed and number % 2 else np.eye(3)
        np.testing.assert_array_equal(codes[own], encode(drive[own] @ D.T, response.inverse_table()))
        found = raster.to_linear(codes)[own] @ D.T
        np.testing.assert_allclose(found, response.to_linear(codes[own] / 255), atol=1e-12)  # D and its inverse
    assert len(raster.inverse_tables()) == (4 if mixed else 3)  # the two equal devices share a table


def test_three_column_tables_act_per_channel() -> None:
    response = parse_response([[0, 0, 0], [0.25, 0.5, 0.75], [1, 1, 1]])
    np.testing.assert_allclose(response.to_linear(np.full((1, 3), 0.5))[0], [0.25, 0.5, 0.75])


def test_known_values_of_the_transfers() -> None:
    # light at code value 0.5, by formula
    middle = {"srgb": 0.21404, "bt1886": 0.18946, "gamma22": 0.21764, "linear": 0.5}
    for name, light in middle.items():
        table = transfer_table(name)
        # digits as printed
        assert np.interp(0.5, np.linspace(0, 1, table.size), table) == pytest.approx(light, abs=2e-5)
        assert table[0] == 0
        assert table[-1] == 1


@pytest.mark.parametrize(
    "value", ["rgb", 0.0, -1, 11, "x", None, [[0], [0.5], [0.5], [1]], [[0]], [[0.1], [1]], [[0, 0], [1]]]
)
def test_curves_that_cannot_be_inverted_are_refused(value: object) -> None:
    with pytest.raises(InputError, match="response"):
        parse_response(value)


def test_a_response_survives_its_toml() -> None:
    for value in ("linear", "srgb", 2.2, [[0.0], [0.3], [1.0]]):
        response = parse_response(value)
        assert parse_response(response.to_toml()) == response
