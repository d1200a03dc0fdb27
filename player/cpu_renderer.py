"""The reference backend: the same pipeline as gl/renderer.py on the CPU, in numpy (`--backend cpu`)."""

import numpy as np
from numpy.typing import NDArray

from player import reference
from player.colour import decoding_of
from player.content import SceneCuts
from player.maps import FarMaps, RefinementMaps
from player.reference import PreparedRows
from player.refinement import GREY, OVER_RELAXATION, Certificate, momentum
from player.renderer import Room, check_radiance_size, place
from player.response import Response, transfer_table
from player.video import Frame, PixelFormat

FloatArray = NDArray[np.floating]


class CpuRenderer:
    """Renderer in numpy; see player.renderer.Renderer."""

    def __init__(self, room: Room) -> None:
        self._room = room
        self._correction = PreparedRows(room.maps.correction)
        self._transport = PreparedRows(room.maps.transport)
        self._far = None if room.maps.far is None else _FarChain(room.maps.far)
        self._undo = None if room.maps.undo is None else _FarChain(room.maps.undo)
        self._refinement = None if room.maps.refinement is None else _Refinement(room.maps.refinement)
        self._projector_codes = room.calibration.projector.response.inverse_table()
        self._camera_codes = Response("srgb").inverse_table()

    def open(self, pixels: PixelFormat) -> None:
        check_radiance_size(pixels, self._room.calibration)
        self._pixels, self._cuts = pixels, SceneCuts()
        self._before: FloatArray | None = None  # what refinement changed in the frame before
        self._now: FloatArray | None = None  # and in this one
        self._radiance = pixels.layout == "radiance"
        self._decoding = None if self._radiance else decoding_of(pixels)
        self._transfer = transfer_table("linear" if self._radiance else pixels.transfer)

    def upload(self, frame: Frame) -> None:
        luma, chroma = self._pixels.planes[:2]
        self._picture = reference.planes_to_linear(
            frame.planes,
            (luma.height, luma.width),
            (chroma.height, chroma.width),
            self._decoding,
            self._transfer,
            self._pixels.rotation,
        )
        self._before, self._now = None if self._cuts.starts_with(frame) else self._now, None

    def render(self, view: str, *, compensate: bool, frame: int = 0, steps: int = 0) -> None:
        self._compensated: tuple[FloatArray, FloatArray] | None = None
        if view == "split":
            plain, corrected = self._observe(self._plain_drive()), self._observe(self._drive(steps))
            self._linear = reference.split(plain, corrected, self._room.white)
        else:
            drive = self._drive(steps) if compensate else self._plain_drive()
            self._linear = drive if view == "projector" else self._observe(drive)
        self._view, self._frame = view, frame

    def encoded(self) -> NDArray[np.uint8]:
        if self._view == "projector":
            return reference.encode(self._linear, self._projector_codes, 1.0, self._room.dither, self._frame)
        return reference.encode(self._linear, self._camera_codes, self._room.white)

    def linear(self) -> NDArray[np.float32]:
        return self._linear.astype(np.float32)

    def desired(self) -> NDArray[np.float32]:
        return (self._asked_white() * self._placed(self._room.calibration.camera.shape)).astype(np.float32)

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

    def _asked_white(self) -> float:
        return 1.0 if self._radiance else self._room.white

    def _placed(self, target: tuple[int, int]) -> FloatArray:
        spot = place(self._pixels, target)
        return reference.resample(self._picture, target, (spot.left, spot.top, spot.width, spot.height))

    def _plain_drive(self) -> FloatArray:
        picture = self._placed(self._room.calibration.projector.shape)
        return np.asarray(np.clip(picture / (self._room.white if self._radiance else 1.0), 0, 1))

    def _drive(self, steps: int) -> FloatArray:
        calibration = self._room.calibration
        b = reference.desired_light(self._placed(calibration.camera.shape), calibration.ambient, self._asked_white())
        if self._refinement is None or not steps:
            drive = np.clip(self._product(b), 0, 1)
        else:
            drive = self._refined(b, steps, self._refinement)
        self._compensated = drive, b
        return drive

    def _product(self, b: FloatArray) -> FloatArray:
        """T⁺ b of the near light, the far light of the compensated picture taken out."""
        return self._correction.apply(b if self._undo is None else b - self._undo.apply(b))

    def _refined(self, b: FloatArray, steps: int, refinement: "_Refinement") -> FloatArray:
        if self._room.start == "direct":
            return self._descend(np.clip(refinement.direct.apply(b), 0, 1), b, steps, refinement)
        if self._room.start == "grey":
            return self._descend(np.full((*self._room.calibration.projector.shape, 3), GREY), b, steps, refinement)
        product = self._product(b)
        change = np.zeros_like(product) if self._before is None or self._room.start == "map" else self._before
        drive = self._descend(reference.combine(product, change, 1.0, clamp=True), b, steps, refinement)
        self._now = reference.combine(drive, product, -1.0)
        return drive

    def _descend(self, p: FloatArray, b: FloatArray, steps: int, refinement: "_Refinement") -> FloatArray:
        y = p
        for step in range(1, steps + 1):
            descent = refinement.descent(b - self._light(y))
            p, y = reference.refinement_step(descent, y, p, refinement.step_size, momentum(step), OVER_RELAXATION)
        return p

    def _light(self, drive: FloatArray) -> FloatArray:
        """T p."""
        near = self._transport.apply(drive)
        return near if self._far is None else near + self._far.apply(drive)

    def _observe(self, drive: FloatArray) -> FloatArray:
        return self._room.calibration.ambient + self._light(drive)


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
