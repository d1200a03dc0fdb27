"""The GPU backend: planes -> linear picture -> placed in the camera's view -> b -> drive -> 8 bit (thesis 5.2).

Every texture and program is made when the room or the medium is opened; a frame allocates nothing.
"""

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from player.colour import decoding_of
from player.content import SceneCuts
from player.gl.passes import Owner, Pass, Uniform, float_texture, picture_texture, plane_texture, table_texture
from player.gl.refinement import Refiner
from player.gl.row_map_pass import FarPass, FarTextures, MapTextures, RowMapPass
from player.gl.starts import DirectStart, GreyStart, MapStart, PreviousStart, Start
from player.maps import RefinementMaps
from player.refinement import Certificate
from player.renderer import Room, check_radiance_size, place, shown_shape
from player.response import Response, transfer_table
from player.video import Frame, PixelFormat

LAYOUTS = {"yuv": "LAYOUT_YUV", "rgb": "LAYOUT_RGB", "radiance": "LAYOUT_RADIANCE"}


class GlRenderer:
    """Renderer in OpenGL 3.3; see player.renderer.Renderer. The caller owns the context."""

    def __init__(self, context: moderngl.Context, room: Room) -> None:
        self._context, self._room = context, room
        self._owner, self._medium = Owner(), Owner()
        try:
            self._build()
        except BaseException:
            self._owner.release()
            raise

    def _build(self) -> None:
        context, room, own = self._context, self._room, self._owner.own
        maps, calibration = room.maps, room.calibration
        camera, projector = calibration.camera.shape, calibration.projector.shape
        self._ambient = own(picture_texture(context, calibration.ambient))
        self._black = own(float_texture(context, projector, np.zeros((*projector, 4), np.float32)))
        self._desired = own(Pass(context, "desired.frag", float_texture(context, camera)))
        self._plain = own(Pass(context, "desired.frag", float_texture(context, projector), {"CLAMP": None}))
        self._correction = own(MapTextures(context, maps.correction))
        self._correct = own(RowMapPass(context, self._correction, "CLAMP"))
        self._undo = None
        if maps.undo is not None:
            self._undo = own(FarPass(context, own(FarTextures(context, maps.undo)), "SUBTRACT_FROM_BASE"))
        transport = own(MapTextures(context, maps.transport))
        far = None if maps.far is None else own(FarTextures(context, maps.far))
        self._refiner = None
        if maps.refinement is not None:
            self._refiner = own(Refiner(context, transport, far, maps.refinement, calibration.mask))
            self._start = own(self._make_start(maps.refinement))
        self._observers = [own(_Observer(context, transport, far, self._ambient)) for _ in range(2)]
        self._split = own(Pass(context, "split.frag", float_texture(context, camera), line=room.white))
        self._projector_view = own(_Encoder(context, projector, calibration.projector.response, 1.0, room.dither))
        self._camera_view = own(_Encoder(context, camera, Response("srgb"), room.white, "none"))

    def _make_start(self, maps: RefinementMaps) -> Start:
        context, projector = self._context, self._room.calibration.projector.shape
        if self._room.start == "direct":
            return DirectStart(context, maps)
        if self._room.start == "grey":
            return GreyStart(context, projector)
        if self._room.start == "map":
            return MapStart(lambda b: self._correct.run(self._near_light(b)))
        product = self._owner.own(RowMapPass(context, self._correction))
        return PreviousStart(context, projector, lambda b: product.run(self._near_light(b)))

    def open(self, pixels: PixelFormat) -> None:
        check_radiance_size(pixels, self._room.calibration)
        self._medium.release()
        context, own, radiance = self._context, self._medium.own, pixels.layout == "radiance"
        self._pixels, self._cuts = pixels, SceneCuts()
        dtype = np.dtype({8: np.uint8, 32: np.float32}.get(pixels.depth, np.uint16))
        self._planes = [
            own(plane_texture(context, (plane.height, plane.stride_samples), dtype)) for plane in pixels.planes
        ]
        self._decode_inputs = {f"plane_{i}": texture for i, texture in enumerate(self._planes)}
        if not radiance:
            table = table_texture(context, transfer_table(pixels.transfer))
            self._decode_inputs["transfer"] = own(table)
        self._decode = own(_decode_pass(context, pixels))
        calibration = self._room.calibration
        self._placed = own(_Placer(context, pixels, calibration.camera.shape))
        self._placed_plainly = own(_Placer(context, pixels, calibration.projector.shape))
        self._desired.set(white=1.0 if radiance else self._room.white)
        self._plain.set(white=1 / self._room.white if radiance else 1.0)

    def upload(self, frame: Frame) -> None:
        for texture, plane in zip(self._planes, frame.planes, strict=True):
            texture.write(plane)
        if self._refiner is not None:
            self._start.advance(cut=self._cuts.starts_with(frame))

    def render(self, view: str, *, compensate: bool, frame: int = 0, steps: int = 0) -> None:
        self._picture = self._decoded()
        self._compensated: tuple[moderngl.Texture, moderngl.Texture] | None = None
        if view == "split":
            drives = self._plain_drive(), self._drive(steps)
            plain, corrected = (observe.run(drive) for observe, drive in zip(self._observers, drives, strict=True))
            self._linear = self._split.run(left=plain, right=corrected)
        else:
            drive = self._drive(steps) if compensate else self._plain_drive()
            self._linear = drive if view == "projector" else self._observers[0].run(drive)
        encoder = self._projector_view if view == "projector" else self._camera_view
        self._encoded = encoder.run(self._linear, frame)

    @property
    def encoded_texture(self) -> moderngl.Texture:
        """The rendered view, RGBA8, row 0 at the top."""
        return self._encoded

    def encoded(self) -> NDArray[np.uint8]:
        return _read(self._encoded, np.uint8)

    def linear(self) -> NDArray[np.float32]:
        return _read(self._linear, np.float32)

    def desired(self) -> NDArray[np.float32]:
        white = 1.0 if self._pixels.layout == "radiance" else self._room.white
        return np.float32(white) * _read(self._placed.run(self._decoded()), np.float32)

    def finish(self) -> None:
        self._context.finish()

    def certificate(self) -> Certificate | None:
        if self._refiner is None or self._compensated is None:
            return None
        return self._refiner.certify(*self._compensated)

    def release(self) -> None:
        self._medium.release()
        self._owner.release()

    def _decoded(self) -> moderngl.Texture:
        return self._decode.run(**self._decode_inputs)

    def _plain_drive(self) -> moderngl.Texture:
        return self._plain.run(picture=self._placed_plainly.run(self._picture), ambient=self._black)

    def _drive(self, steps: int) -> moderngl.Texture:
        b = self._desired.run(picture=self._placed.run(self._picture), ambient=self._ambient)
        if self._refiner is None or not steps:
            drive = self._correct.run(self._near_light(b))
        else:
            drive = self._refiner.run(self._start.run(b), b, steps)
            self._start.keep(drive)
        self._compensated = drive, b
        return drive

    def _near_light(self, b: moderngl.Texture) -> moderngl.Texture:
        """b without the far light of the compensated picture."""
        return b if self._undo is None else self._undo.run(b, b)


class _Placer:
    """Two resampling passes: along x, then along y."""

    def __init__(self, context: moderngl.Context, pixels: PixelFormat, target: tuple[int, int]) -> None:
        spot = place(pixels, target)
        between = float_texture(context, (shown_shape(pixels)[0], target[1]))
        self._across = Pass(context, "resample.frag", between, axis=0, origin=spot.left, extent=spot.width)
        self._down = Pass(
            context, "resample.frag", float_texture(context, target), axis=1, origin=spot.top, extent=spot.height
        )

    def run(self, picture: moderngl.Texture) -> moderngl.Texture:
        return self._down.run(source=self._across.run(source=picture))

    def release(self) -> None:
        self._across.release()
        self._down.release()


class _Observer:
    """What the camera sees of a drive: e + S p + U M D p."""

    def __init__(
        self,
        context: moderngl.Context,
        transport: MapTextures,
        far: FarTextures | None,
        ambient: moderngl.Texture,
    ) -> None:
        self._near = RowMapPass(context, transport, "ADD_TO_BASE")
        self._far = None if far is None else FarPass(context, far, "ADD_TO_BASE")
        self._ambient = ambient

    def run(self, drive: moderngl.Texture) -> moderngl.Texture:
        near = self._near.run(drive, self._ambient)
        return near if self._far is None else self._far.run(drive, near)

    def release(self) -> None:
        self._near.release()
        if self._far is not None:
            self._far.release()


class _Encoder:
    """Linear light to 8 bit through an inverse response."""

    def __init__(
        self, context: moderngl.Context, shape: tuple[int, int], response: Response, scale: float, dither: str
    ) -> None:
        defines: dict[str, int | None] = {} if dither == "none" else {f"DITHER_{dither.upper()}": None}
        target = context.texture((shape[1], shape[0]), 4, dtype="f1")
        self._table = table_texture(context, response.inverse_table())
        self._pass = Pass(context, "encode.frag", target, defines, scale=scale)
        self._noisy = dither == "noise"

    def run(self, light: moderngl.Texture, frame: int) -> moderngl.Texture:
        if self._noisy:
            self._pass.set(frame=frame & 0xFFFFFFFF)
        return self._pass.run(picture=light, inverse_response=self._table)

    def release(self) -> None:
        self._pass.release()
        self._table.release()


def _decode_pass(context: moderngl.Context, pixels: PixelFormat) -> Pass:
    luma, chroma = pixels.planes[:2]
    uniforms: dict[str, Uniform] = {"stored_size": (luma.width, luma.height), "quarter_turns": pixels.rotation // 90}
    if pixels.layout != "radiance":
        decoding = decoding_of(pixels)
        uniforms |= {
            "black": tuple(decoding.black),
            "span": tuple(decoding.span),
            "to_rgb": tuple(decoding.to_rgb.T.ravel()),  # column by column, as OpenGL wants it
        }
        if pixels.layout == "yuv":
            uniforms |= {
                "chroma_size": (chroma.width, chroma.height),
                "subsampling": decoding.subsampling,
                "chroma_offset": decoding.chroma_offset,
            }
    target = float_texture(context, shown_shape(pixels))
    return Pass(context, "planes_to_linear.frag", target, {LAYOUTS[pixels.layout]: None}, **uniforms)


def _read(texture: moderngl.Texture, dtype: type) -> NDArray[Any]:
    width, height = texture.size
    return np.frombuffer(texture.read(), dtype).reshape(height, width, 4)[..., :3]
