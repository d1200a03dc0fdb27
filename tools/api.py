"""Counterlight in a notebook: arrays in, arrays out, and a folder only where one is wanted (docs/api.md).

`import counterlight as cl` gives these names; what they need is imported when they are first used.
Pictures are (height, width, 3), linear light; a picture to be shown is in shares of the room's white.
"""

import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from counterlight import calibration as calibrations
from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError, nearest
from counterlight.maps import room_maps as correction
from counterlight.maps.room_maps import RoomMaps
from counterlight.pipeline.refinement import Certificate
from counterlight.response import Response, parse_response
from counterlight.tools.acquisition.matrices_room import keep_light
from counterlight.tools.acquisition.room_options import ASSUMED
from counterlight.tools.choices import BLUR_TOLERANCE, PRESETS, TOLERANCE
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.factoring.factoring import compacted
from counterlight.tools.shipped import parse_scene
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.pixel_order import misreading
from counterlight.tools.transport.storage import check_entries, read_transport, write_transport
from counterlight.tools.transport.transport import CHANNELS, Csr, Transport

Shape: TypeAlias = tuple[int, int]
READ = "camera and projector are (height, width), and pixels are numbered row by row"


@dataclass(frozen=True)
class Room:
    """A projector, a camera, and the light between them: camera = transport @ projector + ambient.

    calibration : sizes, responses, ambient light, mask, floodlights of the primaries.  transport : T, of white light.
    colour : which primaries a camera channel is taken to see: auto, independent, global or pixel (docs/colour.md).
    Pictures of the camera are in screen primaries: what a neutral surface would show of each primary.
    """

    calibration: Calibration
    transport: Transport
    colour: str = "auto"

    @classmethod
    def from_matrices(
        cls,
        red: Any,
        green: Any,
        blue: Any,
        *,
        camera: Shape,
        projector: Shape,
        ambient: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        response: str | float | Response | None = None,
        primaries: ArrayLike | None = None,
        colour: str = "auto",
        name: str = "room",
        factor: float = TOLERANCE,
    ) -> Self:
        """A room from T of three channels.

        red, green, blue : (camera pixels, projector pixels), anything that scipy makes a sparse array of; pixels in
            rows from the top. Negative entries, a measurement's noise, are set to 0.
        camera, projector : (height, width).  ambient : the camera's picture with a black projector, None for darkness.
        mask : (height, width), which camera pixels count; None for those that the projector lights.
        response : the projector's light for a code value: linear, srgb, a gamma, or a Response. None takes sRGB, and
            warns that this is a guess: codes that are made from it will be off.
        primaries : (3, height, width, 3), the camera's pictures of full red, green and blue, without ambient light.
        factor : a dense T becomes near light and factors of far light, long rows blocks of projector pixels; what
            compensated pictures may lose by that, in dB of the camera's picture; 0 keeps T as it is.
        Raises InputError for matrices that do not fit, have no light, or numbers that are none.
        """
        eye, lamp = Device(*camera, Response("linear")), Device(*projector, _given_or_assumed(response))
        shape = eye.pixels, lamp.pixels
        channels = [_channel(*each, shape) for each in zip((red, green, blue), CHANNELS, strict=True)]
        transport = Transport.from_matrices(channels, camera=camera, projector=projector)
        if (doubt := misreading(transport.near, camera, projector)) is not None:
            warnings.warn(f"{doubt.described(str)}; {READ}", stacklevel=2)
        light = _picture(np.zeros(3) if ambient is None else ambient, camera, "ambient").astype(np.float32)
        transport, _ = compacted(transport, light, factor)
        counts = directly_lit(transport, light, projector) if mask is None else np.array(mask, bool)
        if counts.shape != camera or not counts.any():
            raise InputError(
                f"mask of shape {counts.shape}, {counts.sum()} pixels count: expected {camera}, at least 1"
            )
        measured = None if primaries is None else _primaries(primaries, camera)
        calibration = Calibration(name, "made of matrices in Python", (lamp,), eye, light, counts, measured)
        return cls(calibration, transport, colour)

    @property
    def camera(self) -> Shape:
        """(height, width) of the camera's pictures."""
        return self.calibration.camera.shape

    @property
    def projector(self) -> Shape:
        """(height, width) of the projector's pictures."""
        return self.calibration.projector.shape

    @property
    def ambient(self) -> NDArray[np.float32]:
        return self.calibration.ambient

    @property
    def mask(self) -> NDArray[np.bool_]:
        return self.calibration.mask

    @cached_property
    def tier(self) -> Tier:
        """The room as its channels nearly decouple; `str` says which tier of colour it is, and why."""
        return tier_of(self.calibration, self.transport, self.colour)

    @property
    def white(self) -> float:
        """The radiance of a white picture that most of the room can reach."""
        return self.tier.white

    @cached_property
    def floodlight(self) -> FloatArray:
        """What the camera sees of a white projector: T·1 + e where channels are independent."""
        return self.seen(1.0)

    def seen(self, drive: ArrayLike) -> FloatArray:
        """What the camera sees of a projector picture: T p + e where channels are independent."""
        return self.tier.seen(_picture(drive, self.projector, "a projector picture"))

    def write(self, folder: Path | str, *, maps: RoomMaps | None = None, force: bool = False) -> None:
        """Write a calibration folder, with its maps if they are given; it appears whole or not at all."""
        target = Path(folder)
        with calibrations.writing(target, self.calibration, force=force) as stage:
            write_transport(self.transport, stage)
        if maps is not None:
            stored = calibrations.read(target)
            with correction.replacing(stored) as stage:
                correction.write_maps(maps, stored, stage)


@dataclass(frozen=True)
class Solution:
    """A projector picture for a camera picture.

    drive : (projector height, projector width, 3), 0..1, linear light.  seen : what the camera sees of it.
    below_optimum : decibels that `seen` can at most be below what the best drive would reach, from the gradient.
    """

    drive: FloatArray
    seen: FloatArray
    below_optimum: float


def read_room(folder: Path | str) -> Room:
    """A calibration folder; InputError for what is missing or damaged."""
    stored = calibrations.read(Path(folder))
    return _room(stored.calibration, read_transport(stored))


def read_maps(folder: Path | str) -> RoomMaps:
    """The maps of a calibration folder, as `counterlight build` or `Room.write` left them."""
    return correction.read_maps(calibrations.read(Path(folder)))


def read_picture(path: Path | str, where: Shape | Room) -> FloatArray:
    """The first picture of a medium in linear light, fitted as the player fits it.

    where : (height, width), or a room, for whose camera the picture then is, or for its cameras' screen.
    """
    from counterlight.tools.relighting.pictures import read_placed

    if isinstance(where, Room):
        return read_placed(Path(path), where.camera, where.calibration.screen)
    return read_placed(Path(path), where)


def simulate(
    scene: Path | str,
    *,
    camera: Shape | None = None,
    projector: Shape | None = None,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    within: float | None = None,
    tolerance: float = BLUR_TOLERANCE,
) -> Room:
    """A room from a scene: a file, or the name of a shipped one.

    camera, projector : (height, width), None for the scene's own.  without, only : effects to leave out, or to keep.
    within : decibels of the final picture that may be lost by leaving out what costs time.
    tolerance : dB that pictures may lose where rows of T are too long for maps; 0 leaves all as they are.
    """
    from counterlight.tools.simulation import simulate as simulation
    from counterlight.tools.simulation.needs import chosen, needs_of
    from counterlight.tools.simulation.room import simulated_room
    from counterlight.tools.simulation.scene import load_scene
    from counterlight.tools.study.worth import priced

    described = load_scene(parse_scene(str(scene))).resized(camera, projector)
    results = []
    for view in described.views:
        needs = chosen(needs_of(view), without, only)
        needs = needs if within is None else priced(view, needs, within)
        results.append(simulation.simulate(view, needs, tolerance=tolerance))
    return _room(*simulated_room(described, results))


def solve(
    room: Room, picture: ArrayLike, solver: str = "box", *, white: float | None = None, colour: str | None = None
) -> Solution:
    """A projector picture by a CPU solver (docs/solvers.md).

    picture : (camera height, camera width, 3), in shares of `white`, a radiance; None takes the room's.
    solver : box (the best that a projector can show), nnls, svd, qr, direct or triangulated; what is
    beyond 0..1 is clamped.
    colour : instead of the room's.
    """
    from counterlight.tools.solve.registry import OF_PICTURES, SOLVERS, prepare

    known = SOLVERS | OF_PICTURES
    if solver not in known:
        raise InputError(f"solver {solver!r}: expected one of {', '.join(known)}{nearest(solver, known)}")
    tier = _coloured(room, colour).tier
    b = tier.asked(_picture(picture, room.camera, "a picture") * (tier.white if white is None else white))
    objective = objective_of(tier.transport, tier.calibration, DEFAULT_AIMS, tier.mixing)
    T = replace(tier.transport, camera=room.camera, projector=room.projector)
    drive = np.clip(prepare(solver, T, room.mask, objective).solve(b).unclamped, 0, 1)
    bound = objective.certificate(drive, b.reshape(-1, 3))
    shown = drive.reshape(*room.projector, 3)
    return Solution(shown, tier.seen(shown), bound.decibels)


def build_maps(
    room: Room, preset: str | None = None, *, refine: bool = True, colour: str | None = None, **options: Any
) -> RoomMaps:
    """The maps that the player multiplies with, as `counterlight build` makes them.

    preset : fast, balanced or best.  options : damping, max_error, max_cluster, parameters, noise, method, inverse,
    which prevail (counterlight.tools.inverse.near_light.InverseOptions).  refine : with what only refinement needs.
    colour : instead of the room's.
    """
    from counterlight.tools.inverse import presets
    from counterlight.tools.inverse.build import build_maps as build
    from counterlight.tools.inverse.near_light import InverseOptions

    if preset is not None and preset not in PRESETS:
        raise InputError(f"preset {preset!r}: expected one of {', '.join(PRESETS)}{nearest(preset, PRESETS)}")
    if options.get("max_cluster") is not None or options.get("parameters") is not None:
        options = {"inverse": "cut"} | options
    wanted = replace(InverseOptions() if preset is None else presets.PRESETS[preset], **options)
    return build(_coloured(room, colour).tier, wanted, refine=refine).maps


class Renderer:
    """The player's renderer without a window, for pictures of the camera's size; a context manager.

    backend : "gl", OpenGL through EGL, "cpu", or "auto": "gl" where there is a GPU.  white : radiance of a white
    picture; None takes the maps'.
    """

    def __init__(self, room: Room, maps: RoomMaps, *, backend: str = "gl", white: float | None = None) -> None:
        from counterlight.pipeline.room import Room as Rendered
        from counterlight.pipeline.room import start_of
        from counterlight.show.headless import headless_renderer

        self._white = maps.white if white is None else white
        self._room = Rendered(room.calibration, maps, self._white, start=start_of(maps))
        self._stack = ExitStack()
        self._renderer = self._stack.enter_context(headless_renderer(backend, self._room))
        self._steps: int | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def render(self, picture: ArrayLike, *, refine: int | None = None) -> FloatArray:
        """The projector picture for a camera picture: (projector height, projector width, 3), 0..1, linear light.

        picture : (camera height, camera width, 3), in shares of white.  refine : steps; None for the usual number.
        """
        from counterlight.media.frames import radiance_frame

        desired = _picture(picture, self._room.calibration.camera.shape, "a picture") * self._white
        frame = radiance_frame(np.asarray(self._room.maps.mixing.as_radiance(desired), np.float64))
        if self._steps is None:
            self._renderer.open(frame.format)
        self._steps = self._room.default_steps if refine is None else refine
        self._renderer.upload(frame)
        return self._view("projector")

    def camera_view(self) -> FloatArray:
        """What the camera will see of the picture rendered last, by the maps."""
        return self._view("camera")

    def certificate(self) -> Certificate | None:
        """How far the picture rendered last can be from the best one; None without the maps of refinement."""
        return self._renderer.certificate()

    def close(self) -> None:
        self._stack.close()

    def _view(self, view: str) -> FloatArray:
        if self._steps is None:
            raise InputError("nothing has been rendered; call render first")
        self._renderer.render(view, compensate=True, steps=self._steps)
        return np.array(self._renderer.linear(), np.float64)


def _coloured(room: Room, colour: str | None) -> Room:
    return room if colour is None or colour == room.colour else replace(room, colour=colour)


def _primaries(light: ArrayLike, camera: Shape) -> NDArray[np.float32]:
    pictures = np.asarray(light, np.float32)
    if pictures.shape != (3, *camera, 3):
        raise InputError(
            f"primaries of shape {pictures.shape}, expected {(3, *camera, 3)}: pictures of red, green, blue"
        )
    return pictures


def _room(calibration: Calibration, transport: Transport) -> Room:
    camera, projector = calibration.camera.shape, calibration.projector.shape
    return Room(calibration, replace(transport, camera=camera, projector=projector))


def _channel(matrix: Any, colour: str, shape: Shape) -> Csr:
    """A channel of T as sparse rows, float32, without what is not light."""
    channel = Csr(matrix, dtype=np.float32, copy=True)
    channel.sum_duplicates()
    if channel.shape != shape:
        raise InputError(
            f"T of the {colour} channel: {channel.shape[0]}x{channel.shape[1]} entries, expected {shape[0]} camera "
            f"pixels (rows) x {shape[1]} projector pixels (columns)"
        )
    check_entries(channel.data, f"T of the {colour} channel")
    keep_light(channel, f"T of the {colour} channel")
    return channel


def _given_or_assumed(response: str | float | Response | None) -> Response:
    if response is None:
        warnings.warn("response: sRGB assumed; measure it, and give it as response=…", stacklevel=3)
        return ASSUMED
    return response if isinstance(response, Response) else parse_response(response)


def _picture(values: ArrayLike, shape: Shape, what: str) -> FloatArray:
    """(height, width, 3) of what can be broadcast to it; InputError for another size, or numbers that are none."""
    array = np.asarray(values, np.float64)
    try:
        picture = np.broadcast_to(array, (*shape, 3))
    except ValueError:
        raise InputError(f"{what} of shape {array.shape}, expected {(*shape, 3)}") from None
    if not np.isfinite(picture).all():
        raise InputError(f"{what} holds NaN or infinity; leave them out")
    return picture
