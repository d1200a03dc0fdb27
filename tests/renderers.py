"""A room's renderers side by side, on the GPU and its twin in numpy, and what their shaders leave in a texture."""

from collections.abc import Iterator
from contextlib import contextmanager

import moderngl
import numpy as np

from counterlight.gl.renderer import GlRenderer
from counterlight.media.video import Frame
from counterlight.pipeline.reference_renderer import ReferenceRenderer
from counterlight.pipeline.room import Room


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
