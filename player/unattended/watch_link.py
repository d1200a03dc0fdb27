"""Messages between the player and its watcher, the process that calibrates the room from the film (docs/watch.md).

The player writes binary messages to the watcher's standard input. A message is HEADER (kind, bytes of JSON, bytes of
data), a JSON object, and the data of an array. The watcher answers with JSON lines on its standard output. Times are
seconds of CLOCK_MONOTONIC, which both processes share. Both sides import this module.
"""

import json
import math
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.unattended.json_lines import encode

HEADER = struct.Struct("<4sII")
GRID = 24, 32  # rows and columns of `Light.grid`
MOST_BYTES = 1 << 26  # largest message; a larger number of bytes is damage
PAINT, GAINS = "paint.npy", "gains.npy"
ROW_GAINS = 0.5, 1.15  # limits of the factors of the rows of T
SHORTEST_PERIOD_S = 1e-3  # of captures
FARTHEST, FARTHEST_PX = 0.02, 4.0  # limit of a correction: corners as a share of the longer side, at least these pixels
STATES = (
    "starting",  # reads the calibration, or opens the camera
    "looking",  # finds out when the camera sees a frame.
    "holding",  # θ stays: nothing has changed, or the film does not show enough
    "correcting",  # θ changes
    "frozen",  # the user has frozen θ
    "no camera",  # the camera is missing, gives no more frames, or repeats one picture during the film
    "not the room",  # the camera does not see the calibrated room
    "camera moved",
    "camera changed",  # the camera's exposure, gain or white balance is automatic
    "acquire again",  # the room has changed beyond the limits of a correction
)


@dataclass(frozen=True)
class Start:
    """The first message.

    calibration : folder of the room.
    cameras : words of --watch.
    exposures : words of --exposures, in seconds; empty if not given.
    factor : pixels of the raster per pixel of a reduced picture (pipeline/shown_copies.py).
    refresh_s : period of the display.
    folder : folder for files of the watcher, which the player removes.
    colour : colour tier of the maps, one of choices.COLOURS.
    record : folder of --watch-record; empty for none.
    """

    kind: ClassVar[bytes] = b"STRT"
    calibration: str
    cameras: tuple[str, ...]
    exposures: tuple[float, ...]
    factor: int
    refresh_s: float
    folder: str
    colour: str = "auto"
    record: str = ""


@dataclass(frozen=True)
class Light:
    """The light of a displayed frame. A frame stays on the screen until the time of the next frame.

    time_s : when the frame was shown.
    grid : (*GRID, 3) float32. Linear drive, mean over the cells of a grid.
    """

    kind: ClassVar[bytes] = b"LGHT"
    time_s: float
    grid: NDArray[np.float32]


@dataclass(frozen=True)
class Picture:
    """A displayed frame, with the time of its `Light`.

    drive : (height, width, 3) float16. Linear drive as shown, after refinement, overlay and the moved pass; means over
        factor × factor pixels of each projector's picture (pipeline/shown_copies.py).
    """

    kind: ClassVar[bytes] = b"PICT"
    time_s: float
    drive: NDArray[np.float16]


@dataclass(frozen=True)
class Situation:
    """The state of the player, sent when it changes.

    frozen : the user has frozen the correction, or text covers the picture.
    """

    kind: ClassVar[bytes] = b"SITU"
    frozen: bool = False


Message: TypeAlias = Start | Light | Picture | Situation


@dataclass(frozen=True)
class Projected:
    """θ of one projector, relative to the calibration, in the form of `counterlight.pipeline.drift.Moved`.

    to_raster : N, three rows of three numbers, in pixels of the raster.
    gain : three numbers.
    unsure_px : standard deviation of the corners, projector pixels.
    """

    to_raster: tuple[tuple[float, ...], ...]
    gain: tuple[float, ...]
    unsure_px: float


@dataclass(frozen=True)
class Answer:
    """State and findings of the watcher.

    state : one of STATES.
    reason : reason for the state, in words.
    projectors : θ to apply, one entry per projector; empty before the first estimate.
    ambient : rows of columns of three numbers, at most 12 × 16, in screen primaries: light added to the calibrated
        ambient light. The field covers the camera picture and is interpolated between the middles of its cells. The
        player multiplies the field by the picture in the file PAINT of Start.folder, (camera height, camera width, 3)
        float16. The file exists once an answer has an ambient. Empty for no change.
    confidence : 0 to 1.
    latency_s : time from the display of a frame to the end of its exposure; 0 if unknown.
    captures : captures compared with their prediction.
    rejected : captures that were discarded, by reason.
    row_gains : number of the learned factors of the rows of T; 0 for none. The file GAINS of Start.folder holds the
        newest ones, float32, also for the next watcher (`counterlight.pipeline.correction.Correction`).
    exposes : begin and end of the next exposure, and the period of the captures, in seconds; empty if unknown.
    """

    state: str
    reason: str = ""
    projectors: tuple[Projected, ...] = ()
    ambient: tuple[tuple[tuple[float, ...], ...], ...] = ()
    confidence: float = 0.0
    latency_s: float = 0.0
    captures: int = 0
    rejected: dict[str, int] = field(default_factory=dict)
    row_gains: int = 0
    exposes: tuple[float, float, float] | tuple[()] = ()

    def line(self) -> bytes:
        return encode(asdict(self))

    @classmethod
    def parse(cls, line: bytes) -> "Answer":
        """Read a line. Raises ValueError for anything but an answer."""
        try:
            values = json.loads(line)
            values["projectors"] = tuple(Projected(**each) for each in values["projectors"])
            answer = cls(**values)
            answer = replace(answer, exposes=_exposure(answer.exposes) if answer.exposes else ())
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"no answer: {error}") from None
        if answer.state not in STATES:
            raise ValueError(f"state {answer.state!r}, expected one of {', '.join(STATES)}")
        return answer


def packed(message: Message) -> bytes:
    """Return the bytes of a message. To write them without waiting, write all of them or none."""
    values: dict[str, Any] = dict(vars(message))
    array = next((values.pop(name) for name in ("grid", "drive") if name in values), None)
    data = b"" if array is None else np.ascontiguousarray(array).tobytes()
    if array is not None:
        values["shape"] = array.shape
    head = encode(values)
    return HEADER.pack(message.kind, len(head), len(data)) + head + data


class Unpacker:
    """Splits a stream of bytes into messages."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def feed(self, content: bytes) -> Iterator[Message]:
        """Yield the messages that `content` completes. Raises ValueError for damage."""
        self._waiting += content
        while len(self._waiting) >= HEADER.size:
            kind, head, data = HEADER.unpack_from(self._waiting)
            end = HEADER.size + head + data
            if kind not in _READ or end > MOST_BYTES:
                raise ValueError(f"a message of kind {kind!r} and {end} bytes")
            if len(self._waiting) < end:
                return
            body = bytes(self._waiting[HEADER.size : end])
            del self._waiting[:end]
            yield _READ[kind](json.loads(body[:head]), body[head:])


def farthest_px(shape: tuple[int, int]) -> float:
    """Return how far the corners of a projector's picture may be corrected."""
    return max(FARTHEST * max(shape), FARTHEST_PX)


def _exposure(values: Iterable[Any]) -> tuple[float, float, float]:
    first_s, last_s, period_s = map(float, values)
    if not (math.isfinite(first_s) and first_s <= last_s < math.inf and SHORTEST_PERIOD_S <= period_s < math.inf):
        raise ValueError(f"an exposure from {first_s} to {last_s} s, every {period_s} s")
    return first_s, last_s, period_s


def _start(values: dict[str, Any], _: bytes) -> Start:
    for name in ("cameras", "exposures"):
        values[name] = tuple(values[name])
    return Start(**values)


def _light(values: dict[str, Any], data: bytes) -> Light:
    return Light(values["time_s"], np.frombuffer(data, np.float32).reshape(values["shape"]))


def _picture(values: dict[str, Any], data: bytes) -> Picture:
    return Picture(values["time_s"], np.frombuffer(data, np.float16).reshape(values["shape"]))


def _situation(values: dict[str, Any], _: bytes) -> Situation:
    return Situation(**values)


_READ: dict[bytes, Callable[[dict[str, Any], bytes], Message]] = {
    Start.kind: _start,
    Light.kind: _light,
    Picture.kind: _picture,
    Situation.kind: _situation,
}
