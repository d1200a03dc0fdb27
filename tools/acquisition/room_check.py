"""Check whether the room is as calibrated, with black, white and a random picture per projector (docs/drift.md).

If the floodlit room inside the raster has changed, camera or scene has moved, and only a new acquisition helps. If one
of several cameras has moved, the check ignores it and uses the others. Otherwise the random pictures give the
position of each projector's picture, the floodlight gives the projectors' remaining light, and black gives the light of
the room. The player undoes these changes frame by frame.

A camera that changes its exposure is told apart from a projector that changes its light: g_kr = p_k q_r is the
gain of projector k in camera r. The factors are known only up to a common number. One camera is assumed to keep its
exposure: the camera for which the fewest changes remain.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.passes.encode import encoded
from counterlight.pipeline.drift import Drift, Moved
from counterlight.raster import Region
from counterlight.tools.acquisition.floodlight_check import REPEATS, SURE, Known, Looked, View, divided
from counterlight.tools.acquisition.photographer import Photographer
from counterlight.tools.acquisition.plan import Codes, measure_noise
from counterlight.tools.acquisition.registration import Registrar, Registration, random_field
from counterlight.tools.transport.transport import Transport

STILL = 0.03  # projector pixels; smaller movements are ignored
AGREED = 0.9  # a picture with a lower agreement was not found
CHANGED = 0.01  # share of light; a smaller difference is not a change
ROUNDS = 64  # rounds of alternating medians; each halves the remaining difference


@dataclass(frozen=True)
class Checked:
    """The changes in a room.

    drift : changes that can be undone.
    said : description in words.
    exposures : (cameras, 3). Exposure of each camera relative to its exposure at the calibration.
    used : per camera, whether its captures are used; False if it has moved.
    lost : whether the calibration no longer holds.
    """

    drift: Drift
    said: str
    exposures: FloatArray
    used: tuple[bool, ...]
    lost: bool = False


def check_room(photographer: Photographer, room: Calibration, transport: Transport) -> Checked:
    """Photograph the room's black, white and random pictures, and compare them with the prediction of T."""
    codes = [registration_codes(room, region) for region in room.regions]
    black, white = (np.full((*room.projector.shape, 3), level, np.uint8) for level in (0, 255))
    shown = [picture for picture in (black, white, *codes) for _ in range(REPEATS)]
    taken = photographer.take(shown)
    groups = [taken[start : start + REPEATS] for start in range(0, len(taken), REPEATS)]
    means = [np.asarray(np.mean(group, axis=0)) for group in groups]
    usable = ~photographer.saturated
    if not (room.mask & usable).any():
        raise InputError("the floodlit room is overexposed all over; expose as for the calibration")
    everybody, noise = (True,) * len(room.cameras), measure_noise(groups[0], groups[1])
    looked = Looked(Known(room, transport), means[0], means[1], noise, usable, everybody)
    return _Check(looked, codes, means[2:]).run()


class _Check:
    """Evaluates the captures; `codes` and `seen` are each projector's random picture and its capture."""

    def __init__(self, looked: Looked, codes: Sequence[Codes], seen: Sequence[FloatArray]) -> None:
        self._room, self._looked, self._codes, self._seen = looked.known.room, looked, codes, seen
        self._views = [View(looked, number) for number in range(len(self._room.cameras))]
        self._exposures = np.ones((len(self._views), 3))
        self._said: list[str] = []

    def run(self) -> Checked:
        gone = [view.gone() for view in self._views]
        if all(gone):
            return self._lost("; ".join(gone))
        used = tuple(not each for each in gone)
        self._said += [f"{each} (the others are used)" for each in gone if each]
        if len(used) > 1:
            self._look_again(used)
        otherwise = [text for view in self._views if used[view.number] and (text := view.otherwise())]
        if otherwise:
            return self._lost("; ".join(otherwise))
        try:
            found = [self._found(number, self._looked) for number in range(len(self._codes))]
        except InputError:
            if all(used):
                raise
            return self._lost("; ".join([*filter(None, gone), "the others see too little of a projector's picture"]))
        return self._undone(found)

    def _look_again(self, used: tuple[bool, ...]) -> None:
        """Repeat the comparison without the moved cameras, and with the exposures of the other cameras."""
        looked = self._looked.using(used, self._exposures)
        gains = [[self._gain(number, view, looked) for view in self._views] for number in range(len(self._codes))]
        self._exposures = changed_exposures(np.array(gains))
        self._looked = self._looked.using(used, self._exposures)
        self._views = [View(self._looked, view.number) for view in self._views]
        for view, exposure in zip(self._views, self._exposures, strict=True):
            if np.any(exposure != 1):
                self._said.append(f"{view.name}'s exposure is {_shares(exposure)} of what it was")

    def _gain(self, number: int, view: View, looked: Looked) -> FloatArray:
        """Returns the gain of a projector's light as one camera sees it, (3,); NaN where it sees too little."""
        white, nothing = looked.gain(number, view.here), np.full(3, np.nan)
        if np.isfinite(white).all() or not looked.used[view.number]:
            return white
        alone = tuple(each.number == view.number for each in self._views)
        try:
            found = self._found(number, looked.using(alone, self._exposures))
        except InputError:
            return nothing
        return found.moved.gain if found.agreement >= AGREED else nothing

    def _found(self, number: int, looked: Looked) -> Registration:
        """Register a projector's picture."""
        region, codes = self._room.regions[number], self._codes[number]
        registrar = Registrar(looked.known.transport, region, looked.counts)
        seen = divided(self._seen[number], self._room, self._exposures)
        drive = self._room.response.to_linear(codes)[region.part]
        return registrar.find(drive, (seen - looked.black).reshape(-1, 3), looked.noise)

    def _undone(self, found: Sequence[Registration]) -> Checked:
        said, pictures = self._said, list[Moved]()
        for number, (each, device) in enumerate(zip(found, self._room.projectors, strict=True)):
            name = "the projector" if len(found) == 1 else f"projector {number + 1}"
            if each.agreement < AGREED:
                return self._lost(
                    f"{name}'s picture is not where any homography puts it (agreement {each.agreement:.2f})"
                )
            moved = _moved(each, device, self._looked.gain(number))
            try:
                moved.check(device)
            except InputError as error:
                return self._lost(f"{name}: {error}")
            pictures.append(moved)
            said += _lines(name, moved, device)
        old, new, other = self._looked.room_light
        if other:
            said.append(f"the room's light is {new:.2%} of white, was {old:.2%}")
        ambient = self._looked.ambient().astype(np.float32) if other else None
        text = "; ".join(said) if said else "nothing has changed"
        unsure = " and ".join(view.name for view in self._views if self._looked.used[view.number] and view.unsure)
        if unsure:
            text += f" (too little texture to tell whether {unsure} has moved)"
        moves = any(not np.array_equal(each.to_raster, np.eye(3)) for each in pictures)
        share = self._looked.share([each.gain for each in pictures]) if moves else None
        drift = Drift(tuple(pictures), ambient, text, _now(), share)
        return Checked(drift, text, self._exposures, self._looked.used)

    def _lost(self, text: str) -> Checked:
        return Checked(nothing(self._room), text, self._exposures, self._looked.used, lost=True)


def _moved(found: Registration, device: Device, white: FloatArray) -> Moved:
    """Returns the significant movement and gain; `white` is the gain by the floodlight, which is preferred if known."""
    far, still = _farthest(found.moved, device), max(STILL, SURE * found.unsure)
    gain = np.where(np.isfinite(white), white, found.moved.gain)
    dimmed = bool(np.abs(gain - 1).max() > CHANGED)
    return Moved(found.moved.to_raster if far > still else np.eye(3), gain if dimmed else np.ones(3))


def _lines(name: str, moved: Moved, device: Device) -> list[str]:
    said, far = [], _farthest(moved, device)
    if far > 0:
        right, down = moved.at_corners(device)[0]
        said.append(f"{name}'s picture has moved by {right:.2f}, {down:.2f} pixels (its corners by up to {far:.2f})")
    if np.any(moved.gain != 1):
        said.append(f"{name}'s light is {_shares(moved.gain)} of what it was")
    return said


def _farthest(moved: Moved, device: Device) -> float:
    """Returns the largest movement of the corners and the middle."""
    return float(np.hypot(*moved.at_corners(device).T).max())


def _shares(gain: FloatArray) -> str:
    return ", ".join(f"{value:.1%}" for value in gain)


def nothing(room: Calibration) -> Drift:
    """Returns a drift of zero: the room as calibrated."""
    return Drift(tuple(Moved.nothing() for _ in room.projectors), None, "nothing has changed", _now())


def registration_codes(room: Calibration, region: Region) -> Codes:
    """Returns the random picture of one projector with the others black, (height, width, 3)."""
    drive = np.zeros((*room.projector.shape, 3))
    drive[region.part] = random_field((region.height, region.width))[..., None]
    return encoded(drive, room.response)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def changed_exposures(gains: FloatArray) -> FloatArray:
    """Returns q of each camera, (cameras, 3), 1 where it has not changed.

    gains : (projectors, cameras, 3). g; NaN where the camera does not see that projector alone.
    """
    logs = np.log(gains)
    count = gains.shape[1]
    exposures = min((_factors(logs, held) for held in range(count)), key=lambda q: _changes(logs, q))
    factors = np.exp(exposures)
    unchanged = np.abs(factors - 1).max(axis=1) <= CHANGED
    return np.where(unchanged[:, None], 1.0, factors)


def _factors(logs: FloatArray, held: int) -> FloatArray:
    """Returns log q (cameras, 3) by medians, with q of camera `held` fixed at 1."""
    q = np.zeros(logs.shape[1:])
    for _ in range(ROUNDS):
        before, p = q, _median(logs - q, 1)
        q = _median(logs - p[:, None], 0)
        q -= q[held]
        if np.array_equal(q, before):
            break
    return q


def _changes(logs: FloatArray, q: FloatArray) -> int:
    """Returns the number of cameras and projectors that have changed."""
    both = np.concatenate([q, _median(logs - q, 1)])
    return int(np.count_nonzero(np.abs(np.expm1(both)).max(axis=1) > CHANGED))


def _median(values: FloatArray, axis: int) -> FloatArray:
    """Returns the median of the finite values; 0 where there are none."""
    known = np.isfinite(values)
    filled = np.where(known.any(axis=axis, keepdims=True), values, 0.0)
    return np.asarray(np.nanmedian(filled, axis=axis))
