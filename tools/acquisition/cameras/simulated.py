"""A camera in a simulated room: computes c = T p + e, then photon noise, exposure, response and code values."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight import calibration
from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.maps.mixing import mixed
from counterlight.raster import Shape, Shapes, side_by_side
from counterlight.response import RasterResponse, Response
from counterlight.tools.acquisition.cameras.camera import LINEAR, Exposures, Shot
from counterlight.tools.acquisition.cameras.live import LiveCamera, Screen
from counterlight.tools.acquisition.cameras.together import together
from counterlight.tools.acquisition.plan import Codes
from counterlight.tools.choices import MOST_LAG
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.shipped import parse_scene
from counterlight.tools.simulation.devices import Flicker, Sensor
from counterlight.tools.simulation.effects.capture_noise import capture
from counterlight.tools.simulation.effects.colour_filters import interpolated
from counterlight.tools.simulation.effects.flicker import gains
from counterlight.tools.simulation.effects.wander import gains as wandering
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import Transport

Refuse: TypeAlias = Callable[[str, Shapes, Sensor | None], None]

HEADROOM = 1.25  # full scale at an exposure of 1, relative to the floodlit room's brightest pixel


@dataclass(frozen=True)
class CameraSettings:
    """How a simulated camera takes pictures.

    exposures : exposures of a bracket; 1 puts the floodlit room's brightest pixel at 80 % of full scale.
    seed : capture n always has the noise of (seed, n), whatever was captured before.
    lag : frames until a picture reaches the sensor.
    known : whether the response was given. A camera with a curve of its own is otherwise measured.
    """

    sensor: Sensor = field(default_factory=Sensor)
    exposures: tuple[float, ...] = (1.0,)
    response: Response = LINEAR
    seed: int = 0
    lag: int = 0
    known: bool = field(default=True, repr=False)

    def __post_init__(self) -> None:
        if not 1 <= self.sensor.bits <= 16:
            raise InputError(f"--bits {self.sensor.bits}: expected 1 to 16")
        for option, value in (("--full-well", self.sensor.full_well), ("--read-noise", self.sensor.read_noise)):
            if not 0 <= value < float("inf"):
                raise InputError(f"{option} {value:g}: expected a number of electrons, 0 or more")
        if self.sensor.read_noise and not self.sensor.full_well:
            raise InputError("--read-noise needs --full-well above 0: it is counted in electrons of the full well")
        if not 0 <= self.lag <= MOST_LAG:
            raise InputError(f"--lag {self.lag}: expected 0 to {MOST_LAG} frames")
        if self.seed < 0:
            raise InputError(f"--seed {self.seed}: expected 0 or more")
        Exposures(self.exposures)


@dataclass(frozen=True)
class SimulatedRoom:
    """The room in front of the camera.

    ambient : (camera height, camera width, 3).
    projectors : (height, width) of each.
    response : response of their raster.
    mixing : (camera height, camera width, 3, 3), or (3, 3) for all pixels. What the camera's channels see of each
        primary's light; None if each channel sees only its own primary.
    sensor : the scene's sensor, if described.
    gain : (3,). Factor from the camera's own light to the light of the transport; None for 1.
    flicker : flicker of the projector's light; None for none.
    mosaic : the camera's colour filters; None for none.
    curve : the camera's curve; None for a camera that has the response of its settings.
    wander : standard deviation of the gain of a capture's channel.
    """

    name: str
    transport: Transport
    ambient: NDArray[np.float32]
    projectors: Shapes
    response: RasterResponse
    mixing: FloatArray | None = None
    sensor: Sensor | None = None
    gain: FloatArray | None = None
    flicker: Flicker | None = None
    mosaic: str | None = None
    curve: Response | None = None
    wander: float = 0.0

    @property
    def projector(self) -> Shape:
        """(height, width) of the raster."""
        return side_by_side(self.projectors)[0]

    def seen(self, drive: FloatArray, gains: FloatArray | float = 1.0) -> FloatArray:
        """Returns the camera's radiance, (camera height, camera width, 3).

        drive : (projector pixels, 3).
        gains : (rows, 1, 1). Gain of the projector's light per camera row.
        """
        light = self.transport.apply(drive).reshape(self.ambient.shape) * gains
        seen = (light if self.mixing is None else mixed(self.mixing, light)) + self.ambient
        return np.asarray(seen if self.gain is None else seen / self.gain)


class VisibleScreen(Screen, Protocol):
    """A screen that a simulated camera can look at."""

    def look(self) -> Codes:
        """Returns the picture that the screen shows now."""


class MemoryScreen:
    """A screen in memory, visible only to simulated cameras."""

    refresh_hz: float | None = None

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self._shown: Codes = np.zeros((*shape, 3), np.uint8)

    def show(self, codes: Codes) -> None:
        self._shown = codes

    def look(self) -> Codes:
        return self._shown


class SimulatedDevice:
    """A sensor in a simulated room that sees the screen `settings.lag` frames late.

    unit : time of an exposure of 1.
    """

    timed = False

    def __init__(self, room: SimulatedRoom, settings: CameraSettings, screen: VisibleScreen, unit: float = 1.0) -> None:
        self._room, self._settings, self._screen, self._unit = room, settings, screen, unit
        self._pictures = deque([screen.look()], settings.lag + 1)
        self._rng, self._time = np.random.default_rng(settings.seed), 1.0

    @property
    def name(self) -> str:
        return f"simulated {self._room.name}, {self._settings}"

    def begin(self, number: int) -> None:
        self._rng = np.random.default_rng((self._settings.seed, number))

    def expose(self, time: float) -> None:
        self._time = time

    def skip(self) -> None:
        self._pictures.append(self._screen.look())

    def last(self) -> Shot:
        return self._shot(self.radiance(self._pictures[0]) * self._time)

    def frame(self) -> Shot:
        self.skip()
        return self.last()

    def radiance(self, codes: Codes) -> FloatArray:
        """Returns T p + e for a picture's code values."""
        drive = self._room.response.to_linear(codes).reshape(-1, 3)
        flicker, rows = self._room.flicker, len(self._room.ambient)
        if flicker is None:
            return self._room.seen(drive)
        found = gains(flicker, self._settings.sensor, self._time / self._unit, rows, self._rng)
        return self._room.seen(drive, found[:, None, None])

    def _shot(self, light: FloatArray) -> Shot:
        """Returns code values of light, where 1 is full scale; the top code fills the container."""
        sensor, room = self._settings.sensor, self._room
        developed = None if room.mosaic is None else partial(interpolated, room.mosaic)
        if room.wander:
            light = light * wandering(room.wander, self._rng)
        codes = capture(light, sensor, room.curve or self._settings.response, self._rng, developed)
        return np.asarray(_container(sensor.bits).take(codes))


@cache
def _container(bits: int) -> Shot:
    """Returns the stored value of each code."""
    kind, codes = np.uint8 if bits <= 8 else np.uint16, np.arange(1 << bits)
    return np.asarray(np.rint(codes * (np.iinfo(kind).max / codes[-1])), kind)


class SimulatedCamera(LiveCamera):
    """The camera back end of a simulated room.

    screen : shows the projector's picture; None for a picture in memory.
    others : rooms as further cameras see them.
    """

    def __init__(
        self,
        room: SimulatedRoom,
        settings: CameraSettings,
        screen: VisibleScreen | None = None,
        others: Sequence[SimulatedRoom] = (),
    ) -> None:
        rooms, white = (room, *others), np.ones((room.transport.shape[1], 3))
        brightest = max(float(each.seen(white).max()) for each in rooms)
        unit = 1 / (HEADROOM * brightest)
        times = tuple(time * unit for time in settings.exposures)
        shown: VisibleScreen = MemoryScreen(room.projector) if screen is None else screen
        seeds = range(settings.seed, settings.seed + len(rooms))
        devices = [
            SimulatedDevice(each, replace(settings, seed=seed), shown, unit)
            for each, seed in zip(rooms, seeds, strict=True)
        ]
        exposures = Exposures(times, settings.response, settings.known or room.curve is None)
        super().__init__(shown, together(devices), exposures, lag=settings.lag)


def simulated_rooms(source: Path, refuse: Refuse = lambda *_: None) -> list[SimulatedRoom]:
    """Make the room that each camera of a scene or calibration folder sees; InputError if `source` is neither.

    source : a folder, a file, or the name of a shipped scene.
    refuse : called with the room's name, its projectors' sizes and its sensor before the simulation; raises InputError
        if they are not wanted.
    """
    file = parse_scene(str(source))
    if file.is_dir():
        stored = calibration.read(file)
        room = stored.calibration
        refuse(room.name, tuple(projector.shape for projector in room.projectors), None)
        return _views(room, tier_of(room, read_transport(stored)))
    scene = load_scene(file)
    refuse(scene.name, ((scene.projector.height, scene.projector.width),), scene.camera.sensor)
    return [_simulated(view) for view in scene.views]


def _views(room: Calibration, tier: Tier) -> list[SimulatedRoom]:
    pixels = np.arange(room.camera.pixels).reshape(room.camera.shape)
    mixing = tier.mixing.of_camera
    return [
        SimulatedRoom(
            room.name,
            tier.transport.at(pixels[view].ravel()),
            room.ambient[view],
            tuple(projector.shape for projector in room.projectors),
            room.response,
            mixing if mixing is None or mixing.ndim == 2 else mixing[view],
            gain=gain,
        )
        for view, gain in zip(room.views, room.gains, strict=True)
    ]


def _simulated(scene: Scene) -> SimulatedRoom:
    result = simulate(scene)
    light = result.spectral
    return SimulatedRoom(
        scene.name,
        result.transport if light is None else light.transport,
        result.ambient,
        ((scene.projector.height, scene.projector.width),),
        scene.projector.response.over((scene.projector.height, scene.projector.width)),
        None if light is None else light.mixing,
        scene.camera.sensor,
        flicker=scene.projector.flicker,
        mosaic=scene.camera.mosaic,
        curve=None if scene.camera.response.kind == "linear" else scene.camera.response,
        wander=scene.camera.wander,
    )
