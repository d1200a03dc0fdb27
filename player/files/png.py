"""Encodes PNG files in memory, because cv2.imwrite ignores errors of the system when it closes a file."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def encode_png(picture: NDArray[Any]) -> bytes:
    """Encode a picture (rows, columns) or (rows, columns, 3) RGB; uint8 or uint16."""
    done, content = cv2.imencode(".png", picture if picture.ndim == 2 else np.ascontiguousarray(picture[..., ::-1]))
    assert done
    return content.tobytes()


def write_png(path: Path, picture: NDArray[Any]) -> None:
    """Encode a picture as `encode_png` does, and write it. Raises OSError if the system refuses."""
    path.write_bytes(encode_png(picture))
