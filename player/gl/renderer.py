"""The GPU backend: planes -> linear picture -> placed in the camera's view -> b -> drive -> 8 bit (thesis 5.2).

Every texture and program is made when the room or the medium is opened; a frame allocates nothing.
"""

from contextlib import ExitStack
from typing import Any, Protocol, TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from player.colour import decoding_of
from player.gl.passes import Pass, Uniform, float_texture, plane_texture, table_texture
from player.gl.row_map_pass import FarPass, FarTextures, MapTextures, RowMapPass
from player.renderer import Room, check_radiance_size, place, shown_shape
from player.response import Response, transfer_table
from player.video import Frame, PixelFormat

LAYOUTS = {"yuv": "LAYOUT_YUV", "rgb": "LAYOUT_RGB", "radiance": "LAYOUT_RADIANCE"}


class _Releasable(Protocol):
    def release(self) -> None: ...


R = TypeVar("R", bound=_Releasable)


class GlRenderer:
    """Renderer in OpenGL 3.3; see player.renderer.Renderer. The caller owns the context."""

    def __init__(self, context: moderngl.Context, room: Room) -> None:
        self._context, self._room = context, room
        self._owned, self._medium = ExitStack(), ExitStack()
        try:
            self._build()
        except BaseException:
            self._owned.close()
            raise

    def _build(self) -> None:
        context, room = self._context, self._room
        camera, projector = room.calibration.camera.shape, room.calibration.projector.shape
        self._ambient = self._own(float_texture(context, camera, _with_alpha(room.calibration.ambient)))
        self._black = self._own(float_texture(context, projector, np.zeros((*projector, 4), np.float32)))
        self._desired = self._own(Pass(context, "desired.frag", float_texture(context, camera)))
        self._plain = self._own(Pass(context, "desired.frag", float_texture(context, projector), {"CLAMP": None}))
        correction = self._own(MapTextures(context, room.maps.correction))
        self._correct = self._own(RowMapPass(context, correction, "CLAMP"))
        self._undo = None
        if room.maps.undo is not None:
            undo = self._own(FarTextures(context, room.maps.undo))
            self._undo = self._own(FarPass(context, undo, "SUBTRACT_FROM_BASE"))
        transport = self._own(MapTextures(context, room.maps.transport))
        far = None if room.maps.far is None else self._own(FarTextures(context, room.maps.far))
        self._observers = [self._own(_Observer(context, transport, far, self._ambient)) for _ in range(2)]
        self._split = self._own(Pass(context, "split.frag", float_texture(context, camera), line=room.white))
        self._projector_view = self._own(
            _Encoder(context, projector, room.calibration.projector.response, 1.0, room.dither)
        )
        self._camera_view = self._own(_Encoder(context, camera, Response("srgb"), room.white, "none"))

    def open(self, pixels: PixelFormat) -> None:
        check_radiance_size(pixels, self._room.calibration)
        self._medium.close()
        context, radiance = self._context, pixels.layout == "radiance"
        self._pixels = pixels
        dtype = np.dtype({8: np.uint8, 32: np.float32}.get(pixels.depth, np.uint16))
        self._planes = [
            self._own_medium(plane_texture(context, (plane.height, plane.stride_samples), dtype))
            for plane in pixels.planes
        ]
        self._decode_inputs = {f"plane_{i}": texture for i, texture in enumerate(self._planes)}
        if not radiance:
            table = table_texture(context, transfer_table(pixels.transfer))
            self._decode_inputs["transfer"] = self._own_medium(table)
        self._decode = self._own_medium(_decode_pass(context, pixels))
        calibration = self._room.calibration
        self._placed = self._own_medium(_Placer(context, pixels, calibration.camera.shape))
        self._placed_plainly = self._own_medium(_Placer(context, pixels, calibration.projector.shape))
        self._desired.set(white=1.0 if radiance else self._room.white)
        self._plain.set(white=1 / self._room.white if radiance else 1.0)

    def upload(self, frame: Frame) -> None:
        for texture, plane in zip(self._planes, frame.planes, strict=True):
            texture.write(plane)

    def render(self, view: str, *, compensate: bool, frame: int = 0) -> None:
        self._picture = self._decoded()
        if view == "split":
            drives = self._drive(compensate=False), self._drive(compensate=True)
            plain, corrected = (observe.run(drive) for observe, drive in zip(self._observers, drives, strict=True))
            self._linear = self._split.run(left=plain, right=corrected)
        else:
            drive = self._drive(compensate=compensate)
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

    def release(self) -> None:
        self._medium.close()
        self._owned.close()

    def _decoded(self) -> moderngl.Texture:
        return self._decode.run(**self._decode_inputs)

    def _drive(self, *, compensate: bool) -> moderngl.Texture:
        if not compensate:
            return self._plain.run(picture=self._placed_plainly.run(self._picture), ambient=self._black)
        b = self._desired.run(picture=self._placed.run(self._picture), ambient=self._ambient)
        if self._undo is not None:
            b = self._undo.run(b, b)
        return self._correct.run(b)

    def _own(self, resource: R) -> R:
        self._owned.callback(resource.release)
        return resource

    def _own_medium(self, resource: R) -> R:
        self._medium.callback(resource.release)
        return resource


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


def _with_alpha(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.concatenate([picture, np.ones((*picture.shape[:2], 1), np.float32)], axis=2)


def _read(texture: moderngl.Texture, dtype: type) -> NDArray[Any]:
    width, height = texture.size
    return np.frombuffer(texture.read(), dtype).reshape(height, width, 4)[..., :3]
