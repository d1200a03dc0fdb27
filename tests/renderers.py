"""A room's renderers side by side, on the GPU and its twin in numpy, and what their shaders leave in a texture."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import moderngl
import numpy as np

from counterlight.gl.renderer import GlRenderer
from counterlight.media.frames import radiance_frame
from counterlight.media.video import Frame
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.reference_renderer import ReferenceRenderer
from counterlight.pipeline.room import Room
from counterlight.pipeline.shortfall import Snapshot


@contextmanager
def both(
    context: moderngl.Context, room: Room, frame: Frame, path: str = "fragment"
) -> Iterator[tuple[GlRenderer, ReferenceRenderer]]:
    """Both with `frame` uploaded; released at the end."""
    renderers = GlRenderer(context, room, path), ReferenceRenderer(room)
    try:
        for renderer in renderers:
            renderer.open(frame.format)
            renderer.upload(frame)
        yield renderers
    finally:
        renderers[0].release()


def read(texture: moderngl.Texture, dtype: type = np.float32) -> np.ndarray:
    """Colours (height, width, 3) of a texture of four channels."""
    return np.frombuffer(texture.read(), dtype).reshape(texture.height, texture.width, 4)[..., :3]


def drawn(room: Room, picture: np.ndarray, start: str, steps: int) -> tuple[Snapshot, np.ndarray]:
    """What is read back of a picture of radiance after so many steps, and b, (camera pixels, 3)."""
    renderer, frame = CpuRenderer(replace(room, start=start)), radiance_frame(picture)
    renderer.open(frame.format)
    renderer.upload(frame)
    renderer.render("projector", compensate=True, steps=steps)
    found = renderer.snapshot()
    assert found is not None
    return found, (renderer.desired() - room.ambient).reshape(-1, 3).astype(float)
