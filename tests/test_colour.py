"""Tiers of colour against all nine matrices, and damaged primaries."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

import counterlight as cl
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.maps.mixing import TIERS, Mixing, invertible, mixed
from counterlight.pipeline.content import psnr
from counterlight.tools.colour import neutral as neutral_colour
from counterlight.tools.colour.neutral import neutral_mixing
from counterlight.tools.colour.shared import colour_matrices
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.joining.projectors import join_rooms
from counterlight.tools.solve.registry import prepare
from tests.coloured_rooms import CROSSTALK, LEDS, WHEEL, ColouredRoom, coloured_room, mixing_of_condition

FloatArray = NDArray[np.float64]
SIXTEEN = mixing_of_condition(16)
UNLIKE_CAMERA, UNLIKE_PROJECTOR = (12, 16), (9, 12)  # 18 dense matrices, which take scipy seconds
NEAR_DB = 0.05  # distance from the optimum of nine matrices: the box solver's gap, and errors that two primaries share


def picture(camera: tuple[int, int]) -> FloatArray:
    y, x = np.mgrid[: camera[0], : camera[1]] / max(camera)
    return np.stack([0.3 + 0.4 * x, 0.7 - 0.5 * y, 0.3 + 0.3 * np.sin(5 * x)], axis=2)


def compensated(room: ColouredRoom, colour: str, neutral: FloatArray) -> tuple[float, Tier]:
    """PSNR in screen primaries of the drive through all nine matrices, and the tier that computed its targets."""
    tier = tier_of(room.calibration, room.transport, colour)
    desired = WHITE * picture(room.calibration.camera.shape)
    drive = prepare("box", tier.transport, room.calibration.mask).solve(tier.target(desired)).drive
    seen = room.radiance(drive) @ np.linalg.inv(neutral).T
    return psnr(float(np.mean(((seen - desired) / WHITE) ** 2))), tier


def optimum(room: ColouredRoom, neutral: FloatArray) -> float:
    """PSNR of the best drive within 0..1. scipy solves the whole 3 m × 3 n system (thesis eq. 4.2)."""
    Q = np.linalg.inv(neutral)
    _, _, rows, columns = room.nine.shape
    A = np.einsum("mk,klij->milj", Q, room.nine).reshape(3 * rows, 3 * columns)
    desired = WHITE * picture(room.calibration.camera.shape) - room.calibration.ambient @ Q.T
    b = desired.reshape(-1, 3).T.ravel()
    found = lsq_linear(A, b, (0, 1), tol=1e-12)
    return psnr(float(np.mean((A @ found.x - b) ** 2) / WHITE**2))


WHITE = 0.45  # within reach of most pixels, in every tier


@pytest.mark.parametrize("neutral", [CROSSTALK, SIXTEEN], ids=["12 %", "condition 16"])
def test_where_paint_is_even_both_tiers_reach_the_nine_matrices_optimum(
    rng: np.random.Generator, neutral: FloatArray
) -> None:
    room = coloured_room(rng, neutral)
    best = optimum(room, neutral)
    for colour in ("global", "pixel", "auto"):
        found, tier = compensated(room, colour, neutral)
        assert found == pytest.approx(best, abs=NEAR_DB)
        assert tier.mixing.neutral == pytest.approx(neutral, abs=1e-5)  # float32 floodlights, times the condition
    assert tier.mixing.tier == "global"
    assert compensated(room, "independent", neutral)[0] < best - NEAR_DB


@pytest.mark.parametrize(("neutral", "paint"), [(CROSSTALK, 0.3), (SIXTEEN, 0.02)], ids=["12 %", "condition 16"])
def test_where_paint_differs_a_mixing_of_each_pixel_reaches_it(
    rng: np.random.Generator, neutral: FloatArray, paint: float
) -> None:
    room = coloured_room(rng, neutral, paint=paint, camera=(16, 22))
    best = optimum(room, neutral)
    pixel, tier = compensated(room, "pixel", neutral)
    assert pixel == pytest.approx(best, abs=NEAR_DB)
    assert compensated(room, "global", neutral)[0] < pixel
    chosen = tier_of(room.calibration, room.transport)
    assert chosen.mixing.tier == "pixel"
    assert str(chosen) == str(tier)


@pytest.mark.parametrize("neutral", [CROSSTALK, SIXTEEN], ids=["12 %", "condition 16"])
def test_a_tier_says_what_a_drive_of_any_colour_looks_like(rng: np.random.Generator, neutral: FloatArray) -> None:
    """Where the primaries' footprints agree, the tier per pixel is exact: three matrices and a mixing give all nine."""
    room = coloured_room(rng, neutral, paint=0.3 / np.linalg.cond(neutral))
    drive = rng.uniform(size=(room.transport.shape[1], 3))
    tier = tier_of(room.calibration, room.transport, "pixel")
    seen = tier.mixing.on_screen(room.radiance(drive))
    rounding = 3e-6 * np.linalg.cond(neutral)  # float32 T and F, times Q
    np.testing.assert_allclose(tier.seen(drive), seen, atol=rounding)
    asked = tier.target(seen).reshape(-1, 3)
    np.testing.assert_allclose(asked, tier.transport.apply(drive), atol=4 * rounding)  # rounding, times A


def test_without_floodlights_or_as_asked_nothing_changes(rng: np.random.Generator) -> None:
    room = coloured_room(rng)
    bare = replace(room.calibration, primaries=None)
    for tier in (tier_of(bare, room.transport), tier_of(room.calibration, room.transport, "independent")):
        assert tier.transport is room.transport
        assert tier.mixing.tier == "independent"
        np.testing.assert_array_equal(tier.reach, room.transport.floodlight(bare.ambient))
    with pytest.raises(
        InputError, match="--colour pixel: the calibration holds no floodlights of the primaries; measure"
    ):
        tier_of(bare, room.transport, "pixel")
    with pytest.raises(InputError, match="--colour purple: expected one of auto, independent, global, pixel"):
        tier_of(bare, room.transport, "purple")


def test_the_neutral_mixing_is_found_beside_paint_of_any_colour_and_gain(rng: np.random.Generator) -> None:
    """Two thirds of the room are coloured, and one camera channel is three times as sensitive."""
    room = coloured_room(rng, paint=0.3, camera=(40, 60))
    F = room.calibration.primaries
    assert F is not None
    for gains in ((1, 1, 1), (1, 3, 0.5)):
        found = neutral_mixing(F * np.float32(gains), room.calibration.mask)
        primaries = np.diag(gains) @ CROSSTALK
        expected = primaries * np.linalg.solve(primaries, np.ones(3))  # white is defined by the camera
        np.testing.assert_allclose(found, expected, atol=1e-2)  # paint of up to ± 30 % within a primary


def test_of_a_large_camera_some_pixels_tell_the_neutral_mixing(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = coloured_room(rng, camera=(40, 60))
    F, mask = np.array(room.calibration.primaries), room.calibration.mask
    whole = neutral_mixing(F, mask)
    every_fifth = mask.ravel().cumsum() % 5 == 1
    F.reshape(3, -1, 3)[:, ~every_fifth & mask.ravel()] = np.nan  # NaN in a chosen pixel would make the result NaN
    monkeypatch.setattr(neutral_colour, "MOST_COUNTED", mask.sum() // 5)
    np.testing.assert_allclose(neutral_mixing(F, mask), whole, atol=1e-3)


def damaged(room: ColouredRoom, kind: str) -> Calibration:
    F = np.array(room.calibration.primaries)
    if kind == "signed":  # sensor data of a camera that corrects colours
        F[0, ::2, ::2, 1] = -0.5 * F[0, ::2, ::2, 0]
    elif kind == "clipped":
        F[:, ::2, ::2] = 0
    elif kind == "singular":
        F[1, ::2, ::2] = F[0, ::2, ::2]
    elif kind == "another unit":
        F[:, ::2, ::2] *= 1e6
    elif kind == "nothing":
        F[:] = 0
    elif kind == "tiny":
        F[:] = F * np.float32(1e-30)
    else:
        F[:] = F[:1]  # all three primaries are equal
    return replace(room.calibration, primaries=F)


@pytest.mark.parametrize("kind", ["signed", "clipped", "singular", "another unit", "nothing", "tiny", "one primary"])
@pytest.mark.parametrize("colour", ["auto", *TIERS])
def test_floodlights_that_make_no_sense_make_no_nan(rng: np.random.Generator, kind: str, colour: str) -> None:
    """Pixels fall back to the room's mixing; a room without a mixing is refused, or its channels are independent."""
    room = coloured_room(rng, paint=0.1)
    calibration = damaged(room, kind)
    if kind in ("nothing", "one primary") and colour in ("global", "pixel"):
        with pytest.raises(InputError, match="floodlights of the primaries cannot be distinguished"):
            tier_of(calibration, room.transport, colour)
        return
    tier = tier_of(calibration, room.transport, colour)
    assert np.isfinite(tier.transport.near.weights).all()
    assert tier.transport.near.weights.min() >= 0
    asked = tier.target(tier.white * picture(calibration.camera.shape))
    assert np.isfinite(asked).all()
    assert np.isfinite(tier.reach).all()
    drive = prepare("box", tier.transport, calibration.mask).solve(asked).drive
    assert np.isfinite(tier.seen(drive)).all()
    if tier.mixing.pixel is not None and kind in ("signed", "clipped", "singular", "another unit"):
        own = np.abs(tier.mixing.pixel - np.eye(3)).max(axis=(2, 3)) > 0
        assert own[1::2, 1::2].all()
        if kind != "signed":
            assert not own[::2, ::2].any()


def test_white_asks_the_primaries(rng: np.random.Generator) -> None:
    """White is the 10th percentile of 1 / max_l [F⁻¹ M₀ 1]_l, without ambient light."""
    room = coloured_room(rng, paint=0.3, ambient=0.0)
    F = np.moveaxis(room.calibration.primaries.astype(np.float64).reshape(3, -1, 3), 0, -1)  # type: ignore[union-attr]
    t = np.linalg.solve(F, np.ones((len(F), 3, 1)))[..., 0]
    expected = np.percentile(1 / t.max(axis=1), 10)
    # rounding to float32
    assert tier_of(room.calibration, room.transport, "pixel").white == pytest.approx(expected, rel=1e-5)


def test_white_is_what_a_drive_of_the_primaries_shows_at_its_brightest(rng: np.random.Generator) -> None:
    """With ambient light, the largest share of a primary is 1 for the brightest grey that a pixel can show."""
    room = coloured_room(rng, paint=0.3, ambient=0.1)
    tier = tier_of(room.calibration, room.transport, "pixel")
    grey = np.repeat(tier.reach.min(axis=2, keepdims=True), 3, axis=2)
    share = tier.target(grey) / tier.transport.composition().reshape(grey.shape)
    np.testing.assert_allclose(share.max(axis=2), 1, atol=1e-5)  # float32 A and T


@pytest.mark.parametrize("colour", TIERS)
def test_maps_keep_the_tier_on_disk_and_both_backends_show_what_the_nine_matrices_do(
    tmp_path: Path, rng: np.random.Generator, colour: str
) -> None:
    made = coloured_room(rng, paint=0.3)
    room = cl.Room(made.calibration, made.transport, colour)
    maps = cl.build_maps(room, damping=0.05, max_error=0.0)
    room.write(tmp_path / "room", maps=maps)
    read, again = cl.read_room(tmp_path / "room"), cl.read_maps(tmp_path / "room")
    assert again.mixing.tier == colour
    assert again.white == pytest.approx(maps.white)
    assert read.calibration.primaries is not None
    wanted = picture(room.camera)
    drives = []
    for backend in ("gl", "cpu"):
        with cl.Renderer(read, again, backend=backend) as renderer:
            drives.append(renderer.render(wanted, refine=256))
            shown = renderer.camera_view()
            np.testing.assert_allclose(shown, room.seen(drives[-1]), atol=1e-4)  # float32 maps and mixing
    np.testing.assert_allclose(*drives, atol=1e-4)  # error of 256 steps in float32
    best = cl.solve(room, wanted)
    error = [np.mean((room.seen(drive) - room.white * wanted) ** 2) for drive in (drives[0], best.drive)]
    assert psnr(error[0]) == pytest.approx(psnr(error[1]), abs=NEAR_DB)


def spoil(folder: Path, kind: str) -> None:
    """Change the mixing of a map and renew its checksum."""
    import tomllib

    import tomli_w

    from counterlight.files import exr
    from counterlight.files.manifest import describe_files

    manifest = tomllib.loads((folder / "manifest.toml").read_text())
    if kind in ("singular", "rows", "text"):
        manifest["colour"]["neutral"] = {
            "singular": [[1 / 3] * 3] * 3,
            "rows": [[1, 1, 0], [0, 1, 0], [0, 0, 1]],
            "text": "red",
        }[kind]
    elif kind == "tier":
        manifest["colour"]["tier"] = "purple"
    else:
        values = {"nan": np.nan, "huge": 1e30, "flat": 0.0}[kind]
        shape = manifest["maps"]["transport"]
        del shape
        size = exr.read_rgb(folder / "mixing_red.exr", lambda *_: None).shape
        exr.write_rgb(folder / "mixing_red.exr", np.full(size, values, np.float32))
        manifest["files"] = describe_files(folder)
    (folder / "manifest.toml").write_text(tomli_w.dumps(manifest))


@pytest.mark.parametrize("kind", ["singular", "rows", "text", "tier", "nan", "huge", "flat"])
def test_a_mixing_that_cannot_be_undone_is_refused(tmp_path: Path, rng: np.random.Generator, kind: str) -> None:
    made = coloured_room(rng, paint=0.3)
    room = cl.Room(made.calibration, made.transport, "pixel")
    room.write(tmp_path / "room", maps=cl.build_maps(room, damping=0.1))
    spoil(tmp_path / "room/correction", kind)
    with pytest.raises(InputError, match="rebuild it with: counterlight build"):
        cl.read_maps(tmp_path / "room")


def test_matrices_without_an_inverse_are_distinguished() -> None:
    cases = np.stack([np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan), np.diag([1, 1, 1e-4]), np.ones((3, 3))])
    assert invertible(cases).tolist() == [True, False, False, False, False]
    assert Mixing().tier == "independent"


def half(room: ColouredRoom, seen: NDArray[np.bool_]) -> ColouredRoom:
    """Keep the light of the camera pixels in `seen`, (camera height, camera width)."""
    lit = seen.ravel()
    F = room.calibration.primaries
    assert F is not None
    calibration = replace(room.calibration, mask=seen, primaries=F * seen[..., None])
    return ColouredRoom(calibration, room.transport.inside(seen), room.nine * lit[:, None])


def joined(folder: Path, rooms: Sequence[ColouredRoom]) -> cl.Room:
    for number, room in enumerate(rooms):
        cl.Room(room.calibration, room.transport).write(folder / f"{number}")
    join_rooms([folder / f"{number}" for number in range(len(rooms))], folder / "joint")
    return cl.read_room(folder / "joint")


def shown(room: cl.Room, drive: FloatArray) -> list[FloatArray]:
    """Each projector's part of a drive, in its own primaries."""
    parts = [drive[region.part] for region in room.calibration.regions]
    matrices = [np.eye(3) if device.colour is None else device.colour for device in room.calibration.projectors]
    return [part @ np.array(D).T for part, D in zip(parts, matrices, strict=True)]


def test_unlike_projectors_beside_each_other_show_the_same_colours(tmp_path: Path, rng: np.random.Generator) -> None:
    """Each pixel has the mixing of the projector that lights it, in primaries that both projectors have."""
    left = np.zeros((11, 17), bool)
    left[:, :8] = True
    whole = [coloured_room(rng, neutral, paint=0.1, ambient=0.0) for neutral in (CROSSTALK, mixing_of_condition(4))]
    rooms = [half(room, seen) for room, seen in zip(whole, (left, ~left), strict=True)]
    joint = joined(tmp_path, rooms)
    assert joint.tier.mixing.tier == "pixel"
    drive = rng.uniform(size=(7, 26, 3))
    own = shown(joint, drive)
    assert min(part.min() for part in own) >= 0
    assert max(part.max() for part in own) <= 1 + 1e-12
    seen = sum(room.radiance(part) for room, part in zip(rooms, own, strict=True))
    found = joint.tier.mixing.as_radiance(joint.seen(drive))
    np.testing.assert_allclose(found, seen, atol=2e-6)  # float32 T and F


@pytest.mark.parametrize("tint", [(1.0, 1.0, 1.0), (0.8, 1.0, 1.15)], ids=["white alike", "white bluer"])
def test_unlike_projectors_on_one_surface_come_near_the_optimum_of_all_primaries(
    tmp_path: Path, rng: np.random.Generator, tint: tuple[float, float, float]
) -> None:
    """LEDs next to a colour wheel, against scipy's least squares over all eighteen matrices (thesis eq. 4.6).

    The remaining difference, up to 3 dB of 42, comes from colours that only one projector shows, and from errors that
    primaries share. The sum of the floodlights alone would lose 15 dB.
    """
    surface, rooms, (height, width) = rng.integers(1 << 30), [], UNLIKE_PROJECTOR
    for neutral, shift in ((LEDS, (0.0, 0.0)), (WHEEL * tint, (0.3, 0.4))):
        same = np.random.default_rng(surface)
        rooms.append(coloured_room(same, neutral, camera=UNLIKE_CAMERA, projector=UNLIKE_PROJECTOR, shift=shift))
    joint = joined(tmp_path, rooms)
    # the gamut of the LEDs contains the primaries of the colour wheel
    assert [device.colour is None for device in joint.calibration.projectors] == [False, True]
    desired = WHITE * picture(UNLIKE_CAMERA)
    drive = prepare("box", joint.tier.transport, joint.calibration.mask).solve(joint.tier.target(desired)).drive
    lit = [
        room.radiance(part) for room, part in zip(rooms, shown(joint, drive.reshape(height, 2 * width, 3)), strict=True)
    ]
    Q, ambient = joint.tier.mixing.to_screen, joint.calibration.ambient
    seen = (sum(lit) - ambient) @ Q.T
    found = psnr(float(np.mean(((seen - desired) / WHITE) ** 2)))
    eighteen = [np.einsum("mk,klij->milj", Q, room.nine).reshape(desired.size, 3 * height * width) for room in rooms]
    A, b = np.hstack(eighteen), (desired - ambient @ Q.T).reshape(-1, 3).T.ravel()
    best = psnr(float(np.mean((A @ lsq_linear(A, b, (0, 1), tol=1e-9).x - b) ** 2) / WHITE**2))
    assert found > best - 5


def test_projectors_that_are_alike_keep_their_own_primaries(tmp_path: Path, rng: np.random.Generator) -> None:
    room = coloured_room(rng)
    joint = joined(tmp_path, [room, room])
    assert [device.colour for device in joint.calibration.projectors] == [None, None]
    np.testing.assert_allclose(joint.calibration.primaries, 2 * room.calibration.primaries, rtol=1e-6)


def test_a_room_of_which_a_projector_s_primaries_are_not_known_has_none(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    room = coloured_room(rng)
    joint = joined(tmp_path, [room, replace(room, calibration=replace(room.calibration, primaries=None))])
    assert joint.calibration.primaries is None


def test_projectors_without_a_white_in_common_are_refused(rng: np.random.Generator) -> None:
    """A lamp is so blue that the other projector's pale primaries cannot match it."""
    rooms = [coloured_room(rng, neutral) for neutral in (mixing_of_condition(4), LEDS * (0.2, 1.0, 5.0))]
    measured = [room.calibration.primaries for room in rooms]
    with pytest.raises(InputError, match="left, right have no white in common"):
        colour_matrices(measured, [room.calibration.mask for room in rooms], ["left", "right"])
    alike = np.ones((3, 11, 17, 3))
    unknown = colour_matrices([measured[0], alike], [room.calibration.mask for room in rooms], ["left", "right"])
    assert unknown == (None, None)


def test_what_a_pixel_cannot_have_is_asked_nearest_in_the_cameras_colours(rng: np.random.Generator) -> None:
    """Where a primary reaches its limit, the other primaries compensate, as in scipy's bounded least squares."""
    camera = 6, 10
    B = np.eye(3) + 0.3 * rng.uniform(-1, 1, (*camera, 3, 3))
    mixing = Mixing(WHEEL, (B / np.linalg.norm(B, axis=2, keepdims=True)).astype(np.float32))
    light, full = rng.uniform(-0.5, 1.5, (*camera, 3)), rng.uniform(0.2, 1, (*camera, 3))
    light[0] = 0.5 * full[0]
    found, clipped = mixing.within(light, full), np.clip(light, 0, full)
    assert np.array_equal(found[0], light[0])  # the light at a reachable target stays unchanged
    assert ((found >= 0) & (found <= full)).all()
    assert mixing.pixel is not None
    matrices = WHEEL @ mixing.pixel.astype(np.float64)
    off = {
        name: np.linalg.norm(mixed(matrices, y - light), axis=2) for name, y in (("found", found), ("clip", clipped))
    }
    best = np.zeros(camera)
    for y, x in np.ndindex(*camera):
        answer = lsq_linear(matrices[y, x], matrices[y, x] @ light[y, x], (0, full[y, x]), tol=1e-12)
        best[y, x] = np.linalg.norm(answer.fun)
    assert (off["found"] <= 1.05 * best + 1e-9).all()  # the reference makes three iterations over the primaries
    assert off["found"].mean() < 1.005 * best.mean()
    assert off["clip"].mean() > 1.02 * best.mean()
    assert np.array_equal(Mixing(WHEEL).within(light, full), clipped)  # one mixing for the room: independent channels
