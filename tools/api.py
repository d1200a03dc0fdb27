"""Counterlight for notebooks: arrays in, arrays out, and folders only on request (docs/api.md).

`import counterlight as cl` gives these names; their dependencies are imported on first use.
Pictures are (height, width, 3), linear light; a picture to be shown is relative to the room's white.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from counterlight import calibration as calibrations
from counterlight import memory
from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError, shown
from counterlight.maps import room_maps as correction
from counterlight.maps.room_maps import RoomMaps
from counterlight.plots import panels
from counterlight.response import TABLE_SIZE, Response, transfer_table
from counterlight.tools import arguments
from counterlight.tools.acquisition.matrices_room import brighter_ambient, keep_light
from counterlight.tools.acquisition.room_options import ASSUMED
from counterlight.tools.arguments import Shape, in_python
from counterlight.tools.choices import (
    BLUR_TOLERANCE,
    COLOURS,
    INVERSES,
    MOST_TOLERANCE,
    TOLERANCE,
)
from counterlight.tools.clusters.decomposition import Parameters
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.factoring.factoring import compacted
from counterlight.tools.linear_operator import TransportOperator
from counterlight.tools.shipped import parse_scene
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.objective import DEFAULT_AIMS, Objective, objective_of
from counterlight.tools.transport.pixel_order import misreading
from counterlight.tools.transport.storage import check_entries, check_shape, read_transport, write_transport
from counterlight.tools.transport.transport import CHANNELS, Csr, Transport, luminance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BYTES_OF_A_PIXEL = 100  # upper bound per pixel while a picture is read
READ_ROOM = "make one with read_room, simulate or Room.from_matrices"
READ = "camera and projector are (height, width), and pixels are numbered row by row"


@dataclass(frozen=True, eq=False)
class Room:
    """A projector, a camera, and the light between them: camera = transport @ projector + ambient.

    Camera pictures are in screen primaries: the light that a neutral surface would show of each primary. Two rooms are
    equal only if they are the same object.

    calibration : sizes, responses, ambient light, mask, and floodlights of the primaries.
    parts : the parts of T of white light: near light, and blurred and far light if any.
    colour : the primaries that a camera channel sees: auto, independent, global or pixel (docs/colour.md).
    """

    calibration: Calibration
    parts: Transport
    colour: str = "auto"

    def __post_init__(self) -> None:
        arguments.instance(self.calibration, Calibration, "calibration")
        arguments.instance(self.parts, Transport, "parts")
        arguments.choice(self.colour, "colour", COLOURS)
        expected = self.calibration.camera.pixels, self.calibration.projector.pixels
        if self.parts.shape != expected:
            raise InputError(f"T of shape {self.parts.shape}, the calibration is for {expected}")

    def __repr__(self) -> str:
        sizes = f"camera {self.camera}, projector {self.projector}"
        return f"<Room {shown(self.calibration.name)}: {sizes}, {self.parts!r}>"

    @classmethod
    @in_python(tolerance="factor")
    def from_matrices(
        cls,
        red: object,
        green: object,
        blue: object,
        *,
        camera: Shape,
        projector: Shape,
        ambient: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        response: str | float | Response | PathLike[str] | None = None,
        primaries: ArrayLike | None = None,
        colour: str = "auto",
        name: str = "room",
        factor: float = TOLERANCE,
    ) -> Self:
        """Make a room from T of three channels.

        red, green, blue : (camera pixels, projector pixels). Anything that scipy converts to a sparse array; pixels in
            rows from the top. Negative entries are measurement noise and are set to 0, with a warning if they hold more
            than 1 % of the light. Entries are stored as float32.
        camera, projector : (height, width). Warns if T is smooth only for swapped sizes.
        ambient : camera picture with a black projector, in T's unit of light; None for darkness.
        mask : (height, width). Camera pixels that count; None for those that the projector lights.
        response : the projector's light per code value: linear, srgb, a gamma, a .toml file of `counterlight
            fit-response`, or a Response. None takes sRGB and warns that this is a guess, which makes code values wrong.
        primaries : (3, height, width, 3). Camera pictures of full red, green and blue, without ambient light.
        factor : dB of the camera picture that compensated pictures may lose when a dense T becomes near light and
            factors of far light, and long rows become blocks of projector pixels; 0 keeps T unfactored. Factoring
            a large dense T can take minutes, without output.

        Raises InputError for matrices of the wrong size, without light, or with NaN or infinity.
        """
        camera, projector = arguments.size(camera, "camera"), arguments.size(projector, "projector")
        factor = arguments.number(factor, "factor", 0, MOST_TOLERANCE)
        arguments.instance(name, str, "name")
        eye, lamp = Device(*camera, Response("linear")), Device(*projector, _given_or_assumed(response))
        shape = eye.pixels, lamp.pixels
        channels = list[Csr]()
        for matrix, of in zip((red, green, blue), CHANNELS, strict=True):
            channels.append(_channel(matrix, of, shape))
        transport = Transport.from_matrices(channels, camera=camera, projector=projector)
        light = arguments.radiance(0.0 if ambient is None else ambient, camera, "ambient")
        given = None if mask is None else arguments.mask(mask, camera)
        if (reading := misreading(transport.near, camera, projector)) is not None:
            warnings.warn(f"{reading.described(str)}; {READ}", stacklevel=3)
        transport, _ = compacted(transport, light, factor)
        counts = directly_lit(transport, light, projector) if given is None else given
        if not counts.any():
            raise InputError(
                "no camera pixel is lit by the projector; check ambient's unit against T's, or give a mask"
            )
        if (doubt := brighter_ambient(transport, light, counts)) is not None:
            warnings.warn(doubt, stacklevel=3)
        measured = None if primaries is None else _primaries(primaries, camera)
        calibration = Calibration(name, "made of matrices in Python", (lamp,), eye, light, counts, measured)
        return cls(calibration, transport, colour)

    @property
    def camera(self) -> Shape:
        """(height, width) of camera pictures."""
        return self.calibration.camera.shape

    @property
    def projector(self) -> Shape:
        """(height, width) of projector pictures."""
        return self.calibration.projector.shape

    @property
    def ambient(self) -> NDArray[np.float32]:
        return self.calibration.ambient

    @property
    def mask(self) -> NDArray[np.bool_]:
        return self.calibration.mask

    @cached_property
    @in_python()
    def tier(self) -> Tier:
        """The room in screen primaries; `str` gives its colour tier and the reason for it."""
        return tier_of(self.calibration, self.parts, self.colour)

    @cached_property
    @in_python()
    def lit(self) -> BoolArray:
        """The camera pixels that `solve` uses and figures refer to, (camera height, camera width).

        The floodlight exceeds 1 % of its 99th percentile there. These pixels are inside the mask, or the edge of the
        projector's picture cuts their footprint.
        """
        return self._objective.lit_picture(self.calibration)

    @cached_property
    def _objective(self) -> Objective:
        """The player's objective, with weights and priors."""
        return objective_of(self.tier.transport, self.tier.calibration, DEFAULT_AIMS, self.tier.mixing)

    @cached_property
    def transport(self) -> TransportOperator:
        """T as a scipy LinearOperator; `@` takes a picture (projector height, projector width, 3) or a flattened one.

        T leaves out ambient light. `T.channel(k)` is one channel, and `T.to_csr()` a sparse matrix.
        """
        return TransportOperator(replace(self.parts, camera=self.camera, projector=self.projector))

    @property
    def white(self) -> float:
        """Radiance of a white picture that most of the room can reach."""
        return self.tier.white

    @cached_property
    def floodlight(self) -> FloatArray:
        """Camera picture under a white projector: T·1 + e if channels are independent."""
        return self.seen(1.0)

    @in_python()
    def seen(self, drive: ArrayLike) -> FloatArray:
        """Returns the camera picture under a projector picture: T p + e if channels are independent.

        drive : (projector height, projector width, 3). Linear light as floats, or sRGB code values (`solve`).
        """
        return self.tier.seen(arguments.picture(drive, self.projector, "drive", of_white=True))

    def plot(self) -> Figure:
        """Draw the room under full light and without the projector, what counts, and T's entries (needs matplotlib)."""
        brightest = np.percentile(self.floodlight, 99)
        return panels(
            f"{self.calibration.name}: camera {self.camera}, projector {self.projector}",
            {
                "full light": _srgb(self.floodlight / brightest),
                "ambient light, % of white": 100 * _grey(self.tier.ambient) / self.white,
                "camera pixels that count (mask)": self.mask,
                "entries of near light per camera pixel": self.parts.near.lengths.reshape(self.camera),
            },
        )

    @in_python()
    def write(self, folder: PathLike[str] | str, *, maps: RoomMaps | None = None, force: bool = False) -> None:
        """Write a calibration folder, with `maps` if given; the folder appears whole or not at all."""
        target = arguments.path(folder, "folder")
        if maps is not None:
            check_maps(self, maps)
        with calibrations.replacing(target, force=arguments.instance(force, bool, "force")) as stage:
            write_transport(self.parts, stage)
            calibrations.write(self.calibration, stage)
            if maps is not None:
                (stage / correction.FOLDER).mkdir()
                correction.write_maps(maps, calibrations.read(stage), stage / correction.FOLDER)


@dataclass(frozen=True, eq=False)
class Solution:
    """A projector picture for a camera picture.

    drive : (projector height, projector width, 3). 0 to 1, linear light.
    seen : camera picture under the drive.
    below_optimum : upper bound, from the gradient, on how many dB `seen` is below the best drive's picture.
    target : the requested camera picture, in the unit of `seen`.
    white : radiance of the picture's white.
    """

    drive: FloatArray
    seen: FloatArray
    below_optimum: float
    target: FloatArray
    white: float

    def __repr__(self) -> str:
        bound = f"at most {self.below_optimum:.2g} dB below the optimum"
        return f"<Solution: drive {self.drive.shape}, seen {self.seen.shape}, {bound}>"

    @property
    def error(self) -> FloatArray:
        """What is seen minus the target, as a share of white, (camera height, camera width, 3)."""
        return (self.seen - self.target) / self.white

    def plot(self) -> Figure:
        """Draw the drive, the target, what is seen, and the error of its luminance (needs matplotlib)."""
        gain = max(1.0, 1 / max(float(np.percentile(self.target, 99)) / self.white, 0.01))  # shows dark targets, too
        times = f", {gain:.2g} times as bright" if gain > 1 else ""
        return panels(
            repr(self).strip("<>"),
            {
                f"target{times}": _srgb(gain * self.target / self.white),
                f"seen by the camera{times}": _srgb(gain * self.seen / self.white),
                "error of luminance, % of white": 100 * _grey(self.error),
                "drive of the projector": _srgb(self.drive),
            },
        )


@in_python()
def read_room(folder: PathLike[str] | str) -> Room:
    """Read a calibration folder; InputError for missing or damaged files."""
    stored = calibrations.read(arguments.path(folder, "folder"))
    return Room(stored.calibration, read_transport(stored))


@in_python()
def read_maps(folder: PathLike[str] | str) -> RoomMaps:
    """Read the maps of a calibration folder that `counterlight build` or `Room.write` wrote."""
    return correction.read_maps(calibrations.read(arguments.path(folder, "folder")))


@in_python()
def read_picture(path: PathLike[str] | str, where: Shape | Room) -> FloatArray:
    """Read the first picture of a medium in linear light, fitted as the player fits it.

    where : (height, width), or a room, whose camera or shared screen gives the size.
    """
    from counterlight.tools.relighting.pictures import read_placed

    source = arguments.path(path, "path")
    if isinstance(where, Room):
        return read_placed(source, where.camera, where.calibration.screen)
    height, width = arguments.size(where, "where")
    memory.check(BYTES_OF_A_PIXEL * height * width, f"where={(height, width)}: a picture of that size", "ask for less")
    return read_placed(source, (height, width))


@in_python()
def simulate(
    scene: PathLike[str] | str,
    *,
    camera: Shape | None = None,
    projector: Shape | None = None,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    within: float | None = None,
    tolerance: float = BLUR_TOLERANCE,
) -> Room:
    """Simulate a room from a scene: a file, or the name of a shipped scene.

    camera, projector : (height, width); None for the scene's sizes.
    without, only : effects to leave out, or to keep.
    within : dB of the final picture that may be lost by leaving out expensive effects.
    tolerance : dB that pictures may lose where rows of T are too long for maps; 0 keeps all rows.
    """
    from counterlight.tools.simulation import simulate as simulation
    from counterlight.tools.simulation.needs import chosen, needs_of
    from counterlight.tools.simulation.room import simulated_room
    from counterlight.tools.simulation.scene import load_scene
    from counterlight.tools.study.worth import priced

    file = parse_scene(str(arguments.path(scene, "scene")))
    camera, projector = (
        None if given is None else arguments.size(given, name)
        for given, name in ((camera, "camera"), (projector, "projector"))
    )
    within = None if within is None else arguments.number(within, "within", 0, np.inf)
    tolerance = arguments.number(tolerance, "tolerance", 0, MOST_TOLERANCE)
    off, kept = arguments.words(without, "without"), arguments.words(only, "only")
    described = load_scene(file).resized(camera, projector)
    results = []
    for view in described.views:
        needs = chosen(needs_of(view), off, kept)
        needs = needs if within is None else priced(view, needs, within)
        results.append(simulation.simulate(view, needs, tolerance=tolerance))
    return Room(*simulated_room(described, results))


@in_python()
def solve(
    room: Room,
    picture: ArrayLike,
    solver: str = "box",
    *,
    white: float | None = None,
    colour: str | None = None,
    priors: bool = False,
) -> Solution:
    """Compute a projector picture with a CPU solver (docs/solvers.md).

    picture : (camera height, camera width, 3). Floats are linear light as shares of `white`; uint8 and uint16 are sRGB
        code values, as `counterlight play` reads them from a file. One colour (3,) or one number fills the picture.
    white : a radiance; None takes the room's white.
    solver : box (the best that a projector can show), nnls, svd, qr, direct or triangulated, over the lit camera
        pixels; drives outside 0..1 are clamped.
    colour : replaces the room's colour.
    priors : box minimises the player's objective, with its weights and priors, instead of plain least squares.
    """
    from counterlight.tools.solve.registry import OF_PICTURES, SOLVERS, prepare

    arguments.choice(solver, "solver", SOLVERS | OF_PICTURES)
    arguments.instance(priors, bool, "priors")
    coloured = _coloured(room, colour)
    tier, objective = coloured.tier, coloured._objective
    wanted = arguments.picture(picture, room.camera, "picture", of_white=white is None)
    radiance = arguments.white(white, tier.white)
    target = wanted * radiance
    b = tier.target(target)
    T = replace(tier.transport, camera=room.camera, projector=room.projector)
    drive = np.clip(prepare(solver, T, coloured.lit, objective if priors else None).solve(b).unclamped, 0, 1)
    bound = objective.unweighted.certificate(drive, b.reshape(-1, 3))
    shown = drive.reshape(*room.projector, 3)
    return Solution(shown, tier.seen(shown), bound.decibels, target, radiance)


@in_python()
def build_maps(
    room: Room,
    *,
    refine: bool = True,
    colour: str | None = None,
    damping: float | None = None,
    max_error: float | None = None,
    max_cluster: int | None = None,
    noise: float | None = None,
    inverse: str | None = None,
    tau: float | None = None,
    parameters: Parameters | None = None,
) -> RoomMaps:
    """Build the maps by which the player multiplies, as `counterlight build` does.

    refine : whether to include the maps that only refinement needs.
    colour : replaces the room's colour.
    damping, max_error, … : see counterlight.tools.inverse.near_light.InverseOptions; None takes the default.
    """
    from counterlight.tools.inverse.build import build_maps as build
    from counterlight.tools.inverse.near_light import InverseOptions

    tier = _coloured(room, colour).tier
    checks: dict[str, tuple[Any, ...]] = {
        "damping": (damping, arguments.number, 0, 1),
        "max_error": (max_error, arguments.number, 0, 255),
        "max_cluster": (max_cluster, arguments.whole, 1, tier.calibration.projector.pixels),
        "noise": (noise, arguments.number, 0, 1),
        "inverse": (inverse, arguments.choice, INVERSES),
        "tau": (tau, arguments.number, 0, 1),
    }
    given = {name: check(value, name, *known) for name, (value, check, *known) in checks.items() if value is not None}
    if parameters is not None:
        given["parameters"] = arguments.instance(parameters, Parameters, "parameters")
    arguments.instance(refine, bool, "refine")
    return build(tier, InverseOptions(**given), refine=refine).maps


def check_maps(room: Room, maps: RoomMaps) -> None:
    """Raises InputError if the sizes of maps differ from the room's."""
    arguments.instance(room, Room, "room", READ_ROOM)
    arguments.instance(maps, RoomMaps, "maps", "make some with build_maps(room), or read_maps(folder)")
    found, expected = (maps.transport.output_shape, maps.transport.source_shape), (room.camera, room.projector)
    if found != expected:
        raise InputError(
            f"maps: for camera {found[0]} and projector {found[1]}, the room has camera {expected[0]} and projector "
            f"{expected[1]}; build_maps(room) makes the room's"
        )


def _srgb(linear_rgb: FloatArray) -> FloatArray:
    """Encodes linear light as sRGB code values from 0 to 1."""
    return np.interp(linear_rgb, transfer_table("srgb"), np.linspace(0, 1, TABLE_SIZE))


def _grey(linear_rgb: NDArray[np.floating]) -> FloatArray:
    """Returns the luminance of a picture, (height, width)."""
    return luminance(linear_rgb.reshape(-1, 3)).reshape(linear_rgb.shape[:2])


def _coloured(room: Room, colour: str | None) -> Room:
    arguments.instance(room, Room, "room", READ_ROOM)
    if colour is None or arguments.choice(colour, "colour", COLOURS) == room.colour:
        return room
    return replace(room, colour=colour)


def _primaries(light: ArrayLike, camera: Shape) -> NDArray[np.float32]:
    """Check pictures of red, green and blue as `Room.from_matrices` takes them."""
    several = light if isinstance(light, list | tuple) else np.atleast_1d(arguments.real_array(light, "primaries"))
    pictures = [arguments.real_array(each, "primaries") for each in several]
    expected, shapes = (3, *camera, 3), dict.fromkeys((len(pictures), *each.shape) for each in pictures)
    if list(shapes) != [expected]:
        found = " and ".join(map(str, shapes)) or "()"
        raise InputError(f"primaries of shape {found}, expected {expected}: pictures of red, green, blue")
    radiances = np.stack([arguments.radiance(each, camera, "primaries") for each in pictures])
    if dark := [name for name, picture in zip(CHANNELS, radiances, strict=True) if not picture.any()]:
        raise InputError(f"primaries: no light under full {' and '.join(dark)}; give all three pictures, or none")
    return radiances


def _channel(matrix: object, colour: str, shape: Shape) -> Csr:
    """Returns a channel of T as sparse rows, float32, without negative entries and zeros."""
    name = f"T of the {colour} channel"
    given = getattr(matrix, "shape", ())
    if isinstance(given, tuple) and len(given) == 2:
        check_shape(given, shape, name)  # before the conversion, which takes long for a large dense matrix
    channel = arguments.matrix(matrix, name)
    check_shape(channel.shape, shape, name)
    check_entries(channel.data, name)
    if (doubt := keep_light(channel, name).doubt) is not None:
        warnings.warn(f"{name}: {doubt}", stacklevel=4)
    return channel


def _given_or_assumed(response: object) -> Response:
    if response is None:
        warnings.warn("response: sRGB assumed; measure it, and give it as response=…", stacklevel=4)
        return ASSUMED
    return arguments.response(response)
