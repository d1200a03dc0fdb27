"""The reference backend: the same pipeline as gl/renderer.py on the CPU, in numpy (`--backend cpu`)."""

import numpy as np
from numpy.typing import NDArray

from player import reference
from player.colour import decoding_of
from player.maps import FarMaps
from player.reference import PreparedRows
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
        self._projector_codes = room.calibration.projector.response.inverse_table()
        self._camera_codes = Response("srgb").inverse_table()

    def open(self, pixels: PixelFormat) -> None:
        check_radiance_size(pixels, self._room.calibration)
        self._pixels = pixels
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

    def render(self, view: str, *, compensate: bool, frame: int = 0) -> None:
        if view == "split":
            plain, corrected = (self._observe(self._drive(compensate=choice)) for choice in (False, True))
            self._linear = reference.split(plain, corrected, self._room.white)
        else:
            drive = self._drive(compensate=compensate)
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

    def finish(self) -> None:
        """Nothing runs in the background."""

    def release(self) -> None:
        """Nothing to give back."""

    def _asked_white(self) -> float:
        return 1.0 if self._radiance else self._room.white

    def _placed(self, target: tuple[int, int]) -> FloatArray:
        spot = place(self._pixels, target)
        return reference.resample(self._picture, target, (spot.left, spot.top, spot.width, spot.height))

    def _drive(self, *, compensate: bool) -> FloatArray:
        calibration = self._room.calibration
        if not compensate:
            picture = self._placed(calibration.projector.shape)
            return np.asarray(np.clip(picture / (self._room.white if self._radiance else 1.0), 0, 1))
        b = reference.desired_light(self._placed(calibration.camera.shape), calibration.ambient, self._asked_white())
        if self._undo is not None:
            b = b - self._undo.apply(b)
        return np.clip(self._correction.apply(b), 0, 1)

    def _observe(self, drive: FloatArray) -> FloatArray:
        near = self._room.calibration.ambient + self._transport.apply(drive)
        return near if self._far is None else near + self._far.apply(drive)


class _FarChain:
    """gather, mix, scatter."""

    def __init__(self, maps: FarMaps) -> None:
        self._steps = [PreparedRows(packed) for packed in (maps.gather, maps.mix, maps.scatter)]

    def apply(self, picture: FloatArray) -> FloatArray:
        for step in self._steps:
            picture = step.apply(picture)
        return picture
