"""Joins views of one room, calibrated one at a time from different places, as a set for moving viewers (thesis 6.4).

Each view remains a separate calibration. The views share a screen, so that a picture stays in place on the wall, and
the first view's exposure.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from counterlight import calibration as calibrations
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.pipeline.views_together import check_views
from counterlight.screen import Screen
from counterlight.tools.factoring.factoring import factored
from counterlight.tools.joining.cameras import CameraOptions, check_projectors, joined_cameras
from counterlight.tools.joining.shared_screen import Placed, brightened
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Transport
from counterlight.viewpoints import Places, folders_of, is_set, write_places

View = tuple[Calibration, Transport]


def join_views(
    folders: Sequence[Path],
    places: Places,
    output: Path,
    options: CameraOptions,
    monitors: Sequence[str] = (),
    *,
    name: str | None = None,
    force: bool = False,
) -> str:
    """Write a set of views from several calibrations; returns a summary and a line per view.

    Raises InputError for differing projectors or cameras, and for views that share nothing.
    """
    if len(folders) != len(places.at):
        raise InputError(f"{len(folders)} calibrations, {len(places.at)} places; give --at X[,Y] once for each")
    with calibrations.replacing(output, force=force, inputs=folders) as stage:
        for folder in folders:
            if is_set(folder):
                raise InputError(f"{folder}: is a set of views already; give the calibrations that it was made of")
        stored = [calibrations.read(folder) for folder in folders]
        check_projectors([one.calibration for one in stored], folders)
        made = [factored(read_transport(one), one.calibration.ambient, options.tolerance)[0] for one in stored]
        views, placed = on_shared_screen(
            [one.calibration for one in stored], made, name or output.name, options, monitors
        )
        write_views(views, places, stage)
    words = [f"{output}: {described(views)}", *(str(each).replace("camera", "view", 1) for each in placed)]
    return "\n".join(words)


def on_shared_screen(
    rooms: Sequence[Calibration],
    transports: Sequence[Transport],
    name: str,
    options: CameraOptions,
    monitors: Sequence[str] = (),
) -> tuple[list[View], tuple[Placed, ...]]:
    """Return each view separately, placed and scaled in brightness as a camera of a joined room (shared_screen.py)."""
    for number, room in enumerate(rooms, 1):
        if room.screen is not None:
            raise InputError(f"view {number} is of {len(room.cameras)} cameras; a view has one, join views of one each")
    if len(rooms) == 1:
        return [(replace(rooms[0], name=name), transports[0])], ()
    check_views(rooms, name)
    shared = joined_cameras(rooms, transports, name, options, monitors)
    whole, screen = shared.calibration, shared.calibration.screen
    assert screen is not None
    views = []
    for room, transport, part, gain in zip(rooms, transports, screen.parts, whole.gains, strict=True):
        gains = np.tile(gain, (room.camera.pixels, 1))
        own = Screen(screen.shape, (room.camera.shape,), screen.positions[part], gain[None])
        placed = replace(brightened(room, gains), name=name, projectors=whole.projectors, screen=own)
        views.append((placed, transport.scaled(gains)))
    return views, shared.placed


def write_views(views: Sequence[View], places: Places, stage: Path) -> None:
    """Write a set of views to a staging folder."""
    folders = folders_of(stage, len(views))
    for (room, transport), folder in zip(views, folders, strict=True):
        folder.mkdir(parents=True)
        write_transport(transport, folder)
        calibrations.write(room, folder)
    write_places(stage, places, [folder / calibrations.TOML for folder in folders])


def described(views: Sequence[View]) -> str:
    """Describe views and screen in words."""
    room = views[0][0]
    (height, width), camera = room.placed_on, room.camera
    return f"{len(views)} views of {camera.width}x{camera.height}, screen {width}x{height}"
