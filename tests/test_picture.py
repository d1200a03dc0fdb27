"""Viewer controls: mpv's by their formulas, adaptation and damping by closed forms, maps, test cards."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import PreparedRows, SparseRows, pack
from counterlight.media.video import Frame
from counterlight.passes.adaptation import SCALES, Limits, tile_grid
from counterlight.passes.colour import decoding_of
from counterlight.passes.shown_maps import ErrorMap
from counterlight.pipeline import views
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments, adjusted_decoding, adjusted_transfer
from counterlight.pipeline.content import SMOOTHING_S, Succession
from counterlight.pipeline.cpu_renderer import CpuCanvas, CpuRenderer
from counterlight.pipeline.room import Room
from counterlight.pipeline.test_cards import CARDS, card
from counterlight.pipeline.views import VIEWS
from counterlight.response import Response, transfer_table
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.report.impossible import REASONS, SERVED, find_impossible
from tests.oracles import encoding
from tests.oracles.adaptation import tone_of
from tests.refined_rooms import physical_room
from tests.rooms import CAMERA, rgb_frame, yuv_frame

Colour = tuple[int, int, int]
Formula = Callable[[np.ndarray, np.ndarray], np.ndarray]
TABLE = 2e-6  # linear interpolation in a transfer table of 1024 samples
GREY, COLOUR = (120, 120, 120), (200, 90, 40)


def diagonal_room(reach: float, ambient: float, white: float = 1.0, shape: tuple[int, int] = (24, 32)) -> Room:
    """Return a room with a diagonal T: full drive gives each camera pixel `reach` above the ambient light."""
    count = shape[0] * shape[1]
    device, light = Device(*shape, Response("srgb")), np.full((*shape, 3), ambient, np.float32)
    calibration = Calibration("diagonal", "made by a test", (device,), device, light, np.ones(shape, bool))
    rows = [
        pack(
            SparseRows(np.arange(count + 1), np.arange(count), np.ones((count, 3), np.float32) * w, count), shape, shape
        )
        for w in (1 / reach, reach)
    ]
    return Room(calibration, RoomMaps(rows[0], rows[1], None, None, white), white)


def even(colour: Colour, shape: tuple[int, int] = (24, 32)) -> Frame:
    return rgb_frame(np.full((*shape, 3), colour, np.uint8), "linear")


def opened(room: Room, frame: Frame, adjustments: Adjustments = NEUTRAL) -> CpuRenderer:
    renderer = CpuRenderer(room)
    renderer.open(frame.format)
    renderer.adjust(adjustments)
    renderer.upload(frame)
    return renderer


def asked(adjustments: Adjustments, colour: Colour) -> np.ndarray:
    """Return the target of an even picture with linear codes, in a room whose white is 1."""
    c = opened(diagonal_room(1.0, 0.0), even(colour), adjustments).desired()
    np.testing.assert_array_equal(c, np.broadcast_to(c[0, 0], c.shape))
    return np.asarray(c[0, 0], float)


# mpv's controls.


@pytest.mark.parametrize("colour", [GREY, COLOUR])
@pytest.mark.parametrize(
    ("adjustments", "formula"),
    [
        (Adjustments(brightness=10), lambda c, y: c + 0.1),
        (Adjustments(brightness=-100), lambda c, y: c - 1),
        (Adjustments(contrast=20), lambda c, y: 1.2 * c),
        (Adjustments(contrast=-100, brightness=30), lambda c, y: 0 * c + 0.3),
        (Adjustments(saturation=-100), lambda c, y: 0 * c + y),
        (Adjustments(saturation=20), lambda c, y: y + 1.2 * (c - y)),
        (Adjustments(gamma=50), lambda c, y: c ** (1 / np.sqrt(8))),
        (Adjustments(gamma=-100), lambda c, y: c**8),
        (Adjustments(20, -30, 25, -50), lambda c, y: (0.7 * (y + 0.5 * (c - y)) + 0.2) ** 8**-0.25),
    ],
)
def test_the_controls_mean_what_they_mean_in_mpv(adjustments: Adjustments, formula: Formula, colour: Colour) -> None:
    code = np.array(colour) / 255
    luma = code @ np.array([0.2126, 0.7152, 0.0722])
    expected = np.clip(formula(code, luma), 0, 1)
    np.testing.assert_allclose(asked(adjustments, colour), expected, atol=1e-5)  # rounding in the table of code^(1/γ)


def test_saturation_uses_the_luma_of_the_medium(rng: np.random.Generator) -> None:
    """At saturation −100, the picture equals the luma plane, for any colour matrix."""
    for matrix in ("bt601", "bt709", "bt2020"):
        frame = yuv_frame(rng, (24, 32), matrix=matrix, full_range=True, transfer="linear")
        room = diagonal_room(1.0, 0.0)
        c = opened(room, frame, Adjustments(saturation=-100)).desired()
        np.testing.assert_allclose(c, np.repeat(frame.planes[0][:24, :32, None] / 255, 3, axis=2), atol=TABLE)


def test_a_neutral_picture_changes_no_number(rng: np.random.Generator) -> None:
    for matrix in ("bt601", "bt709", "bt2020"):
        pixels = yuv_frame(rng, (9, 15), matrix=matrix).format
        decoding, lift = adjusted_decoding(decoding_of(pixels), pixels, NEUTRAL)
        assert decoding.to_rgb.tobytes() == decoding_of(pixels).to_rgb.tobytes()
        assert lift == 0
        table = transfer_table(pixels.transfer)
        assert adjusted_transfer(table, NEUTRAL) is table


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"brightness": 101}, "brightness: expected a whole number from -100 to 100, found 101"),
        ({"saturation": -101}, "saturation: .* found -101"),
        ({"black_level": 0.6}, "black-level: expected a number from 0 to 0.5, found 0.6"),
        ({"adapt": -1.0}, "adapt: expected a number from 0 to 100, found -1.0"),
        ({"flicker": 0.96}, "flicker: expected a number from 0 to 0.95, found 0.96"),
        ({"adapt": float("nan")}, "adapt: .* found nan"),
        ({"card": "cat"}, "test-card: expected grid, focus, .* found 'cat'"),
        ({"card": "no"}, "test-card: expected grid, focus, .* found 'no'"),
        ({"corners": ((0, 0), (1, 0), (0, 1), (1, 1))}, "they cross"),
        ({"corners": ((0, 0), (1, 0), (2, 0), (0, 1))}, "on a line"),
        ({"corners": ((0, 0), (1, 0), (9, 1), (0, 1))}, "from -2 to 3"),
        ({"corners": ((0, 0), (1, float("nan")), (1, 1), (0, 1))}, "from -2 to 3"),
    ],
)
def test_what_is_out_of_range_is_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Adjustments(**values)  # type: ignore[arg-type]


# Black level and adaptation.


def test_the_black_level_lifts_black_and_keeps_white() -> None:
    for code, expected in ((0, 0.2), (51, 0.2 + 0.8 * 0.2), (255, 1.0)):
        np.testing.assert_allclose(asked(Adjustments(black_level=0.2), (code,) * 3), expected, atol=TABLE)
    renderer = opened(diagonal_room(1.0, 0.0), even((0, 0, 0)), Adjustments(black_level=0.2))
    for compensate in (False, True):
        renderer.render("projector", compensate=compensate)
        np.testing.assert_allclose(renderer.linear(), 0.2, atol=1e-6)


@pytest.mark.parametrize("percent", [1.0, 7.0, 12.0])
def test_what_is_too_bright_is_scaled_until_the_share_may_clip(percent: float) -> None:
    """White in a room that reaches 0.6 of white.

    At scale s, the light s − 0.6 is clipped, so s = 0.6 + the allowed share.
    """
    c = opened(diagonal_room(0.6, 0.0), even((255, 255, 255)), Adjustments(adapt=percent)).desired()
    np.testing.assert_allclose(c, 0.6 + percent / 100, atol=1e-6)


@pytest.mark.parametrize("percent", [2.0, 10.0])
def test_what_is_too_dark_is_lifted_until_the_share_may_clip(percent: float) -> None:
    """Black is lifted to o under ambient light of 0.16.

    The remaining 0.16 − o is clipped: at most half of the share.
    """
    c = opened(diagonal_room(1.0, 0.16), even((0, 0, 0)), Adjustments(adapt=percent)).desired()
    np.testing.assert_allclose(c, 0.16 * (1 - percent / 200), atol=1e-6)


def test_a_picture_that_the_room_can_show_stays() -> None:
    np.testing.assert_allclose(
        opened(diagonal_room(1.0, 0.01), even(COLOUR), Adjustments(adapt=0.1)).desired()[0, 0],
        np.array(COLOUR) / 255,
        atol=TABLE,
    )


def test_adaptation_keeps_its_promise_and_no_more_than_it_must(rng: np.random.Generator) -> None:
    """The clipped light, summed independently, is within the share. One step brighter, it exceeds the share."""
    shape, white = (40, 50), 0.8
    ambient, light = rng.uniform(0, 0.1, (*shape, 3)), rng.uniform(0.5, 1, (*shape, 3))
    most = np.dstack([light, rng.uniform(size=shape) < 0.8])
    inside = most[..., 3] > 0

    def far_light(b: np.ndarray) -> np.ndarray:
        return 0.08 * b[::-1] + 0.04 * b[:, ::-1]

    near_white, near_ambient = (b - far_light(b) for b in (np.ones_like(light), ambient))
    limits = Limits(near_white, near_ambient, ambient, most)
    assert tile_grid(shape) == ((3, 4), (1, 1))  # every pixel is a sample
    for share in (0.001, 0.01, 0.05, 0.2):
        u = rng.uniform(size=(*shape, 3)) ** 2
        s, o = tone_of(u, u - far_light(u), limits, white, share)
        assert 0.25 < s <= 1
        assert 0 <= o < 0.2

        def clipped(s: float, o: float) -> float:
            c = white * (s * u + o)  # noqa: B023
            low = ambient + far_light(c - ambient)
            missed = c - np.clip(c, low, low + light)
            return float(np.abs(missed[inside]).sum() / np.maximum(white * u, ambient)[inside].sum())  # noqa: B023

        assert clipped(s, o) <= share * (1 + 1e-9)
        assert s == 1 - o or clipped(s + (1 - o) * (SCALES[0] - SCALES[1]), o) > share


def test_adaptation_approaches_what_it_found_and_starts_anew_at_a_cut() -> None:
    room, bright, dim = diagonal_room(0.6, 0.0), even((255,) * 3), even((240,) * 3)
    renderer = opened(room, bright, Adjustments(adapt=7.0))
    seen = [renderer.desired()[0, 0, 0]]
    for frame in (dim, dim, even((0,) * 3), bright):
        renderer.upload(frame)
        seen.append(renderer.desired()[0, 0, 0])
        assert renderer.desired()[0, 0, 0] == seen[-1]  # drawing the frame again changes nothing
    share = 1 - np.exp(-0.04 / SMOOTHING_S)
    u, s = 240 / 255, [0.67]
    target = 0.6 / u + 0.07
    for _ in range(2):
        s.append(s[-1] + share * (target - s[-1]))
    # s_i = 0.7 and 0.65 bracket the targets; between them, the clipped light is linear.
    np.testing.assert_allclose(seen, [s[0], s[1] * u, s[2] * u, 0, 0.67], atol=1e-6)


def test_frames_that_were_not_drawn_are_made_up_for() -> None:
    kept, strict = Succession(lasting=True), Succession(lasting=False)
    for each in (kept, strict):
        assert not each.advance(cut=True, duration_s=1.0)
        each.draw()
        assert each.advance(cut=False, duration_s=1.0)
        assert not each.fresh
        assert not each.advance(cut=False, duration_s=1.0)
    assert (kept.fresh, kept.elapsed_s) == (False, 2.0)
    assert strict.fresh


# Damping.


def test_damping_mixes_with_the_drive_before_and_starts_anew_at_a_cut() -> None:
    room = diagonal_room(1.0, 0.0)
    renderer = opened(room, even((200,) * 3), Adjustments(flicker=0.75))
    shown = []
    for code in (200, 190, 190, 40, 40):
        renderer.upload(even((code,) * 3))
        for _ in range(2):
            renderer.render("projector", compensate=True)
        shown.append(255 * renderer.linear()[0, 0, 0])
    np.testing.assert_allclose(shown, [200, 197.5, 195.625, 40, 40], atol=1e-3)
    renderer.render("projector", compensate=False)
    renderer.upload(even((50,) * 3))
    renderer.render("projector", compensate=False)  # a frame without compensation leaves no drive to continue from
    renderer.upload(even((60,) * 3))
    renderer.render("projector", compensate=True)
    assert 255 * renderer.linear()[0, 0, 0] == pytest.approx(60, abs=1e-3)


# Views.


def test_the_impossible_view_is_the_report_s_map(rng: np.random.Generator) -> None:
    physical = physical_room(rng)
    room = replace(physical.room, white=1.3, maps=replace(physical.room.maps, white=1.3))
    found = find_impossible(tier_of(room.calibration, physical.transport), room.maps)
    named = {reason.name: flag for reason, flag in zip(REASONS, found.flags, strict=True)}
    frame = rgb_frame(np.zeros((9, 15, 3), np.uint8))
    renderer = opened(room, frame)
    renderer.render("impossible", compensate=True)
    codes = renderer.encoded()
    colours = {reason.name: reason.colour for reason in (SERVED, *REASONS)}
    expected = np.full((*CAMERA, 3), colours["served"], np.uint8)
    for name in ("below_white", "below_mid_grey", "unlit"):  # the first reason has priority, so it is drawn last
        assert named[name].any()
        expected[named[name]] = colours[name]
    np.testing.assert_array_equal(codes, expected)


def test_the_error_map_is_signed_scaled_and_says_what_does_not_count() -> None:
    """Errors are −20, −10, 0, 10, 20 % of white and larger, in one channel. The sRGB code is linear in the error."""
    errors = np.array([-0.3, -0.2, -0.1, 0, 0.1, 0.2])
    white, b = 0.5, np.full((1, 7, 3), 0.2)
    ambient = np.full((1, 7, 3), 0.05)
    seen = b + ambient
    seen[0, :6, 1] += white * errors
    seen[0, :6, 0] += white * errors / 2  # another channel with a smaller error
    reach = np.ones((1, 7, 4))
    reach[0, 6, 3] = 0
    colours = views.error_colours()[None], white, views.ERROR_SPAN, views.UNCOUNTED
    light = CpuCanvas((1, 7)).draw(ErrorMap(seen, b, ambient, reach, *colours)) / white
    codes = encoding.encode(light, Response("srgb").inverse_table())
    between = [(np.array(end) + views.RIGHT) / 2 for end in (views.TOO_DARK, views.TOO_BRIGHT)]
    expected = [views.TOO_DARK, views.TOO_DARK, between[0], views.RIGHT, between[1], views.TOO_BRIGHT, views.UNLIT]
    np.testing.assert_allclose(codes[0], expected, atol=0.51)  # rounding to codes


def test_the_clipping_map_shows_what_the_room_cannot() -> None:
    """White at 0.6 of its target is fully coloured. Black in ambient light of 0.1 is partly coloured, grey is not."""
    codes = np.zeros((24, 32, 3), np.uint8)
    codes[:, 8:24], codes[:, 24:] = 128, 255
    room, picture = diagonal_room(0.5, 0.1), Adjustments(clipping=True)
    renderer = opened(room, rgb_frame(codes, "linear"), picture)
    renderer.render("camera", compensate=True)
    seen = renderer.linear()
    np.testing.assert_allclose(seen[:, 26:], np.broadcast_to(views.OVER, (24, 6, 3)), atol=1e-6)
    np.testing.assert_allclose(seen[:, 10:22], 128 / 255, atol=1e-5)
    weight = 0.5 + 0.5 * 0.1 / views.CLIP_SPAN
    np.testing.assert_allclose(seen[0, 3], 0.1 + weight * (views.UNDER - 0.1), atol=1e-6)
    renderer.render("projector", compensate=True)
    np.testing.assert_allclose(renderer.linear()[0, 30], views.OVER, atol=1e-6)  # T⁺ b = 1.8
    np.testing.assert_allclose(renderer.linear()[0, 15], (128 / 255 - 0.1) / 0.5, atol=1e-5)


# Test cards.


def test_cards_are_what_their_names_say() -> None:
    shape = (120, 160)
    cards = {name: card(name, shape) for name in CARDS}
    for picture in cards.values():
        assert picture.shape == (*shape, 3)
        assert picture.dtype == np.float32
        assert 0 <= picture.min() <= picture.max() <= 1
    assert cards["white"].min() == 1
    assert cards["black"].max() == 0
    grid = cards["grid"]
    edge = np.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
    # the frame, and the marks in its corners
    assert {tuple(pixel) for pixel in edge.tolist()} == {(1, 0, 0), (1, 1, 1)}
    assert grid[0, 0].tolist() == [1, 1, 1]
    rows, columns = np.nonzero(grid[2:-2, 2:-2].min(axis=2) > 0.99)
    ring = np.abs(np.hypot(rows + 2 - 59.5, columns + 2 - 79.5) - 54) < 1
    angles = np.arctan2(rows[ring] + 2 - 59.5, columns[ring] + 2 - 79.5)
    assert np.diff(np.sort(angles)).max() < 0.06  # the circle is round and closed
    codes = encoding.encode(cards["grey"], Response("srgb").inverse_table())
    np.testing.assert_allclose(np.unique(codes[0]), np.linspace(0, 255, 11), atol=0.51)
    assert np.unique(codes[60]).tolist() == [*range(5), *range(251, 256)]
    assert {tuple(pixel) for pixel in cards["bars"][0].tolist()} == {
        (r, g, b) for r in (0, 1) for g in (0, 1) for b in (0, 1)
    }
    gamma = cards["gamma"]
    for cell in range(0, 6, 2):
        lines, field = (gamma[4:24, round((cell + i) * 160 / 6) + 2] for i in (0, 1))
        assert set(np.unique(lines)) == {0, 1}
        np.testing.assert_allclose(lines.mean(axis=0), field[0], atol=1e-7)
    assert np.unique(gamma[40:50, :, 1:]).tolist() == [0]  # the second row of fields is red


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (13, 7), (100, 3)])
def test_cards_exist_at_any_size(shape: tuple[int, int]) -> None:
    for name in CARDS:
        assert card(name, shape).shape == (*shape, 3)


def test_no_view_shows_the_medium_while_a_card_is_shown(rng: np.random.Generator) -> None:
    room = physical_room(rng).room
    black, white = (
        opened(room, rgb_frame(np.full((9, 15, 3), c, np.uint8)), Adjustments(card="bars")) for c in (0, 255)
    )
    for view in VIEWS:
        for renderer in (black, white):
            renderer.render(view, compensate=True)
        np.testing.assert_array_equal(black.linear(), white.linear())
    black.render("camera", compensate=False)
    near = room.calibration.ambient + PreparedRows(room.maps.transport).apply(
        card("bars", room.maps.transport.source_shape)
    )
    assert np.all(black.linear() >= near - 1e-6)
