"""Several projectors: their raster, joint transport and map, and rooms that cannot be joined."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.pipeline.content import psnr
from counterlight.raster import Region, side_by_side
from counterlight.response import Response
from counterlight.show.command_line import read_options
from counterlight.show.from_options import monitors_of, room_of
from counterlight.show.room_in_use import RoomInUse
from counterlight.tools import join_projectors
from counterlight.tools.inverse.near_light import Conditions, InverseOptions, invert_near_light
from counterlight.tools.joining.projectors import join_transports
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Transport, channel, channels
from tests.joint_rooms import CAMERA, LEFT, RIGHT, join, write_halves
from tests.programs import here, refusal_here
from tests.scenes import SCENES

POSITION = "position = [0.6, 0.2, 2.1]"  # the projector of the scene `wall`


def pictures(drive: np.ndarray, regions: tuple[Region, ...]) -> list[np.ndarray]:
    """Split a raster (height, width, 3) into the projectors' pictures."""
    return [drive[top : top + height, left : left + width] for left, top, width, height in regions]


def simulated(folder: Path, scene: str, old: str, new: str, *sizes: str) -> list[Path]:
    """Write calibrations of a shipped scene and of the same scene with its projector elsewhere."""
    text = (SCENES / f"{scene}.toml").read_text()
    assert old in text
    rooms = []
    for name, described, size in zip(("first", "second"), (text, text.replace(old, new)), sizes, strict=True):
        (folder / f"{name}.toml").write_text(described)
        rooms.append(folder / name)
        sized = "--camera", "48x27", "--projector", size
        here("simulate", folder / f"{name}.toml", "-o", rooms[-1], *sized)
    return rooms


@pytest.mark.parametrize("scene", ["wall", "corner"])
def test_the_joint_transport_is_the_sum_of_all(tmp_path: Path, rng: np.random.Generator, scene: str) -> None:
    """The scene `wall` has near light only. The scene `corner` also has far light."""
    old = next(line for line in (SCENES / f"{scene}.toml").read_text().splitlines() if line.startswith("position"))
    rooms = simulated(tmp_path, scene, old, old.replace("[0.6", "[-0.5").replace("[0.0", "[0.1"), "24x20", "31x13")
    stored = calibration.read(join(rooms, tmp_path / "joint", "--monitor", "HDMI-1", "--monitor", "DP-2"))
    joint = stored.calibration
    assert joint.regions == (Region(0, 0, 24, 20), Region(24, 0, 31, 13))
    assert joint.projector.shape == (20, 55)
    assert [projector.monitor for projector in joint.projectors] == ["HDMI-1", "DP-2"]
    transport, parts = read_transport(stored), [read_transport(calibration.read(room)) for room in rooms]
    assert (transport.far is not None) == (scene == "corner")
    if transport.far is not None and parts[0].far is not None:
        assert transport.far.scatter.columns == parts[0].far.scatter.columns  # all projectors share the cells
    drive = rng.uniform(size=(*joint.projector.shape, 3))
    lit = zip(parts, pictures(drive, joint.regions), strict=True)
    expected = sum(part.apply(picture.reshape(-1, 3)) for part, picture in lit)
    found = transport.apply(drive.reshape(-1, 3))
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * expected.max())  # the stored factors are float32
    below = channel(transport.near, 0).sum(axis=0).reshape(joint.projector.shape)[13:, 24:]
    assert below.max() == 0  # nothing is lit below the second projector, which is lower


@pytest.mark.parametrize("largest_dense", [1, 1 << 20])  # windows, or the whole cluster
def test_a_projector_beside_its_copy_gives_half_of_the_light(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, largest_dense: int
) -> None:
    """Damping keeps [T T]⁺ = ½ [T⁺; T⁺], because λ is relative to the largest singular value, which grows by √2."""
    monkeypatch.setattr("counterlight.tools.inverse.method.LARGEST_DENSE", largest_dense)
    room = calibration.read(write_halves(tmp_path)[0])
    single, shape, mask = read_transport(room), room.calibration.projector.shape, room.calibration.mask
    twice = join_transports([single, single], [shape, shape])
    options = InverseOptions(damping=0.1, max_error=0.01, inverse="whole")

    def rows(transport: Transport, shape: tuple[int, int]) -> np.ndarray:
        regions = [Region(left, 0, 44, 30) for left in range(0, shape[1], 44)]
        reach = np.ones((mask.size, 3))
        found = invert_near_light(transport.near, mask, shape, reach, 1.0, options, Conditions(regions))
        return channels(found.T_pinv)[1].toarray().reshape(*shape, mask.size)

    alone, together = rows(single, shape), rows(twice, (shape[0], 2 * shape[1]))
    for half in (together[:, : shape[1]], together[:, shape[1] :]):
        difference = np.abs(half - alone / 2).sum(axis=2).max()
        # in drive, for light of 1: truncation and windows change each of the two by this much
        assert difference < 0.5 / 255


def test_two_projectors_give_a_better_picture_where_they_overlap(tmp_path: Path) -> None:
    """PSNR of the predicted camera picture in the overlap, for a target that neither projector alone can reach."""
    rooms = simulated(tmp_path, "wall", POSITION, POSITION.replace("0.6", "-0.5"), "24x20", "24x20")
    joint = join(rooms, tmp_path / "joint")
    stored = [calibration.read(room) for room in (*rooms, joint)]
    overlap = np.logical_and(*(one.calibration.mask for one in stored[:2]))
    assert overlap.mean() > 0.2
    np.testing.assert_array_equal(stored[2].calibration.mask, np.logical_or(*(s.calibration.mask for s in stored[:2])))
    floodlight = read_transport(stored[2]).composition().reshape(27, 48, 3)
    white = float(np.percentile(floodlight[overlap], 5))
    y, x = np.mgrid[:27, :48]
    wanted = white * (0.75 + 0.2 * np.sin(x / 5) * np.cos(y / 4))[..., None] * np.ones(3)
    exr.write_rgb(tmp_path / "wanted.exr", wanted.astype(np.float32))
    reached = {}
    for one in stored:
        here("build", one.folder, "--regularize", "0.03")
        for refine in ("0", "8"):
            drive_path = tmp_path / "drive.exr"
            options = "--white", white, "--refine", refine, "--output", drive_path
            here("play", one.folder, tmp_path / "wanted.exr", *options)
            drive = exr.read_rgb(drive_path).astype(np.float64)
            seen = read_transport(one).apply(drive.reshape(-1, 3)).reshape(27, 48, 3) + one.calibration.ambient
            reached[one.folder.name, refine] = psnr(float(np.mean(((seen - wanted)[overlap] / white) ** 2)))
    for refine in ("0", "8"):
        assert reached["joint", refine] > max(reached["first", refine], reached["second", refine]) + 5  # in decibels


def test_monitors_are_written_and_read(tmp_path: Path) -> None:
    joint = join(write_halves(tmp_path), tmp_path / "joint", "--monitor", "A", "--monitor", "B")
    assert calibration.read(joint).calibration.projectors[1] == Device(*RIGHT, Response("srgb"), "B")
    text = (joint / "calibration.toml").read_text()
    (joint / "calibration.toml").write_text(text.replace('monitor = "B"', "monitor = 2"))
    with pytest.raises(InputError, match=r"projectors 2, monitor: found 2, expected a text"):
        calibration.read(joint)


def test_colour_matrices_are_written_and_read(tmp_path: Path) -> None:
    colour = ((0.75, 0.25, 0.0), (0.0, 0.875, 0.125), (0.125, 0.125, 0.75))
    joint = calibration.read(join(write_halves(tmp_path), tmp_path / "joint"))
    left, right = joint.calibration.projectors
    turned = replace(joint.calibration, projectors=(left, replace(right, colour=colour)))
    transport = read_transport(joint)
    with calibration.writing(joint.folder, turned, force=True) as stage:
        write_transport(transport, stage)
    assert calibration.read(joint.folder).calibration.projectors == turned.projectors
    text = (joint.folder / "calibration.toml").read_text()
    for old, new, complaint in (
        ("0.875", "0.8", "projectors 2, colour .*: expected three rows of three numbers, none below 0, each of sum 1"),
        ("0.875", "-0.875", "projectors 2, colour: found .*, expected 3 numbers from 0 to 1"),
    ):
        assert old in text
        (joint.folder / "calibration.toml").write_text(text.replace(old, new))
        with pytest.raises(InputError, match=complaint):
            calibration.read(joint.folder)


def test_joint_rooms_are_joined_in_turn(tmp_path: Path, rng: np.random.Generator) -> None:
    left, right = write_halves(tmp_path)
    pair = join([left, right], tmp_path / "pair")
    three = calibration.read(join([pair, left], tmp_path / "three"))
    shapes = [(projector.height, projector.width) for projector in three.calibration.projectors]
    assert shapes == [LEFT, RIGHT, LEFT]
    drive = rng.uniform(size=(*three.calibration.projector.shape, 3))
    parts = [read_transport(calibration.read(room)) for room in (left, right, left)]
    lit = zip(parts, pictures(drive, three.calibration.regions), strict=True)
    expected = sum(part.apply(picture.reshape(-1, 3)) for part, picture in lit)
    np.testing.assert_allclose(read_transport(three).apply(drive.reshape(-1, 3)), expected, rtol=1e-6, atol=1e-9)


def test_a_file_holds_the_raster_in_each_projectors_own_response(tmp_path: Path) -> None:
    """The raster's codes, converted by each projector's own response, equal the requested drive."""
    joint = join(write_halves(tmp_path, right_response="linear"), tmp_path / "joint")
    room = calibration.read(joint).calibration
    assert [device.response.kind for device in room.projectors] == ["srgb", "linear"]
    here("build", joint, "--regularize", "0.1")
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((*CAMERA, 3), 120, np.uint8))
    for name, options in (("raster.png", ()), ("codes.png", ("--dither", "none")), ("drive.exr", ("--dither", "none"))):
        here("play", joint, tmp_path / "grey.png", *options, "--output", tmp_path / name)
    raster = cv2.imread(str(tmp_path / "raster.png"))
    assert raster.shape == (LEFT[0], LEFT[1] + RIGHT[1], 3)
    assert raster[RIGHT[0] :, LEFT[1] :].max() == 0
    assert min(raster[: RIGHT[0], LEFT[1] :].mean(), raster[:, : LEFT[1]].mean()) > 20
    codes, drive = cv2.imread(str(tmp_path / "codes.png"))[..., ::-1] / 255, exr.read_rgb(tmp_path / "drive.exr")
    for device, own, meant in zip(
        room.projectors, pictures(codes, room.regions), pictures(drive, room.regions), strict=True
    ):
        low, high = (device.response.to_linear(np.clip(own + half, 0, 1)) for half in (-0.51 / 255, 0.51 / 255))
        # the nearest code, and interpolation in the table
        assert np.all((low - 1e-6 <= meant) & (meant <= high + 1e-6))
        assert meant.std() > 0.01


def test_what_cannot_be_joined(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = write_halves(tmp_path)
    _, smaller = write_halves(tmp_path / "camera", right_camera=(20, 60))
    output = "-o", tmp_path / "joint"
    refused = partial(refusal_here, join_projectors.main, capsys, tmp_path)
    assert "its camera has 60x20 pixels, that of" in refused(left, smaller, *output)
    assert "1 calibration to join" in refused(left, *output)
    assert "--monitor: 1 given for 2 projectors" in refused(left, right, *output, "--monitor", "A")
    bright = calibration.read(right).calibration
    lit = Calibration("lit", "", bright.projectors, bright.camera, bright.ambient + 0.1, bright.mask)
    with calibration.writing(tmp_path / "lit", lit) as stage:
        for path in right.glob("transport_*"):
            (stage / path.name).write_bytes(path.read_bytes())
    assert "its ambient light differs from that of" in refused(left, tmp_path / "lit", *output)


def test_a_raster_too_wide_for_a_picture_goes_on_below() -> None:
    """Ten projectors of 1920 pixels: eight, and two below them. Raster pixels without a projector light nothing."""
    shape, regions = side_by_side([(1080, 1920)] * 9 + [(1200, 1600)])
    assert shape == (2400, 15360)
    assert regions[7:] == (Region(13440, 0, 1920, 1080), Region(0, 1200, 1920, 1080), Region(1920, 1200, 1600, 1200))
    projector, camera = Device(9000, 4, Response("linear")), Device(2, 3, Response("linear"))
    light, mask = np.zeros((2, 3, 3), np.float32), np.ones((2, 3), bool)
    wide = Device(9000, 16384, Response("linear"))
    with pytest.raises(InputError, match="size 16384x18000: expected 1 to 16384"):
        Calibration("wide", "", (projector, wide), camera, light, mask)


def test_a_reloaded_room_keeps_its_regions(tmp_path: Path) -> None:
    """A raster of the same size with other regions is refused, because the windows cannot change their regions."""
    left, right = write_halves(tmp_path)
    room, options = join([left, right], tmp_path / "joint"), ("--inverse", "none")
    here("build", room, *options)
    parsed = read_options([str(room), "a.png", "--no-config"], "")
    read = partial(room_of, parsed)
    in_use = RoomInUse(room, read(), read, lambda fresh: pytest.fail("a renderer was made"))
    join([right, left], room, "--force")
    here("build", room, *options)
    with pytest.raises(InputError, match=r"size is now 36x26 \+ 44x30, was 44x30 \+ 36x26; start the player again"):
        in_use.reload()


@pytest.mark.parametrize(
    ("given", "settings", "monitors"),
    [
        ([], "", []),
        (["--monitor", "A"], "", ["A"]),
        (["--monitor", "A", "--monitor=B"], "", ["A", "B"]),
        ([], 'monitor = "S"', ["S"]),
        (["--monitor", "A", "--monitor", "B"], 'monitor = "S"', ["A", "B"]),
    ],
)
def test_a_monitor_is_given_once_for_each_projector(
    tmp_path: Path, given: list[str], settings: str, monitors: list[str]
) -> None:
    (tmp_path / "player.toml").write_text(settings)
    options = read_options(["room", "a.png", *given, "--config", str(tmp_path / "player.toml")], "")
    assert monitors_of(options) == monitors
