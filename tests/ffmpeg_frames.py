"""FFmpeg frames with known code values."""

from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

Planes = tuple[NDArray[Any], ...]


def ffmpeg_frame(planes: Planes, pixel_format: str) -> av.VideoFrame:
    """FFmpeg frame of the given planes, each (rows, columns) in the format's own order."""
    frame = av.VideoFrame(planes[0].shape[1], planes[0].shape[0], pixel_format)
    for plane, values in zip(frame.planes, planes, strict=True):
        rows = np.zeros((plane.height, plane.line_size), np.uint8)
        stored = np.ascontiguousarray(values).view(np.uint8).reshape(plane.height, -1)
        rows[:, : stored.shape[1]] = stored
        plane.update(rows.tobytes())
    return frame
