"""The reference backend: the same pipeline as gl/renderer.py on the CPU, in numpy (`--backend cpu`)."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from counterlight import reference
from counterlight.adjustments import NEUTRAL, Adjustments, adjusted_decoding, adjusted_transfer
from counterlight.colour import decoding_of
from counterlight.content import SceneCuts, Succession, approach
from counterlight.maps import FarMaps, RefinementMaps
from counterlight.placement import homography, place
from counterlight.reference import Limits, PreparedRows
from counterlight.refinement import GREY, OVER_RELAXATION, Certificate, momentum
from counterlight.renderer import LONG_BYTES, PathReport, check_radiance_size
from counterlight.response import Response, transfer_table
from counterlight.room import Room
from counterlight.test_cards import card
from counterlight.video import Frame, PixelFormat

FloatArray = NDArray[np.floating]
NO_TONE = 1.0, 0.0


class CpuRenderer:
    """Renderer in numpy; see counterlight.renderer.Renderer."""

    def __init__(self, room: Room) -> None:
        self._room, self.path = room, PathReport("cpu", LONG_BYTES)
        self._correction = PreparedRows(room.maps.correction)
        self._transport = PreparedRows(room.maps.transport)
        self._far = None if room.maps.far is None else _FarChain(room.maps.far)
        self._undo = None if room.maps.undo is None else _FarChain(room.maps.undo)
        self._refinement = None if room.maps.refinement is None else _Refinement(room.maps.refinement)
        self._adjustments = NEUTRAL
        self._adaptation, self._damping = _Carried(lasting=True), _Carried(lasting=False)
        self._projector_codes = room.calibration.projector.response.inverse_table()
        self._camera_codes = Response("srgb").inverse_table()

    def open(self, pixels: PixelFormat) -> None:
        check_radiance_size(pixels, self._room.calibration)
        self._pixels, self._cuts = pixels, SceneCuts()
        self._before: tuple[FloatArray, FloatArray, int] | None = None  # p − T⁺ b, y − p and steps of the frame before
        self._now: tuple[FloatArray, FloatArray, int] | None = None  # and of this one
        self._radiance = pixels.layout == "radiance"
        self._upright: FloatArray | None = None
        self._unit = 1 / self._room.white if self._radiance else 1.0
        self._adaptation, self._damping = _Carried(lasting=True), _Carried(lasting=False)

    def adjust(self, adjustments: Adjustments) -> None:
        previous, self._adjustments = self._adjustments, adjustments
        self._upright = None
        if (adjustments.adapt, adjustments.black_level) != (previous.adapt, previous.black_level):
            self._adaptation.restart()
        if not previous.flicker:
            self._damping.restart()

    def upload(self, frame: Frame) -> None:
        self._planes, self._upright = [plane.copy() for plane in frame.planes], None
        cut = self._cuts.starts_with(frame)
        self._before, self._now = None if cut else self._now, None
        self._adaptation.advance(cut=cut, duration_s=frame.duration_s)
        self._damping.advance(cut=cut, duration_s=frame.duration_s)

    def render(self, view: str, *, compensate: bool, frame: int = 0, steps: int = 0) -> None:
        self._compensated: tuple[FloatArray, FloatArray] | None = None
        self._linear = self._shown(view, compensate=compensate and self._adjustments.card is None, steps=steps)
        self._view, self._frame = view, frame

    def encoded(self) -> NDArray[np.uint8]:
        if self._view == "projector":
            return reference.encode(self._linear, self._projector_codes, 1.0, self._room.dither, self._frame)
        return reference.encode(self._linear, self._camera_codes, self._room.white)

    def linear(self) -> NDArray[np.float32]:
        return self._linear.astype(np.float32)

    def desired(self) -> NDArray[np.float32]:
        return self._asked().astype(np.float32)

    def certificate(self) -> Certificate | None:
        if self._refinement is None or self._compensated is None:
            return None
        drive, b = self._compensated
        residual = b - self._light(drive)
        error = reference.squared_error(residual, self._room.calibration.mask)
        gap = reference.gap_terms(self._refinement.descent(residual), drive)
        return Certificate(error.sum(axis=(0, 1)), gap.sum(axis=(0, 1)))

    def finish(self) -> None:
        """Nothing runs in the background."""

    def release(self) -> None:
        """Nothing to give back."""

    @property
    def _decoded(self) -> FloatArray:
        if self._upright is None:
            self._upright = self._decode()
        return self._upright

    def _decode(self) -> FloatArray:
        pixels, decoding, lift = self._pixels, None, 0.0
        transfer = transfer_table("linear" if self._radiance else pixels.transfer)
        if not self._radiance:
            decoding, lift = adjusted_decoding(decoding_of(pixels), pixels, self._adjustments)
            transfer = adjusted_transfer(transfer, self._adjustments)
        luma, chroma = ((plane.height, plane.width) for plane in pixels.planes[:2])
        return reference.planes_to_linear(self._planes, luma, chroma, decoding, transfer, pixels.rotation, lift)

    def _placed(self, target: tuple[int, int]) -> FloatArray:
        spot = place(self._pixels, target)
        return reference.resample(self._decoded, target, (spot.left, spot.top, spot.width, spot.height))

    def _asked(self) -> FloatArray:
        """c, the radiance in the camera's view."""
        adjustments, camera, white = self._adjustments, self._room.calibration.camera.shape, self._room.white
        if adjustments.corners is None:
            placed = self._placed(camera)
        else:
            H = homography(adjustments.corners, camera, self._decoded.shape[:2])
            placed = reference.pinned(self._decoded, camera, H)
        tone = self._tone(placed) if adjustments.adapt else NO_TONE
        return reference.desired_light(placed, 0.0, white, tone, self._unit, adjustments.black_level)

    def _tone(self, placed: FloatArray) -> FloatArray:
        u = reference.desired_light(placed, 0.0, 1.0, NO_TONE, self._unit, self._adjustments.black_level)
        budget = self._adjustments.adapt / 100
        found = reference.tone_of(u, self._near_light(u), self._limits, self._room.white, budget)
        return self._adaptation.blended(found, 1 - approach(self._adaptation.elapsed_s))

    def _plain_drive(self) -> FloatArray:
        if self._adjustments.card is not None:
            return card(self._adjustments.card, self._room.calibration.projector.shape)
        placed = self._placed(self._room.calibration.projector.shape)
        drive = reference.desired_light(placed, 0.0, 1.0, NO_TONE, self._unit, self._adjustments.black_level)
        return np.clip(drive, 0, 1)

    def _shown(self, view: str, *, compensate: bool, steps: int) -> FloatArray:
        if view == "impossible":
            return reference.impossible(self._reach, self._room.white)
        if view == "projector":
            return self._shown_to_projector(compensate=compensate, steps=steps)
        if self._adjustments.card is not None:
            return self._observe(self._plain_drive())
        ambient, white = self._room.calibration.ambient, self._room.white
        b = self._asked() - ambient
        if view == "split":
            plain, corrected = self._observe(self._plain_drive()), self._observe(self._drive(b, steps))
            seen = reference.split(plain, corrected, white)
        else:
            seen = self._observe(self._drive(b, steps) if compensate else self._plain_drive())
        if view == "error":
            seen = reference.error_map(seen, ambient, b, self._reach, white)
        if not self._adjustments.clipping:
            return seen
        return reference.clipping(seen, self._near_light(b), self._limits.most[..., :3], white)

    def _shown_to_projector(self, *, compensate: bool, steps: int) -> FloatArray:
        if not compensate:
            return self._plain_drive()
        b = self._asked() - self._room.calibration.ambient
        drive = self._drive(b, steps)
        return reference.clipping(drive, self._product(b), 1.0, 1.0) if self._adjustments.clipping else drive

    def _drive(self, b: FloatArray, steps: int) -> FloatArray:
        if self._refinement is None or not steps:
            drive: FloatArray = np.clip(self._product(b), 0, 1)
        else:
            drive = self._refined(b, steps, self._refinement)
        if self._adjustments.flicker:
            drive = self._damping.blended(drive, self._adjustments.flicker)
        self._compensated = drive, b
        return drive

    @cached_property
    def _reach(self) -> FloatArray:
        calibration = self._room.calibration
        full = self._observe(np.ones((*calibration.projector.shape, 3)))
        return reference.reach_of(full, calibration.ambient, calibration.mask)

    @cached_property
    def _limits(self) -> Limits:
        calibration = self._room.calibration
        ambient = calibration.ambient.astype(np.float64)
        near = self._transport.apply(np.ones((*calibration.projector.shape, 3)))
        most = reference.reach_of(near, np.zeros_like(near), calibration.mask)
        return Limits(self._near_light(np.ones_like(ambient)), self._near_light(ambient), ambient, most)

    def _product(self, b: FloatArray) -> FloatArray:
        """T⁺ b of the near light, the far light of the compensated picture taken out."""
        return self._correction.apply(self._near_light(b))

    def _near_light(self, b: FloatArray) -> FloatArray:
        """b without the far light of the compensated picture."""
        return b if self._undo is None else b - self._undo.apply(b)

    def _refined(self, b: FloatArray, steps: int, refinement: "_Refinement") -> FloatArray:
        if self._room.start == "direct":
            start = np.clip(refinement.direct.apply(b), 0, 1)
        elif self._room.start == "grey":
            start = np.full((*self._room.calibration.projector.shape, 3), GREY)
        elif self._room.start == "map":
            start = np.clip(self._product(b), 0, 1)
        else:
            first = refinement.direct.apply(b) if self._room.start == "previous-direct" else self._product(b)
            return self._continued(first, b, steps, refinement)
        return self._descend(_Iterate(start, start, 0), b, steps, refinement).p

    def _continued(self, first: FloatArray, b: FloatArray, steps: int, refinement: "_Refinement") -> FloatArray:
        """From `first`, T⁺ b or direct mapping, changed as in the frame before."""
        nothing = np.zeros_like(first)
        change, ahead, made = self._before or (nothing, nothing, 0)
        start = reference.combine(first, change, 1.0, clamp=True)
        last = self._descend(_Iterate(start, start + ahead, made), b, steps, refinement)
        self._now = reference.combine(last.p, first, -1.0), reference.combine(last.y, last.p, -1.0), last.steps
        return last.p

    def _descend(self, start: "_Iterate", b: FloatArray, steps: int, refinement: "_Refinement") -> "_Iterate":
        p, y, made = start
        for step in range(made + 1, made + steps + 1):
            descent = refinement.descent(b - self._light(y))
            p, y = reference.refinement_step(descent, y, p, refinement.step_size, momentum(step), OVER_RELAXATION)
        return _Iterate(p, y, made + steps)

    def _light(self, drive: FloatArray) -> FloatArray:
        """T p."""
        near = self._transport.apply(drive)
        return near if self._far is None else near + self._far.apply(drive)

    def _observe(self, drive: FloatArray) -> FloatArray:
        return self._room.calibration.ambient + self._light(drive)


class _Iterate(NamedTuple):
    """p and y of player/refinement.py, and how many steps led there since the last cut."""

    p: FloatArray
    y: FloatArray
    steps: int


class _Carried:
    """What a frame takes over from the one before."""

    def __init__(self, *, lasting: bool) -> None:
        self._succession = Succession(lasting=lasting)
        self._before: FloatArray | None = None
        self._now: FloatArray | None = None

    @property
    def elapsed_s(self) -> float:
        return self._succession.elapsed_s

    def advance(self, *, cut: bool, duration_s: float) -> None:
        if self._succession.advance(cut=cut, duration_s=duration_s):
            self._before = self._now

    def restart(self) -> None:
        self._succession.restart()

    def blended(self, now: FloatArray, weight: float) -> FloatArray:
        """(1 − weight) now + weight of what the frame before left; kept for the next one."""
        before = now if self._succession.fresh or self._before is None else self._before
        self._now = reference.blend(now, before, weight)
        self._succession.draw()
        return self._now


class _Refinement:
    """Tᵀ, the step sizes and direct mapping."""

    def __init__(self, maps: RefinementMaps) -> None:
        self._dual, self.direct, self.step_size = PreparedRows(maps.dual), PreparedRows(maps.direct), maps.step_size
        self._far_dual = None if maps.far_dual is None else _FarChain(maps.far_dual)

    def descent(self, residual: FloatArray) -> FloatArray:
        """Tᵀ(b − T p) of b − T p."""
        near = self._dual.apply(residual)
        return near if self._far_dual is None else near + self._far_dual.apply(residual)


class _FarChain:
    """gather, mix, scatter."""

    def __init__(self, maps: FarMaps) -> None:
        self._steps = [PreparedRows(packed) for packed in (maps.gather, maps.mix, maps.scatter)]

    def apply(self, picture: FloatArray) -> FloatArray:
        for step in self._steps:
            picture = step.apply(picture)
        return picture
