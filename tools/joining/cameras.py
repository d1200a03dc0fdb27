"""Joins cameras that saw the same projectors, at different times or together, below each other (thesis 4.1.3).

With c = (c₁, c₂, …) the pictures in one raster, the rows of the T_k are stacked. For far light, M is block-diagonal,
the D are stacked, and each camera keeps the U of its own room.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight import calibration as calibrations
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.maps import row_map
from counterlight.maps.row_map import SparseRows
from counterlight.raster import Shape, Shapes
from counterlight.response import Response
from counterlight.screen import parts_of, raster_of
from counterlight.tools.choices import TOLERANCE
from counterlight.tools.factoring.factoring import factored
from counterlight.tools.hdr.camera_response import NODES
from counterlight.tools.joining.projectors import block_diagonal, equal, with_monitors
from counterlight.tools.joining.shared_screen import SharedRoom, on_one_screen
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Dense, FarLight, Transport

# largest difference between two cameras' measurements of one projector's response, as a share of white
MOST_APART = 0.02


@dataclass(frozen=True)
class CameraOptions:
    """Options for joining cameras.

    screen : one of choices.SCREENS. The device whose view is the screen.
    keep_exposures : do not match the cameras' light where they overlap.
    tolerance : dB that pictures may lose if a dense T is factored; 0 keeps T.
    """

    screen: str = "camera"
    keep_exposures: bool = False
    tolerance: float = TOLERANCE


def join_cameras(
    folders: Sequence[Path],
    output: Path,
    options: CameraOptions,
    monitors: Sequence[str] = (),
    *,
    name: str | None = None,
    force: bool = False,
) -> str:
    """Write one calibration with the cameras of several; returns a summary and a line per camera.

    Raises InputError for differing projectors, and for cameras that share nothing.
    """
    if len(folders) < 2:
        raise InputError(f"{len(folders)} calibration to join: give at least two, of the same projectors")
    with calibrations.replacing(output, force=force, inputs=folders) as stage:
        stored = [calibrations.read(folder) for folder in folders]
        rooms = [one.calibration for one in stored]
        check_projectors(rooms, folders)
        made = [factored(read_transport(one), one.calibration.ambient, options.tolerance)[0] for one in stored]
        shared = joined_cameras(rooms, made, name or output.name, options, monitors)
        write_transport(shared.transport, stage)
        calibrations.write(shared.calibration, stage)
    return "\n".join([f"{output}: {described(shared.calibration)}", *map(str, shared.placed)])


def described(calibration: Calibration) -> str:
    """Describe cameras, raster and screen in words."""
    (height, width), camera = calibration.placed_on, calibration.camera
    return f"{len(calibration.cameras)} cameras, raster {camera.width}x{camera.height}, screen {width}x{height}"


def joined_cameras(
    rooms: Sequence[Calibration],
    transports: Sequence[Transport],
    name: str,
    options: CameraOptions,
    monitors: Sequence[str] = (),
) -> SharedRoom:
    """Join the cameras of rooms with the same projectors, in the rooms' order."""
    joint, transport = below_each_other(rooms, transports, name, monitors)
    cameras = tuple(itertools.chain.from_iterable(room.cameras for room in rooms))
    shared = on_one_screen(joint, transport, cameras, screen=options.screen, keep_exposures=options.keep_exposures)
    room, screen = shared.calibration, shared.calibration.screen
    assert screen is not None
    before = np.concatenate([each.gains for each in rooms])  # rooms may have had several cameras already
    room = replace(room, screen=replace(screen, gains=room.gains * before))
    return replace(shared, calibration=room)


def below_each_other(
    rooms: Sequence[Calibration], transports: Sequence[Transport], name: str, monitors: Sequence[str] = ()
) -> tuple[Calibration, Transport]:
    """Return one room in the raster of all cameras, treated as one camera: thesis eq. 4.7."""
    if any(transport.blurred is not None for transport in transports):
        raise InputError(
            "several cameras cannot have light in blocks of projector pixels; simulate each room with --tolerance 0"
        )
    cameras = tuple(itertools.chain.from_iterable(room.cameras for room in rooms))
    rows, shape = _rows_of_rooms(rooms, cameras), raster_of(cameras)
    joint = Calibration(
        name,
        "cameras joined by counterlight join: " + "; ".join(f"{room.name} ({room.provenance})" for room in rooms),
        with_monitors(rooms[0].projectors, monitors),
        Device(*shape, Response("linear")),
        _below([room.ambient for room in rooms], rows, shape),
        _below([room.mask for room in rooms], rows, shape),
        _primaries(rooms, rows, shape),
    )
    near = _rows_at([each.near for each in transports], rows)
    return joint, Transport(near, _far_light(transports, rows), shape, rooms[0].projector.shape)


def seen_below(transports: Sequence[Transport | None], cameras: Shapes, projector: Shape) -> Transport:
    """Return T of several cameras in their raster.

    transports : (height · width, projector pixels) each; None for a dark camera.
    """
    there = [each for each in transports if each is not None]
    ends = np.cumsum([0, *(each.shape[0] for each in there)])
    rows, starts = np.full(raster_of(cameras), ends[-1]), iter(ends)
    for part, each in zip(parts_of(cameras), transports, strict=True):
        if each is not None:
            rows[part] = next(starts) + np.arange(each.shape[0]).reshape(rows[part].shape)
    near = _rows_at([each.near for each in there], rows.ravel())
    return Transport(near, _far_light(there, rows.ravel()), raster_of(cameras), projector)


def same_projectors(folders: Sequence[Path]) -> bool:
    """Return whether rooms seem to share projectors: equal monitor names, or no names and different camera sizes."""
    rooms = [calibrations.read(folder).calibration for folder in folders]
    shapes = [[device.shape for device in room.projectors] for room in rooms]
    if any(each != shapes[0] for each in shapes):
        return False
    names = {tuple(device.monitor for device in room.projectors) for room in rooms}
    if any(None in each for each in names):
        return any(room.camera.shape != rooms[0].camera.shape for room in rooms)
    return len(names) == 1


def check_projectors(rooms: Sequence[Calibration], folders: Sequence[Path]) -> None:
    """Raise InputError for projectors of different sizes, or with responses too far apart."""
    first, codes = rooms[0], np.repeat(np.linspace(0, 1, NODES)[:, None], 3, axis=1)
    for room, folder in zip(rooms[1:], folders[1:], strict=True):
        sizes = [" + ".join(f"{p.width}x{p.height}" for p in each.projectors) for each in (room, first)]
        if sizes[0] != sizes[1]:
            raise InputError(
                f"{folder}: projectors of {sizes[0]}, {folders[0]} has {sizes[1]}; cameras are joined that saw the same"
            )
        for number, pair in enumerate(zip(room.projectors, first.projectors, strict=True), 1):
            apart = np.abs(np.subtract(*(device.response.to_linear(codes) for device in pair))).max()
            if apart > MOST_APART:
                raise InputError(
                    f"{folder}: projector {number} has a response {100 * apart:.2g} % of white from that of "
                    f"{folders[0]}, expected at most {100 * MOST_APART:g}; give both one with --response"
                )


def _rows_of_rooms(rooms: Sequence[Calibration], cameras: tuple[tuple[int, int], ...]) -> NDArray[np.int64]:
    """Return each joint raster pixel's row in the stacked rooms; pixels outside cameras get the row after the last."""
    parts, ends = iter(parts_of(cameras)), np.cumsum([0, *(room.camera.pixels for room in rooms)])
    rows = np.full(raster_of(cameras), ends[-1])
    for room, start in zip(rooms, ends, strict=False):
        own = start + np.arange(room.camera.pixels).reshape(room.camera.shape)
        for view in room.views:
            rows[next(parts)] = own[view]
    return np.asarray(rows.ravel(), np.int64)


def _below(pictures: Sequence[NDArray[Any]], rows: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[Any]:
    """Arrange pictures of rooms in the joint raster; 0 outside cameras."""
    dark = np.zeros((1, *pictures[0].shape[2:]), pictures[0].dtype)
    flat = np.concatenate([*(each.reshape(-1, *each.shape[2:]) for each in pictures), dark])
    return np.asarray(flat[rows].reshape(*shape, *flat.shape[1:]))


def _primaries(
    rooms: Sequence[Calibration], rows: NDArray[np.int64], shape: tuple[int, int]
) -> NDArray[np.float32] | None:
    """Join the rooms' primaries; None unless every room has them."""
    found = [room.primaries for room in rooms if room.primaries is not None]
    if len(found) < len(rooms):
        return None
    return np.stack([_below([each[i] for each in found], rows, shape) for i in range(3)])


def _rows_at(parts: Sequence[SparseRows], rows: NDArray[np.int64]) -> SparseRows:
    """Stack the rooms' rows and an empty row, and return some of them."""
    return row_map.below_each_other([*parts, SparseRows.empty(1, parts[0].columns)]).at(rows)


def _far_light(transports: Sequence[Transport], rows: NDArray[np.int64]) -> FarLight | None:
    """Join far light; each room keeps its own cells, and a room without far light has none."""
    if all(transport.far is None for transport in transports):
        return None
    parts = [transport.far or _none(transport) for transport in transports]
    if all(_same_cells(part, parts[0]) for part in parts[1:]):
        return replace(parts[0], scatter=_rows_at([part.scatter for part in parts], rows))
    *starts, cells = itertools.accumulate((part.scatter.columns for part in parts), initial=0)
    scatters = [
        replace(part.scatter, indices=part.scatter.indices + start, columns=cells)
        for part, start in zip(parts, starts, strict=True)
    ]
    gather = row_map.below_each_other([part.gather for part in parts])
    return FarLight(gather, block_diagonal([part.mix for part in parts]), _rows_at(scatters, rows))


def _same_cells(part: FarLight, other: FarLight) -> bool:
    """Return whether two rooms share cells, as in one simulated room."""
    return equal(part.mix, other.mix) and equal(part.gather, other.gather)


def _none(transport: Transport) -> FarLight:
    """Return far light without cells."""
    camera, projector = transport.shape
    return FarLight(SparseRows.empty(0, projector), Dense(np.zeros((3, 0, 0))), SparseRows.empty(camera, 0))
