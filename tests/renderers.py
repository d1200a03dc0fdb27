"""A room's renderers on the GPU and in numpy, and the content of textures."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import Any

import moderngl
import numpy as np

from counterlight.gl.device import GlDevice
from counterlight.gl.passes import integer_texture, picture_texture
from counterlight.gl.renderer import GlRenderer
from counterlight.media.frames import radiance_frame
from counterlight.media.video import Frame
from counterlight.passes.drawing import Pass
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.device import EVERYWHERE, GpuPath, Owner, StoredMap
from counterlight.pipeline.room import Room
from counterlight.pipeline.shortfall import Snapshot
from tests.oracles.renderer import ReferenceRenderer


@contextmanager
def both(
    context: moderngl.Context, room: Room, frame: Frame, path: GpuPath = EVERYWHERE
) -> Iterator[tuple[GlRenderer, ReferenceRenderer]]:
    """Yield both renderers with `frame` uploaded; release them at the end."""
    renderers = GlRenderer(context, room, path), ReferenceRenderer(room)
    try:
        for renderer in renderers:
            renderer.open(frame.format)
            renderer.upload(frame)
        yield renderers
    finally:
        renderers[0].release()


def on_gpu(context: moderngl.Context, made: Pass[Any], shape: tuple[int, int]) -> np.ndarray:
    """Draw a pass over arrays on the GPU: (*shape, 3). Arrays of one dimension are uniforms."""
    device, textures = GlDevice(context), []

    def uploaded(group: Any) -> Any:
        values = {field.name: getattr(group, field.name) for field in fields(group)}
        for name, value in values.items():
            if is_dataclass(value):
                values[name] = uploaded(value)
            elif isinstance(value, np.ndarray) and value.ndim > 1:
                whole = value.dtype == np.uint32
                values[name] = integer_texture(context, value) if whole else device.picture(value)
                textures.append(values[name])
        return replace(group, **values)

    canvas = device.canvas(shape)
    result = read(canvas.draw(uploaded(made)))
    for resource in (canvas, device, *textures):
        resource.release()
    return result


def read(texture: moderngl.Texture, dtype: type = np.float32) -> np.ndarray:
    """Colours (height, width, 3) of a texture with four channels."""
    return np.frombuffer(texture.read(), dtype).reshape(texture.height, texture.width, 4)[..., :3]


def drawn(room: Room, picture: np.ndarray, start: str, steps: int) -> tuple[Snapshot, np.ndarray]:
    """Snapshot of a radiance picture after `steps` steps, and b, (camera pixels, 3)."""
    renderer, frame = CpuRenderer(replace(room, start=start)), radiance_frame(picture)
    renderer.open(frame.format)
    renderer.upload(frame)
    renderer.render("projector", compensate=True, steps=steps)
    found = renderer.snapshot()
    assert found is not None
    return found, (renderer.desired() - room.ambient).reshape(-1, 3).astype(float)


def multiply(
    context: moderngl.Context, stored: StoredMap, picture: np.ndarray, base: np.ndarray | None = None, combine: str = ""
) -> np.ndarray:
    """Compute one product, and release its memory and the memory of `stored`."""
    owner = Owner()
    product = owner.own(stored.product(combine))
    inputs = [owner.own(picture_texture(context, each)) for each in (picture, base) if each is not None]
    result = read(product.run(*inputs)).copy()
    owner.release()
    stored.release()
    return result
