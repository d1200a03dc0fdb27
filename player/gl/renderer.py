"""The GPU backend: planes -> linear picture -> placed in the camera's view -> b -> drive -> 8 bit (thesis 5.2).

Every texture and program is made when the room or the medium is opened, or when something is first asked for (a view, a
property of the picture); a frame allocates nothing.
"""

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.adjustments import NEUTRAL, Adjustments
from counterlight.content import SceneCuts
from counterlight.gl.adaptation import Damper
from counterlight.gl.decoding import Decoder
from counterlight.gl.passes import Owner, Pass, float_texture, picture_texture
from counterlight.gl.paths import FarPass, Product, StoredMap, StoredMaps, store_maps
from counterlight.gl.refinement import Refiner
from counterlight.gl.request import Request, read
from counterlight.gl.starts import DirectStart, GreyStart, MapStart, PreviousStart, Start
from counterlight.gl.views import Encoder, Maps, Observer
from counterlight.maps import RefinementMaps
from counterlight.refinement import Certificate
from counterlight.renderer import check_radiance_size
from counterlight.response import Response
from counterlight.room import Room
from counterlight.video import Frame, PixelFormat


class GlRenderer:
    """Renderer in OpenGL 3.3, or 4.3 where it is the faster; see renderer.Renderer. The caller owns the context.

    No part of it refers back to it, so that a reload frees the room that it replaces, and not some later collection.

    path : one of counterlight.renderer.PATHS.
    """

    def __init__(self, context: moderngl.Context, room: Room, path: str = "fragment") -> None:
        self._context, self._room = context, room
        self._owner, self._medium = Owner(), Owner()
        self._adjustments = NEUTRAL
        self._opened = False
        self._damper: Damper | None = None
        try:
            self._build(path)
        except BaseException:
            self._owner.release()
            raise

    def _build(self, path: str) -> None:
        context, room, own = self._context, self._room, self._owner.own
        maps, calibration = room.maps, room.calibration
        camera, projector = calibration.camera.shape, calibration.projector.shape
        ambient = own(picture_texture(context, calibration.ambient))
        stored = own(store_maps(context, room, path))
        self.path = stored.report
        self._correction = stored.of(maps.correction)
        self._correct = own(self._correction.product("CLAMP"))
        undo = None if maps.undo is None else own(FarPass(stored.chain(maps.undo), "SUBTRACT_FROM_BASE"))
        self._near_light = _NearLight(undo)
        self._unclamped = own(_Unclamped(self._correction, self._near_light))
        transport = stored.of(maps.transport)
        far = None if maps.far is None else stored.chain(maps.far)
        self._refiner = None
        if maps.refinement is not None:
            self._refiner = own(Refiner(context, stored, maps.refinement, calibration.mask))
            self._start = own(self._make_start(stored, maps.refinement))
        self._observers = [own(Observer(transport, far, ambient)) for _ in range(2)]
        self._maps = own(Maps(context, room, transport, far, ambient))
        self._request = own(Request(context, room, ambient, self._maps, self._near_light))
        self._split = own(Pass(context, "split.frag", float_texture(context, camera), line=room.white))
        self._projector_view = own(Encoder(context, projector, calibration.projector.response, 1.0, room.dither))
        self._camera_view = own(Encoder(context, camera, Response("srgb"), room.white, "none"))

    def _make_start(self, stored: StoredMaps, maps: RefinementMaps) -> Start:
        context, projector = self._context, self._room.calibration.projector.shape
        start = self._room.start
        if start == "previous-direct":
            return PreviousStart(context, projector, self._owner.own(stored.of(maps.direct).product()).run)
        if start == "direct":
            return DirectStart(stored.of(maps.direct))
        if start == "grey":
            return GreyStart(context, projector)
        if start == "map":
            correct, near_light = self._correct, self._near_light
            return MapStart(lambda b: correct.run(near_light(b)))
        return PreviousStart(context, projector, self._unclamped)

    def open(self, pixels: PixelFormat) -> None:
        check_radiance_size(pixels, self._room.calibration)
        self._medium.release()
        self._decoder = self._medium.own(Decoder(self._context, pixels))
        self._decoder.adjust(self._adjustments)
        self._request.open(pixels, self._adjustments)
        self._cuts = SceneCuts()
        self._opened = True

    def adjust(self, adjustments: Adjustments) -> None:
        previous, self._adjustments = self._adjustments, adjustments
        if self._opened:
            self._decoder.adjust(adjustments)
            self._request.adjust(adjustments)
        if adjustments.flicker and self._damper is None:
            self._damper = self._owner.own(Damper(self._context, self._room.calibration.projector.shape))
        if self._damper is not None and not previous.flicker:
            self._damper.restart()

    def upload(self, frame: Frame) -> None:
        self._decoder.upload(frame.planes)
        cut = self._cuts.starts_with(frame)
        self._request.advance(cut=cut, duration_s=frame.duration_s)
        if self._refiner is not None:
            self._start.advance(cut=cut)
        if self._damper is not None:
            self._damper.advance(cut=cut)

    def render(self, view: str, *, compensate: bool, frame: int = 0, steps: int = 0) -> None:
        self._decoded = self._decoder.run()
        self._compensated: tuple[moderngl.Texture, moderngl.Texture] | None = None
        self._linear = self._shown(view, compensate=compensate and self._adjustments.card is None, steps=steps)
        encoder = self._projector_view if view == "projector" else self._camera_view
        self._encoded = encoder.run(self._linear, frame)

    @property
    def encoded_texture(self) -> moderngl.Texture:
        """The rendered view, RGBA8, row 0 at the top."""
        return self._encoded

    def encoded(self) -> NDArray[np.uint8]:
        return read(self._encoded, np.uint8)

    def linear(self) -> NDArray[np.float32]:
        return read(self._linear, np.float32)

    def desired(self) -> NDArray[np.float32]:
        return self._request.desired(self._decoder.run())

    def finish(self) -> None:
        self._context.finish()

    def certificate(self) -> Certificate | None:
        if self._refiner is None or self._compensated is None:
            return None
        return self._refiner.certify(*self._compensated)

    def release(self) -> None:
        self._medium.release()
        self._owner.release()

    def _shown(self, view: str, *, compensate: bool, steps: int) -> moderngl.Texture:
        if view == "impossible":
            return self._maps.impossible()
        if view == "projector":
            return self._shown_to_projector(compensate=compensate, steps=steps)
        if self._adjustments.card is not None:
            return self._observers[0].run(self._request.plain(self._decoded))
        b = self._request.light(self._decoded)
        if view == "split":
            drives = self._request.plain(self._decoded), self._drive(b, steps)
            plain, corrected = (observe.run(drive) for observe, drive in zip(self._observers, drives, strict=True))
            seen = self._split.run(left=plain, right=corrected)
        else:
            seen = self._observers[0].run(self._drive(b, steps) if compensate else self._request.plain(self._decoded))
        if view == "error":
            seen = self._maps.error(seen, b)
        return self._maps.over_camera(seen, self._near_light(b)) if self._adjustments.clipping else seen

    def _shown_to_projector(self, *, compensate: bool, steps: int) -> moderngl.Texture:
        if not compensate:
            return self._request.plain(self._decoded)
        b = self._request.light(self._decoded)
        drive = self._drive(b, steps)
        return self._maps.over_projector(drive, self._unclamped(b)) if self._adjustments.clipping else drive

    def _drive(self, b: moderngl.Texture, steps: int) -> moderngl.Texture:
        if self._refiner is None or not steps:
            drive = self._correct.run(self._near_light(b))
        else:
            last = self._refiner.run(self._start.run(b), b, steps)
            self._start.keep(last)
            drive = last.p
        if self._damper is not None and self._adjustments.flicker:
            drive = self._damper.run(drive, self._adjustments.flicker)
        self._compensated = drive, b
        return drive


class _NearLight:
    """b -> b without the far light of the compensated picture."""

    def __init__(self, undo: FarPass | None) -> None:
        self._undo = undo

    def __call__(self, b: moderngl.Texture) -> moderngl.Texture:
        return b if self._undo is None else self._undo.run(b, b)


class _Unclamped:
    """b -> T⁺ b of the near light; built when first asked."""

    def __init__(self, correction: StoredMap, near_light: _NearLight) -> None:
        self._correction, self._near_light = correction, near_light
        self._product: Product | None = None

    def __call__(self, b: moderngl.Texture) -> moderngl.Texture:
        if self._product is None:
            self._product = self._correction.product()
        return self._product.run(self._near_light(b))

    def release(self) -> None:
        if self._product is not None:
            self._product.release()
