"""Check projector and camera before an acquisition.

Each check gives a finding with one sentence, which includes the remedy if something is wrong. Nothing is stored. The
measured latency becomes the camera's `lag`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.tools.acquisition.cameras.camera import Shot
from counterlight.tools.acquisition.cameras.live import LiveCamera
from counterlight.tools.acquisition.linearity import SHOTS, bends_of, halves_of
from counterlight.tools.acquisition.plan import Codes, Reference, codes_of, mean_of, measure_noise

Grade = Literal["good", "doubtful", "bad"]
SETTLED = 30  # frames after which a picture has arrived and an automatic exposure has acted
TRIALS = 3
# LIT: share of the brightest rise; a smaller share of lit camera pixels is bad, or doubtful
LIT, LEAST_LIT, FEW_LIT = 0.1, 0.001, 0.05
MOST_SATURATED, LEAST_BRIGHT = 0.02, 0.25
MUCH_AMBIENT, MOST_AMBIENT = 0.1, 0.5  # shares of the projector's light above which the grade is doubtful, or bad
OBEYED = 0.15  # tolerance for the test that half the exposure time gives half the light
FOLLOWED = 0.95  # largest share of the code values that half the exposure time may give if the curve is unknown
WATCHED, STEADY, CALM = 12, 0.02, 0.01  # frames that are watched; allowed relative drift and flicker
ADDITIVE = 0.03
# sequence of maximum length, so that all shifts of it differ
SEQUENCE = np.array([1, 1, 1, 1, 0, 0, 0, 1, 0, 0, 1, 1, 0, 1, 0], np.bool_)
FIRST_NUMBER = 1 << 40  # numbers far above the numbers of stored captures, so that simulated noise differs from theirs


@dataclass(frozen=True)
class Finding:
    """The outcome of a check, in one sentence."""

    check: str
    grade: Grade
    sentence: str

    def __str__(self) -> str:
        return f"{self.check:11} {self.grade:9} {self.sentence}"


def preflight(camera: LiveCamera) -> Iterator[Finding]:
    """Run the checks, most basic first; stop after a bad finding, because later checks depend on it."""
    rig = _Rig(camera)
    for check in CHECKS:
        finding = check(rig)
        yield finding
        if finding.grade == "bad":
            return


def refuse_bad(finding: Finding) -> None:
    """Raises InputError for a bad finding."""
    if finding.grade == "bad":
        raise InputError(f"{finding.check}: {finding.sentence}; or skip the checks with --no-preflight")


class _Rig:
    """Shows, waits and photographs for the checks, and keeps the captures of black and white.

    curved : whether the camera has a curve that the acquisition will measure.
    """

    def __init__(self, camera: LiveCamera) -> None:
        self.camera, self._number, self.curved = camera, FIRST_NUMBER, False
        self._slow = SETTLED + camera.lag
        self.black, self.white = (self.shots(level, self._slow) for level in (0, 255))
        rise = self.light(self.white) - self.light(self.black)
        weak = rise.sum(axis=2)
        self.lit = weak > max(LIT * float(np.percentile(weak, 99.9)), 4 * self._noise(), np.finfo(float).tiny)

    def _noise(self) -> float:
        """Returns the standard deviation of the difference of two black captures, summed over channels."""
        again = self.light(self.shots(0, self._slow))
        return float(np.std((again - self.light(self.black)).sum(axis=2)))

    def picture(self, level: int | Codes) -> Codes:
        return np.full((*self.camera.screen.shape, 3), level, np.uint8) if isinstance(level, int) else level

    def shots(self, level: int | Codes, wait: int | None = None) -> tuple[Shot, ...]:
        """Capture a picture after `wait` frames; None waits for the camera's lag."""
        usual, self.camera.lag = self.camera.lag, self.camera.lag if wait is None else wait
        try:
            self._number += 1
            return self.camera.capture(self._number, self.picture(level))
        finally:
            self.camera.lag = usual

    def light(self, shots: tuple[Shot, ...]) -> FloatArray:
        return np.asarray(self.camera.exposures.radiance(shots), np.float64)

    def frames(self, level: int | Codes, count: int) -> Iterator[FloatArray]:
        """Show a picture and yield the mean light (3,) of the lit pixels per frame, at the shortest exposure."""
        self._number += 1
        exposures = self.camera.exposures
        self.camera.device.expose(exposures.shortest)
        self.camera.show(self.picture(level))
        self.camera.device.begin(self._number)
        for _ in range(count):
            yield exposures.one(self.camera.device.frame(), exposures.shortest)[self.lit].mean(axis=0)

    def above_black(self, level: int | Codes) -> FloatArray:
        """Returns the light of a picture above black, summed over the lit pixels: (3,)."""
        return np.asarray((self.light(self.shots(level)) - self.light(self.black))[self.lit].sum(axis=0))


def projector(rig: _Rig) -> Finding:
    share = float(rig.lit.mean())
    if share < LEAST_LIT:
        return Finding(
            "projector", "bad", f"white instead of black changes {100 * share:.2f} % of the camera's picture: switch "
            "the projector on, point the camera at its picture, or expose longer",
        )  # fmt: skip
    if share < FEW_LIT:
        return Finding("projector", "doubtful", f"it fills {100 * share:.1f} % of the camera's picture: zoom in")
    return Finding("projector", "good", f"it fills {100 * share:.0f} % of the camera's picture")


def saturation(rig: _Rig) -> Finding:
    share = float(rig.camera.exposures.saturated(rig.white).mean())
    if share > MOST_SATURATED:
        return Finding("saturation", "bad", f"{100 * share:.1f} % of the camera's pixels are at the top: expose less")
    top = float(np.percentile(np.concatenate([shot.ravel() for shot in rig.white]), 99.9))
    top /= np.iinfo(rig.white[0].dtype).max
    if top < LEAST_BRIGHT:
        return Finding("saturation", "doubtful", f"white reaches {100 * top:.0f} % of the range: expose longer")
    return Finding("saturation", "good", f"white reaches {100 * top:.0f} % of the range, {100 * share:.2f} % are above")


def ambient(rig: _Rig) -> Finding:
    black, white = (float(rig.light(shots)[rig.lit].mean()) for shots in (rig.black, rig.white))
    share = black / max(white - black, np.finfo(float).tiny)
    says = f"with the projector black the room has {100 * share:.1f} % of its light"
    known = rig.camera.exposures.known  # without a known curve, the share is measured in codes, which overstate it
    grade: Grade = "bad" if share > MOST_AMBIENT and known else "doubtful" if share > MUCH_AMBIENT else "good"
    return Finding("ambient", grade, says if grade == "good" else f"{says}: switch lamps off, close the curtains")


def exposure(rig: _Rig) -> Finding:
    """Check that half the exposure time gives half the light."""
    device, clear = rig.camera.device, rig.lit & ~rig.camera.exposures.saturated(rig.white)
    rig.camera.show(rig.picture(255))
    levels = []
    for share in (1, 0.5):
        device.expose(share * rig.camera.exposures.shortest)
        rig.camera.wait(rig._slow)
        levels.append(rig.camera.exposures.one(device.frame(), 1.0)[clear].mean())
    ratio = float(levels[1] / levels[0]) if levels[0] > 0 else 0.0
    known = rig.camera.exposures.known
    if not known and ratio <= FOLLOWED:
        return Finding("exposure", "good", f"half the exposure time gives {100 * ratio:.1f} % of the code values")
    if not known or abs(2 * ratio - 1) > OBEYED:
        return Finding(
            "exposure", "bad", f"half the exposure time gives {100 * ratio:.0f} % of the light, not 50 %: the camera "
            "ignores it (switch its automatic exposure off) or its response is another one (--camera-response)",
        )  # fmt: skip
    return Finding("exposure", "good", f"half the exposure time gives {100 * ratio:.1f} % of the light")


def latency(rig: _Rig) -> Finding:
    """Count the frames until a new picture is visible, from black to white and back; sets the camera's lag.

    The first frame may still show part of the previous picture, so the lag is one frame longer.
    """
    levels = [np.mean(list(rig.frames(level, 1))) for level in _settled(rig, (0, 255))]
    found = []
    for trial in range(2 * TRIALS):
        black = trial % 2 == 0  # white is on when the trials begin
        brighter = np.array([frame.mean() > np.mean(levels) for frame in rig.frames(0 if black else 255, SETTLED)])
        arrived = np.flatnonzero(brighter != black)
        if not arrived.size:
            return Finding(
                "latency", "bad", f"a new picture is not seen within {SETTLED} frames: the camera's frames are old or "
                "its exposure is automatic; lock it, and set its buffer to one frame",
            )  # fmt: skip
        found.append(int(arrived[0]))
    least, most = min(found), max(found)
    rig.camera.lag = most + 1
    says = f"{least} to {most} frames from the projector to the camera, {rig.camera.lag} are let pass"
    return Finding("latency", "good" if most - least <= 2 else "doubtful", says)


def own_pattern(rig: _Rig) -> Finding:
    """Check that each capture shows its own picture, with a black-and-white sequence in which every shift differs."""
    middle = sum(float(rig.light(shots)[rig.lit].mean()) for shots in (rig.black, rig.white)) / 2
    seen = [rig.light(rig.shots(255 if bit else 0))[rig.lit].mean() > middle for bit in SEQUENCE]
    wrong = int(np.sum(np.array(seen) != SEQUENCE))
    if wrong:
        return Finding(
            "own pattern", "bad", f"{wrong} of {SEQUENCE.size} captures show another picture than projected: switch "
            "off frame interpolation in the projector, and whatever else delays pictures",
        )  # fmt: skip
    return Finding("own pattern", "good", f"each of {SEQUENCE.size} captures shows what was projected for it")


def locked(rig: _Rig) -> Finding:
    """Check that white after a long black keeps its brightness and colour."""
    for _ in _settled(rig, (0,)):
        pass
    frames = np.array(list(rig.frames(255, rig.camera.lag + WATCHED)))[rig.camera.lag :]
    early, late = frames[:3].mean(axis=0), frames[-3:].mean(axis=0)
    ratio = late / np.maximum(early, np.finfo(float).tiny)
    drift, tint = float(ratio.mean() - 1), float(np.ptp(ratio))
    if tint > STEADY:
        return Finding("locked", "bad", f"white changes colour by {100 * tint:.1f} %: lock the camera's white balance")
    if abs(drift) > STEADY:
        return Finding(
            "locked", "bad", f"white drifts by {100 * drift:+.1f} % in {WATCHED} frames: lock the camera's exposure "
            "and gain, and let the lamp warm up",
        )  # fmt: skip
    return Finding("locked", "good", f"white stays within {100 * max(abs(drift), tint):.2f} % for {WATCHED} frames")


def flicker(rig: _Rig) -> Finding:
    """Check for flicker: an exposure that is no multiple of the refresh time catches unequal parts of two pictures."""
    frames = np.array([frame.mean() for frame in rig.frames(255, rig.camera.lag + WATCHED)])[rig.camera.lag :]
    beats = float(np.std(np.diff(frames)) / np.sqrt(2) / max(frames.mean(), np.finfo(float).tiny))
    hz, times = rig.camera.screen.refresh_hz, rig.camera.exposures.times
    if beats > CALM:
        period = f"1/{hz:.0f} s" if hz else "the projector's refresh time"
        return Finding("flicker", "bad", f"white flickers by {100 * beats:.1f} %: expose for a multiple of {period}")
    if hz and rig.camera.device.timed and any(_uneven(time * hz) for time in times):
        return Finding("flicker", "doubtful", f"exposures suit {hz:.0f} Hz badly: take multiples of {1000 / hz:.1f} ms")
    return Finding("flicker", "good", f"white flickers by {100 * beats:.2f} % from frame to frame")


def linearity(rig: _Rig) -> Finding:
    """Check that the camera sees the sum of two pictures where both give light."""
    blacks, whites = ([rig.light(rig.shots(level)) for _ in range(2)] for level in (0, 255))
    noise, saturated = measure_noise(blacks, whites), rig.camera.exposures.saturated(rig.white)
    room = Reference(mean_of(blacks), mean_of(whites), noise, saturated, 2)
    half = halves_of(rig.camera.screen.shape)
    seen = [mean_of([rig.light(rig.shots(codes_of(each))) for _ in range(SHOTS)]) for each in (half, ~half)]
    bends = [bend for bend in bends_of(rig.camera, room, *seen) if bend is not None]
    if not bends:
        return Finding("linearity", "doubtful", "too dark to tell whether the camera is linear: expose longer")
    worst = max(bends, key=lambda bend: abs(bend.amount))
    rig.curved = not rig.camera.exposures.known and not worst.is_linear
    if rig.curved:
        return Finding(
            "linearity", "good", f"half and half of the light are captured as {100 * (1 + worst.amount):.0f} % of the "
            "whole: the camera has a curve, which the acquisition measures",
        )  # fmt: skip
    if not worst.is_linear:
        return Finding("linearity", "bad", worst.described(rig.camera.exposures.response))
    return Finding("linearity", "good", f"the camera is linear to {100 * abs(worst.amount):.1f} %")


def additivity(rig: _Rig) -> Finding:
    """Check that two halves add up to the whole, and red, green and blue to white."""
    if rig.curved:
        return Finding("additivity", "good", "the acquisition checks it, once the camera's curve is known")
    height, width = rig.camera.screen.shape
    checks = (np.arange(height)[:, None] // 8 + np.arange(width) // 8) % 2 == 1
    white = rig.above_black(255)
    halves = rig.above_black(codes_of(checks)) + rig.above_black(codes_of(~checks))
    colours = np.zeros(3)
    for channel in range(3):
        codes = np.zeros((height, width, 3), np.uint8)
        codes[..., channel] = 255
        colours += rig.above_black(codes)
    apart, segment = float(np.abs(halves / white - 1).max()), float(np.abs(colours / white - 1).max())
    if segment > ADDITIVE:
        can_be = apart <= ADDITIVE
        return Finding(
            "additivity", "doubtful" if can_be else "bad", f"red, green and blue differ from white by "
            f"{100 * segment:.0f} %: switch off the projector's white segment (brilliant colour) and colour enhancement"
            f"{', or see whether the acquisition can take it out' if can_be else ''}",
        )  # fmt: skip
    if apart > ADDITIVE:
        return Finding(
            "additivity", "bad", f"two half pictures differ from white by {100 * apart:.0f} %: switch off the "
            "projector's dynamic contrast and lamp saving, and lock the camera's exposure",
        )  # fmt: skip
    return Finding("additivity", "good", f"light adds up to {100 * max(apart, segment):.1f} %")


def _settled(rig: _Rig, levels: tuple[int, ...]) -> Iterator[int]:
    """Show each level, wait until it has arrived, and yield it."""
    for level in levels:
        rig.camera.show(rig.picture(level))
        rig.camera.wait(rig._slow)
        yield level


def _uneven(periods: float) -> bool:
    """Whether an exposure is short (under 20 refreshes) and not close to a whole number of refreshes."""
    return periods < 20 and abs(periods - max(1, round(periods))) > 0.05 * periods


Check = Callable[[_Rig], Finding]
CHECKS: tuple[Check, ...] = (
    projector, saturation, ambient, exposure, latency, own_pattern, locked, flicker, linearity, additivity,
)  # fmt: skip
