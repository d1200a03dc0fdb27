"""How many pictures does acquisition need here for which quality? Acquired again, by a camera that is simulated."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from counterlight.calibration import Calibration
from counterlight.command import track
from counterlight.errors import InputError
from counterlight.tools.acquisition.acquire import Acquisition, acquire
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, SimulatedRoom
from counterlight.tools.acquisition.memory import MemoryStore
from counterlight.tools.acquisition.plan import MakeScheme
from counterlight.tools.acquisition.schemes.baselines import GrayCodeScheme
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme, Threshold
from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.study.questions.answers import CLOSE_DB, NEAR_DB, Answer, Question, cheapest, decibels, sentence
from counterlight.tools.study.questions.place import MOST_PIXELS, Place, made_coarser
from counterlight.tools.transport.transport import Transport

MOST_ACQUIRED = MOST_PIXELS // 2  # camera pixels; schemes of a thousand pictures take minutes beyond
SHOTS = 4


@dataclass(frozen=True)
class Way:
    """words, options : for the table and of counterlight acquire.  shots : of each pattern."""

    words: str
    options: str
    make: Callable[[], MakeScheme]
    shots: int = 1


MULTIPLEXED = Way("multiplexed", "--scheme multiplexed", MultiplexedScheme)
WAYS = (
    Way("Gray code", "--scheme graycode", GrayCodeScheme),
    MULTIPLEXED,
    Way("multiplexed", "--scheme multiplexed", MultiplexedScheme, SHOTS),
    Way("hierarchical, τ = 16 σ", "--threshold 16", lambda: HierarchicalScheme(Threshold(16))),
    Way("hierarchical, τ = 4 σ", "", lambda: HierarchicalScheme(Threshold(4))),
    Way("hierarchical, τ = 4 σ", "", lambda: HierarchicalScheme(Threshold(4)), SHOTS),
)


def pictures(place: Place) -> Question:
    """Each way of acquiring, its T solved and shown in the room as it is."""
    here = _fit(place)
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
        ("pictures", "shots", "options"),
        command="counterlight acquire",
    )


def _fit(place: Place) -> Place:
    factor = int(np.ceil(np.sqrt(place.calibration.camera.pixels / MOST_ACQUIRED)))
    if factor == 1:
        return replace(place, colour="independent")
    small = made_coarser(place.calibration, place.transport, factor, factor)
    return Place(*small, place.pictures, "independent", place.factor * factor)


def acquire_again(room: Calibration, truth: Transport, way: Way) -> Acquisition:
    """A room acquired by a simulated camera that sees it by its true T; InputError where a scheme does not work."""
    raster = (room.projector.shape,)
    seen = SimulatedRoom(room.name, truth, room.ambient, raster, room.response)
    camera = SimulatedCamera(seen, replace(CameraSettings(), exposures=(1.0,) * way.shots))
    (done,) = acquire(camera, MemoryStore(camera.exposures), way.make(), raster)
    return done


def tier_of_acquired(room: Calibration, done: Acquisition) -> Tier:
    """The room as an acquisition found it, seen in white light."""
    found = replace(room, ambient=done.room.black.astype(np.float32))
    return tier_of(found, done.measured.transport, "independent")


def _acquired(place: Place, way: Way) -> Answer:
    done = acquire_again(place.calibration, place.transport, way)
    drives = place.drives(tier_of_acquired(place.calibration, done))
    more = str(done.pictures), str(way.shots), way.options
    scheme, _, threshold = way.words.partition(", ")
    shots = "" if way.shots == 1 else f"{way.shots} shots"
    mark = ", ".join(part for part in (threshold, shots) if part)
    words = ", ".join(part for part in (way.words, shots) if part)
    return Answer(words, float(done.exposures), max(place.below(drives), 0.0), more, mark, scheme)


def _verdict(answers: list[Answer]) -> str:
    parts = [
        f"{found.setting}, {found.cost:.0f} exposures, is within {limit:g} dB of what the true T gives"
        for limit in (NEAR_DB, CLOSE_DB)
        if (found := cheapest(answers, limit)) is not None
    ]
    if not parts:
        best = min(answers, key=lambda answer: answer.below, default=None)
        if best is None:
            return "No scheme works in this room."
        return f"The best that was tried, {best.setting}, stays {decibels(best.below)} below what the true T gives."
    return sentence("; ".join(parts))
