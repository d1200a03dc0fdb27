"""PNG files, encoded in memory: cv2.imwrite does not notice what the system refuses when a file is closed."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def encode_png(picture: NDArray[Any]) -> bytes:
    """A picture (rows, columns) or (rows, columns, 3) of R, G and B; uint8 or uint16."""
    done, content = cv2.imencode(".png", picture if picture.ndim == 2 else np.ascontiguousarray(picture[..., ::-1]))
    assert done
    return content.tobytes()


def write_png(path: Path, picture: NDArray[Any]) -> None:
    """Write what `encode_png` makes of a picture; OSError where the system refuses."""
    path.write_bytes(encode_png(picture))
