"""The watcher: takes frames and captures, and says which correction the player should apply, and why.

The watcher has no clock and no device. Times come with frames and captures, so that the same frames and captures always
give the same answers.
"""

from collections import Counter, deque
from collections.abc import Sized
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from counterlight.arrays import FloatArray
from counterlight.pipeline.correction import blocks_of
from counterlight.pipeline.drift import Moved
from counterlight.raster import Shape
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.tools.acquisition.registration import homography
from counterlight.tools.watching.estimate import (
    COARSE,
    STILL_AMBIENT,
    STILL_LIGHT,
    STILL_PX,
    WINDOWS_S,
    WORTH,
    Estimate,
    Found,
    information,
)
from counterlight.tools.watching.evidence import CHANNELS, FIELD, Compared, Comparison
from counterlight.tools.watching.learning import FAINT, Learning
from counterlight.tools.watching.timeline import Exposed, Timeline
from counterlight.tools.watching.view import RoomView, regional, rms
from counterlight.unattended.watch_link import (
    SHORTEST_PERIOD_S,
    Answer,
    Light,
    Picture,
    Projected,
    Situation,
    farthest_px,
)

ARRIVALS = 6  # captures from which their period is known
LATENCY_EVERY_S = 2.0, 8.0  # seconds between estimates of the latency: while it is unknown, and once it is known
FIND_EVERY_S = 0.5
OFTEN_S, PIXEL_S = 0.15, 3.5e-6  # least time between compared captures, also per reduced pixel: a fifth of a core
SAME_S = 1.0  # least time between compared captures of one picture
RARE_S, LOOKING_S = 1.0, 0.1  # longest time without a capture: usually, and while the latency is unknown
CUT = 0.03  # RMS uncertainty of the picture of a capture, drive; above it, the capture spans a cut
STILL_CAMERA = 4  # identical captures of a changing film, which no working camera gives
CHANGED = 0.02  # RMS change of the light of a film that changes
SILENT_S = 3.0  # time for which the watcher waits for a capture
STRANGE, AGREED = 6, 0.6  # captures, and their least agreement with the prediction
EXPOSURES = 12  # captures from which an automatic exposure is detected
AUTOMATIC = 0.7, 0.03  # least correlation of gain and brightness, and least deviation of the gain
GAIN = 0.5, 1.15  # limits of each projector's gain
PX_PER_S, LIGHT_PER_S, LEARNED_PER_S = 1.0, 0.03, 0.005
ROUNDED = 0.3  # error of a rounded code value
BACK_S = WINDOWS_S[0]  # if a camera has moved or changed, the corrections of this many last seconds are reverted
# time after a fault; an automatic exposure may agree with the calibrated exposure for a whole scene of the film
WITHOUT_CORRECTIONS_S = {"camera moved": 5.0, "camera changed": 20.0}
MOVED_WORTH = 8.0  # the same as WORTH for a moved camera; without a movement, a film that pans gives up to 4
AGREEING = 2  # successive estimates that must find a movement; the first one mixes captures from before and after it
UNCLEAR_S = 5.0  # longest wait for a sign whether the camera or a projector has moved
JUMP_PX = 1.0  # larger changes are applied at once
# share of outliers that starts the search of a jump; steps of the search in pixels
MISFITTING, SEARCHED = 0.05, (2.0, 1.0, 0.5)
SEARCH_S = 1.0, 30.0  # time between two searches; doubles after each search without a result
MUCH_BETTER = 0.7  # factor by which a jump must reduce the misfit


@dataclass(frozen=True)
class _Taken:
    """A capture and the result of its comparison with the prediction."""

    picture: FloatArray
    compared: Compared


@dataclass(frozen=True)
class Sight:
    """What the watcher saw last.

    shot : the capture.
    shown : (height, width, 3). Mean reduced picture during the exposure; None if it is not known.
    blocks : (rows, 2 · columns, 3). Measured next to predicted light, share of white; None if not known.
    """

    shot: Shot
    shown: FloatArray | None = None
    blocks: FloatArray | None = None


class Watcher:
    """Watches one room.

    exposure_s : exposure of the captures; None if unknown.
    follows : whether a capture arrives at the end of its exposure.
    row_gains : what a previous watcher of this show has learned, in the form of `row_gains()`.
    """

    def __init__(
        self,
        view: RoomView,
        exposure_s: float | None,
        refresh_s: float,
        *,
        follows: bool = False,
        row_gains: NDArray[np.float32] | None = None,
    ) -> None:
        self._view, self._comparison = view, Comparison(view)
        self._estimate = Estimate(self._comparison.layout, view.camera_px)
        coarse, self._region = view.coarse
        self._timeline = Timeline(coarse, exposure_s, refresh_s, follows=follows)
        self._situation = Situation()
        self._taken: deque[_Taken] = deque(maxlen=30)
        self._last: list[tuple[FloatArray, NDArray[np.float32] | None] | None] = [None] * len(view.cameras)
        self._light: NDArray[np.float32] | None = None
        self._compared_light: NDArray[np.float32] | None = None
        self._same, self._captures = [0] * len(view.cameras), 0
        self._rejected: Counter[str] = Counter()
        self._found: Found | None = None
        self._looked_s = self._searched_s = self._fitted_s = self._answered_s = -np.inf
        self._capture_s = self._compared_s = -np.inf
        self._arrivals: deque[float] = deque(maxlen=ARRIVALS)
        self._waits_s = np.inf
        self._history: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=round(BACK_S / FIND_EVERY_S))
        self._applied = self._estimate.applied
        self._unclear_s, self._moving = np.inf, 0
        self._fault, self._fault_ends_s = ("", ""), -np.inf
        self._pause_s = max(OFTEN_S, PIXEL_S * view.raster[0] * view.raster[1])
        self._rest_s = SEARCH_S[0]
        self._seen: tuple[Shot, FloatArray, FloatArray | None] | None = None
        self._learning, self._learns = Learning(view.shape, view.counted), False
        if row_gains is not None:
            rows, columns = view.shape
            self._learning.restart(row_gains[:rows, :columns].reshape(-1, CHANNELS).astype(np.float64))
        self._gains, self._number = self._learning.learned.gains, 1

    def light(self, light: Light) -> None:
        self._timeline.light(light)
        self._light = light.grid

    def picture(self, picture: Picture) -> None:
        self._timeline.picture(picture)

    def situation(self, situation: Situation) -> None:
        self._situation = situation

    def waits(self, time_s: float) -> None:
        """Take note that all captures are taken, and that the next one is waited for from `time_s` on."""
        self._waits_s = time_s

    def arrived(self, time_s: float) -> None:
        """Take note of a capture, also of one that is not taken."""
        self._arrivals.append(time_s)
        self._waits_s = np.inf

    def wants(self, time_s: float) -> bool:
        """Whether to take a capture that arrives at `time_s`: its frames are known, or the last one is long ago."""
        if time_s - self._capture_s > (RARE_S if self._timeline.latency.known else LOOKING_S):
            return True
        pause_s = SAME_S if self._light is self._compared_light else self._pause_s
        return time_s - self._compared_s > pause_s and self._timeline.knows(self._timeline.window(time_s))

    def capture(self, time_s: float, shot: Shot, exposures: Exposures) -> None:
        """Take a capture that arrived at `time_s`; `exposures` converts its code values to radiance."""
        measured = self._view.measured(exposures.radiance([shot])) / self._learning.learned.gains
        self._capture_s, self._seen = time_s, (shot, measured, None)
        if self._stands_still(measured):
            self._rejected["identical"] += 1
            return
        light = measured - self._comparison.ambient(self._estimate.theta)
        regions = np.stack([regional(light[:, i], self._region) for i in range(CHANNELS)], axis=1)
        self._timeline.captured(time_s, regions)
        if time_s - self._looked_s > LATENCY_EVERY_S[self._timeline.latency.known]:
            self._looked_s = time_s
            self._timeline.find()
        exposed = self._timeline.seen(self._timeline.window(time_s))
        if exposed is None:
            self._rejected["unknown frames"] += 1
            return
        self._seen = shot, measured, exposed.picture
        if rms(exposed.change) > CUT:
            self._rejected["cut"] += 1
            return
        self._compare(time_s, exposed, measured, shot, exposures)

    def answer(self, now_s: float) -> Answer:
        """Return the correction to apply, and why."""
        state, reason = self._steady(now_s, *self._state(now_s))
        estimate, step_s = self._estimate, min(now_s - self._answered_s, 1.0)
        if state in WITHOUT_CORRECTIONS_S:
            if self._history:
                self._applied, self._gains = self._history[0]  # from before the camera changed
                estimate.applied = self._applied
                self._number += 1
                self._history.clear()
            self._learning.restart(self._gains)
        elif now_s - self._answered_s >= FIND_EVERY_S:
            self._history.append((self._applied, self._gains))
        if state == "correcting" and self._found is not None:
            estimate.apply(self._found.theta)
        self._learns = state in ("correcting", "holding")
        if self._learns:
            self._approach(estimate.applied, step_s)
            self._approach_gains(step_s)
        self._answered_s = now_s
        latency = self._timeline.latency
        return Answer(
            state,
            reason,
            self._projected(self._applied),
            self._field(self._applied),
            self._confidence(),
            latency.latency_s if latency.known else 0.0,
            self._captures,
            dict(self._rejected),
            self._number if np.any(self._gains != 1) else 0,
            self._exposes(),
        )

    def row_gains(self) -> NDArray[np.float32]:
        """Return the applied factors of the rows of T, for the player (`Correction.row_gains`)."""
        rows, columns = self._view.shape
        counted = self._view.counted.reshape(rows, columns)
        nearest = ndimage.distance_transform_edt(~counted, return_distances=False, return_indices=True)
        gains = self._gains.reshape(rows, columns, CHANNELS)[tuple(nearest)]
        height, width = blocks_of(self._view.room.camera.shape)
        return np.pad(gains, ((0, height - rows), (0, width - columns), (0, 0)), mode="edge").astype(np.float32)

    def sight(self) -> Sight | None:
        """Return the last capture, next to its prediction by the present estimate."""
        if self._seen is None:
            return None
        shot, measured, shown = self._seen
        if shown is None:
            return Sight(shot)
        scale = self._learning.learned.gains / self._view.white
        both = measured, self._comparison.predicted(shown, self._estimate.theta)
        pictures = [(scale * each).reshape(*self._view.shape, CHANNELS) for each in both]
        return Sight(shot, shown, np.concatenate(pictures, axis=1))

    def _exposes(self) -> tuple[float, float, float] | tuple[()]:
        """Return when the next capture is exposed, and the period of captures, if both are known."""
        if not self._timeline.latency.known or len(self._arrivals) < ARRIVALS:
            return ()
        period_s = max(float(np.median(np.diff(self._arrivals))), SHORTEST_PERIOD_S)
        window = self._timeline.window(self._arrivals[-1] + period_s)
        return window.first_s - window.unsure_s, window.last_s + window.unsure_s, period_s

    def _compare(self, time_s: float, exposed: Exposed, measured: FloatArray, shot: Shot, exposures: Exposures) -> None:
        gains = self._learning.learned.gains
        unclipped, noise = self._view.blocks.unclipped(shot), _rounding(exposures, shot, gains * measured) / gains
        compared = self._comparison.compare(exposed, measured, self._estimate.theta, unclipped, noise)
        if compared.outliers < MISFITTING:
            self._rest_s = SEARCH_S[0]
        elif time_s - self._searched_s > self._rest_s:
            self._searched_s, self._rest_s = time_s, min(2 * self._rest_s, SEARCH_S[1])
            if self._jump(exposed, measured):
                compared = self._comparison.compare(exposed, measured, self._estimate.theta, unclipped, noise)
        self._compared_s, self._compared_light = time_s, self._light
        previous = self._taken[-1].picture if self._taken else None
        self._taken.append(_Taken(exposed.picture, compared))
        self._captures += 1
        if compared.outliers > 0.5:
            self._rejected["outlier"] += 1
            return
        change = np.inf if previous is None else rms(exposed.picture - previous)
        self._estimate.add(time_s, compared, change)
        if self._learns:
            weights = information(change) * compared.weights
            self._learning.add(time_s, compared.predicted, gains * measured, weights)
        if time_s - self._fitted_s >= FIND_EVERY_S:
            self._fitted_s = time_s
            self._found = self._estimate.find()
            self._moving = self._moving + 1 if self._found is not None and self._moves(self._found) else 0

    def _jump(self, exposed: Exposed, measured: FloatArray) -> bool:
        """Search for a jump of each picture, and continue from it if it explains the capture much better."""
        theta = self._estimate.theta
        before = least = self._comparison.misfit(exposed, measured, theta)
        for number in range(self._comparison.layout.projectors):
            place = self._comparison.layout.geometry(number)[:2]
            for step in SEARCHED:
                centre = theta
                for shift in product((-2, -1, 0, 1, 2), repeat=2):
                    trial = centre.copy()
                    trial[place] += np.array(shift) * step
                    cost = self._comparison.misfit(exposed, measured, trial)
                    if cost < least:
                        theta, least = trial, cost
        if least > MUCH_BETTER * before:
            return False
        self._estimate.restart(theta)
        self._found, self._moving = None, 0
        return True

    def _stands_still(self, measured: FloatArray) -> bool:
        """Whether all cameras repeat their pictures, or one camera does although the film has changed in its view."""
        identical = 0
        for number, own in enumerate(self._view.cameras):
            seen, last = measured[own], self._last[number]
            if last is None or not np.array_equal(last[0], seen):
                self._last[number], self._same[number] = (seen, self._light), 0
                continue
            identical += 1
            if last[1] is not None and self._light is not None:
                self._same[number] += self._view.changes(number, self._light - last[1]) > CHANGED
        return identical == len(self._last) or any(self._same)

    def _state(self, now_s: float) -> tuple[str, str]:
        if self._situation.frozen:
            return "frozen", "the correction is frozen"
        if self._arrivals and now_s - self._waits_s > SILENT_S:
            return "no camera", f"no capture for {now_s - self._waits_s:.0f} s"
        if max(self._same) >= STILL_CAMERA:
            name = _named("camera", int(np.argmax(self._same)), self._same)
            return "no camera", f"{name} repeats one picture while the film changes"
        if self._automatic():
            return "camera changed", "the camera's exposure follows the film: set exposure and gain by hand"
        strange = [each.compared.agreement for each in list(self._taken)[-STRANGE:]]
        strange = [each for each in strange if np.isfinite(each)]
        if len(strange) >= STRANGE // 2 and float(np.median(strange)) < AGREED:
            return "not the room", (
                f"captures and predictions agree to {np.median(strange):.2f}: is the camera where it was, is the "
                "projector the calibrated one?"
            )
        if self._found is None:
            if not self._taken:
                known = self._timeline.latency.known
                return "looking", "" if known else "the film has not yet shown when the camera sees a frame"
            return "holding", "too few captures"
        return self._state_of(self._found, now_s)

    def _state_of(self, found: Found, now_s: float) -> tuple[str, str]:
        beyond = self._beyond(found.theta)
        if found.camera > MOVED_WORTH and (beyond is None or beyond[0] != "camera changed"):
            name = _named("camera", found.which, self._view.cameras)
            return "camera moved", f"{name} has moved: put it back, or acquire again"
        if beyond is not None:
            return beyond
        if np.array_equal(found.theta, self._estimate.applied):
            if not np.array_equal(self._gains, self._learning.learned.gains):
                return "correcting", self._lasting() or "back to the calibration"
            nothing = "nothing has changed" if min(found.known) == 1 else "the film says too little"
            return "holding", self._lasting() or nothing
        if found.better < WORTH:
            return "holding", "a correction would not predict other captures better"
        moves = self._moves(found)
        if moves and self._moving < AGREEING:
            return "holding", "a movement waits for the next captures"
        unclear = moves and not found.texture
        self._unclear_s = min(self._unclear_s, now_s) if unclear else np.inf
        if now_s - self._unclear_s < UNCLEAR_S and unclear:
            return "holding", "it is unclear whether the camera or a projector has moved"
        return "correcting", self._changes(found.theta)

    def _moves(self, found: Found) -> bool:
        places = self._comparison.layout.all_geometry
        return bool(np.abs((found.theta - self._estimate.applied)[places]).max() > STILL_PX)

    def _steady(self, now_s: float, state: str, reason: str) -> tuple[str, str]:
        """Return a state without corrections soon after a fault of the camera, which not every frame shows."""
        if state in WITHOUT_CORRECTIONS_S:
            self._fault, self._fault_ends_s = (state, reason), now_s + WITHOUT_CORRECTIONS_S[state]
        elif state == "correcting" and now_s < self._fault_ends_s:
            return self._fault[0], f"{self._fault[1]} (corrections begin in {self._fault_ends_s - now_s:.0f} s)"
        return state, reason

    def _automatic(self) -> bool:
        """Whether the gain of the captures follows the brightness of the film."""
        # without captures that are so dark that rounded code values imitate a gain
        latest = (each.compared for each in list(self._taken)[-EXPOSURES:])
        known = [
            each for each in latest if np.isfinite(each.gain) and COARSE * each.coarse < AUTOMATIC[1] * each.brightness
        ]
        if len(known) < EXPOSURES:
            return False
        gain = np.log([max(each.gain, 1e-3) for each in known])
        light = np.log([max(each.brightness, 1e-3) for each in known])
        if gain.std() < AUTOMATIC[1] or light.std() < AUTOMATIC[1]:
            return False
        return float(np.corrcoef(gain, light)[0, 1]) < -AUTOMATIC[0]

    def _beyond(self, theta: FloatArray) -> tuple[str, str] | None:
        """Return the state and the reason if θ exceeds the limits of corrections."""
        for number, device in enumerate(self._view.room.projectors):
            name = _named("projector", number, self._view.boxes)
            far = float(np.hypot(*self._moved(theta, number).at_corners(device).T).max())
            if far > farthest_px(device.shape):
                return "acquire again", f"{name}'s picture has moved by {far:.1f} pixels: acquire again"
            gain = 1 + theta[self._comparison.layout.gain(number)]
            if gain.max() > GAIN[1]:
                said = f"{name} seems {gain.mean():.0%} as bright as calibrated"
                return "camera changed", f"{said}: set the camera's exposure and gain as for the calibration"
            if gain.min() < GAIN[0]:
                return "acquire again", f"{name}'s light is {gain.mean():.0%} of what it was: acquire again"
        return None

    def _changes(self, theta: FloatArray) -> str:
        said, layout = [], self._comparison.layout
        for number, device in enumerate(self._view.room.projectors):
            name = _named("picture", number, self._view.boxes)
            right, down = self._moved(theta, number).at_corners(device)[0]
            if np.abs(theta[layout.geometry(number)]).max() >= STILL_PX:
                said.append(f"{name} has moved by {right:.2f}, {down:.2f} pixels")
            gain = theta[layout.gain(number)]
            if np.abs(gain).max() >= STILL_LIGHT:
                said.append(f"{name}'s light is {1 + gain.mean():.1%} of what it was")
        room_light = float(theta[layout.ambient].mean())
        if abs(room_light) >= STILL_AMBIENT:
            said.append(f"the room's light has changed by {room_light:.1%} of white")
        return "; ".join(filter(None, [*said, self._lasting()])) or "back to the calibration"

    def _lasting(self) -> str:
        """Describe what has been learned; empty for nothing."""
        learned, counted = self._learning.learned, self._view.counted
        light = learned.gains[counted].mean(axis=1)
        shares = {
            "has become darker": np.mean(light < 1 - FAINT),
            "has become brighter": np.mean(light > 1 + FAINT),
            "has changed too much to be corrected": learned.beyond,
        }
        return "; ".join(f"{share:.0%} of the view {what}" for what, share in shares.items() if share > 0.005)

    def _approach(self, theta: FloatArray, step_s: float) -> None:
        """Move the applied θ towards the estimated θ, at the largest allowed speed."""
        layout, change = self._comparison.layout, theta - self._applied
        px = float(np.abs(change[layout.all_geometry]).max())
        light = float(np.abs(change[np.concatenate([layout.all_gains, layout.ambient])]).max())
        share = min(1.0, PX_PER_S * step_s / max(px, 1e-9), LIGHT_PER_S * step_s / max(light, 1e-9))
        if px > JUMP_PX:
            share = 1.0
        self._applied = self._applied + share * change

    def _approach_gains(self, step_s: float) -> None:
        """Move the applied row gains towards the learned ones."""
        learned = self._learning.learned.gains
        change, most = learned - self._gains, LEARNED_PER_S * step_s
        if np.abs(change).max() <= most:
            self._number += bool(change.any())
            self._gains = learned
        else:
            self._gains, self._number = self._gains + np.clip(change, -most, most), self._number + 1

    def _moved(self, theta: FloatArray, number: int) -> Moved:
        device, layout = self._view.room.projectors[number], self._comparison.layout
        shape: Shape = device.shape
        M = homography(theta[layout.geometry(number)] / (max(shape) / 2), shape)
        N = np.linalg.inv(M)
        return Moved(np.asarray(N / N[2, 2]), 1 + theta[layout.gain(number)])

    def _projected(self, theta: FloatArray) -> tuple[Projected, ...]:
        found = []
        for number in range(len(self._view.boxes)):
            moved = self._moved(theta, number)
            rows = tuple(tuple(float(v) for v in row) for row in moved.to_raster)
            unsure = (
                float(self._found.unsure[self._comparison.layout.geometry(number)].max()) if self._found else np.inf
            )
            found.append(Projected(rows, tuple(float(v) for v in moved.gain), unsure))
        return tuple(found)

    def _field(self, theta: FloatArray) -> tuple[tuple[tuple[float, ...], ...], ...]:
        field = theta[self._comparison.layout.ambient]
        if not field.any():
            return ()
        rows = (self._view.white * field).reshape(CHANNELS, *FIELD).transpose(1, 2, 0)
        return tuple(tuple(tuple(float(v) for v in cell) for cell in row) for row in rows)

    def _confidence(self) -> float:
        if self._found is None:
            return 0.0
        outliers = np.mean([each.compared.outliers for each in self._taken]) if self._taken else 1.0
        return float(np.mean(self._found.known) * (1 - outliers))


def _named(noun: str, number: int, all_of_them: Sized) -> str:
    return f"the {noun}" if len(all_of_them) == 1 else f"{noun} {number + 1}"


def _rounding(exposures: Exposures, shot: Shot, measured: FloatArray) -> FloatArray:
    """Return the error of radiance (blocks, 3) by rounded code values, which noise may be too weak to blur."""
    codes = np.arange(int(np.iinfo(shot.dtype).max) + 1, dtype=shot.dtype)
    light = exposures.radiance([codes[None]])[0, :, 0].astype(np.float64)
    return np.asarray(ROUNDED * np.interp(measured, light, np.gradient(light)))
