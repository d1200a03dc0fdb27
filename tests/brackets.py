"""Synthetic exposure brackets with known light and a known camera."""

from pathlib import Path

import cv2
import numpy as np

from counterlight.response import Response

CURVES = {
    "linear": Response("linear"),
    "srgb": Response("srgb"),
    "film": Response(  # steep near black, flat near white
        "table",
        table=tuple((float(v),) for v in np.linspace(0, 1, 256) * np.expm1(3 * np.linspace(0, 1, 256)) / np.expm1(3)),
    ),
}


def codes_of(light: np.ndarray, exposure_s: float, response: Response, top: int = 255) -> np.ndarray:
    """Codes that a camera stores for light (height, width, channels): rounded to the nearest code and clipped."""
    grid = np.linspace(0, 1, 4096)
    curve = response.to_linear(grid[:, None].repeat(3, axis=1))[:, 0]
    values = np.interp(light * exposure_s, curve, grid)
    return np.rint(values * top).astype(np.uint8 if top == 255 else np.uint16)


def random_scene(rng: np.random.Generator, shape: tuple[int, int, int], decades: float = 3.0) -> np.ndarray:
    """Random light spread evenly over `decades` below 1, smooth within blocks of 8x8 pixels."""
    coarse = rng.uniform(-decades, 0, (-(-shape[0] // 8), -(-shape[1] // 8), shape[2]))
    blocks = coarse.repeat(8, axis=0).repeat(8, axis=1)[: shape[0], : shape[1]]
    return np.asarray(10.0 ** (blocks + rng.uniform(-0.02, 0.02, shape)))


def write_picture(path: Path, codes: np.ndarray) -> Path:
    cv2.imwrite(str(path), codes[..., ::-1] if codes.shape[2] == 3 else codes)
    return path


def write_bracket(folder: Path, light: np.ndarray, times: list[float], response: Response, top: int = 255) -> list[str]:
    """Write PNG files in the order of `times` and return their names."""
    folder.mkdir(parents=True, exist_ok=True)
    return [
        str(write_picture(folder / f"shot{i:02}.png", codes_of(light, t, response, top))) for i, t in enumerate(times)
    ]
