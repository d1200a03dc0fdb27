"""Question: how many pictures does an acquisition need here? A simulated camera acquires the room again."""

import io
from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import dataclass, replace

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.command import track
from counterlight.errors import InputError
from counterlight.tools.acquisition.acquire import acquire
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, SimulatedRoom
from counterlight.tools.acquisition.few.acquire import acquire_pictures
from counterlight.tools.acquisition.plan import MakeScheme
from counterlight.tools.acquisition.schemes.graycode import GrayCodeScheme
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme, Threshold
from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme
from counterlight.tools.acquisition.store import MemoryStore
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.jobs import one_thread
from counterlight.tools.joining.projectors import join_transports
from counterlight.tools.study.questions.answers import CLOSE_DB, NEAR_DB, Answer, Question, cheapest, decibels
from counterlight.tools.study.questions.place import MOST_PIXELS, Place, coarse
from counterlight.tools.transport.transport import Transport

MOST_ACQUIRED = MOST_PIXELS // 2  # camera pixels; beyond, schemes of a thousand pictures take minutes
SHOTS = 4
FIRST = 9, 16, 48, 128


@dataclass(frozen=True)
class Way:
    """A way to acquire a room.

    words : name in the table.
    options : options of counterlight acquire.
    make : its scheme; None for acquisition by pictures.
    pictures : number of pictures, for acquisition by pictures.
    shots : captures per pattern.
    averaged : whether each pattern gets as many shots as its noise requires.
    """

    words: str
    options: str
    make: Callable[[], MakeScheme] | None = None
    pictures: int = 0
    shots: int = 1
    averaged: bool = False


def _finest() -> MakeScheme:
    return HierarchicalScheme(Threshold(4))


MULTIPLEXED = Way("multiplexed", "--scheme multiplexed --shots 1", MultiplexedScheme)
HIERARCHICAL = Way("hierarchical, τ = 4 σ", "--shots 1", _finest)
WAYS = (
    *(Way(f"pictures first, {count}", f"--pictures {count}", pictures=count) for count in FIRST),
    Way("Gray code", "--scheme graycode --shots 1", GrayCodeScheme),
    MULTIPLEXED,
    Way(f"multiplexed, {SHOTS} shots", f"--scheme multiplexed --shots {SHOTS}", MultiplexedScheme, shots=SHOTS),
    Way("hierarchical, τ = 16 σ", "--threshold 16 --shots 1", lambda: HierarchicalScheme(Threshold(16))),
    HIERARCHICAL,
    Way(f"hierarchical, τ = 4 σ, {SHOTS} shots", f"--shots {SHOTS}", _finest, shots=SHOTS),
    Way("hierarchical, averaged", "", _finest, averaged=True),
)


def pictures(place: Place) -> Question:
    """Try each way: solve with the T that it acquired, and show the drives in the true room."""
    here = replace(coarse(place, MOST_ACQUIRED), colour="independent")
    answers, failed = [], []
    for way in track(WAYS, "acquiring again", len(WAYS)):
        try:
            answers.append(_acquired(here, way))
        except InputError as error:
            failed.append(f"{way.words}: {error}")
    sensor = CameraSettings().sensor
    return Question(
        "Pictures of an acquisition",
        "exposures",
        answers,
        _verdict(answers),
        f"{here.size}; a simulated camera of {sensor.bits} bits, {sensor.full_well:g} electrons full well and "
        f"{sensor.read_noise:g} of read noise. The room's own T is taken for the truth, noise and all. "
        f"{' '.join(failed)}".strip(),
        ("pictures", "options"),
        command="counterlight acquire",
    )


@dataclass(frozen=True)
class Again:
    """Result of acquiring a room again.

    transport : transport of all its projectors and cameras.
    black : (camera height, camera width, 3). Radiance for a black projector picture.
    pictures, exposures : numbers that the acquisition took.
    """

    transport: Transport
    black: FloatArray
    pictures: int
    exposures: int


def acquire_again(room: Calibration, truth: Transport, way: Way) -> Again:
    """Acquire a room with simulated cameras that see it through its true T.

    Raises InputError if the scheme does not work in this room.
    """
    pixels = np.arange(room.camera.pixels).reshape(room.camera.shape)
    projectors = tuple(each.shape for each in room.projectors)
    first, *others = (
        SimulatedRoom(room.name, truth.at(pixels[view].ravel()), room.ambient[view], projectors, room.response)
        for view in room.views
    )
    settings = replace(CameraSettings(), exposures=(1.0,) * way.shots)
    camera = SimulatedCamera(first, settings, others=others)
    store = MemoryStore(camera.exposures, averaged=way.averaged)
    # one thread as in acquire; messages about the simulation are hidden
    with one_thread(), redirect_stderr(io.StringIO()):
        if way.make is None:
            parts = acquire_pictures(camera, store, way.pictures, projectors, stoppable=False)
        else:
            parts = acquire(camera, store, way.make(), projectors)
    return Again(
        join_transports([part.measured.transport for part in parts], projectors),
        parts[0].room.black,
        sum(part.pictures for part in parts),
        sum(part.exposures for part in parts),
    )


def tier_of_acquired(room: Calibration, again: Again) -> Tier:
    """Returns the acquired room, seen in white light."""
    return tier_of(replace(room, ambient=again.black.astype(np.float32)), again.transport, "independent")


def _acquired(place: Place, way: Way) -> Answer:
    again = acquire_again(place.calibration, place.transport, way)
    drives = place.drives(tier_of_acquired(place.calibration, again))
    scheme, *further = way.words.split(", ")
    more = str(again.pictures), way.options
    return Answer(way.words, float(again.exposures), max(place.below(drives), 0.0), more, "".join(further[-1:]), scheme)


def _verdict(answers: list[Answer]) -> str:
    parts: dict[Answer, float] = {}
    for limit in (NEAR_DB, CLOSE_DB):
        if (found := cheapest(answers, limit)) is not None:
            parts[found] = limit
    if not parts:
        best = min(answers, key=lambda answer: answer.below, default=None)
        if best is None:
            return "No scheme works in this room."
        return f"The best that was tried, {best.setting}, stays {decibels(best.below)} below what the true T gives."
    within = "; ".join(
        f"{found.cost:.0f} exposures ({found.setting}) are within {limit:g} dB" for found, limit in parts.items()
    )
    return f"{within} of what the true T gives."
