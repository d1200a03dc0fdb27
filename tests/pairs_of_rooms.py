"""Pairs of a known room: a projector that lights a patterned, slightly curved wall, and a camera that sees it."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Pictures = NDArray[np.float64]
PROJECTOR, CAMERA = (72, 96), (96, 128)  # (height, width)
GAMMA = 2.2
AMBIENT = 0.02


def natural_pictures(rng: np.random.Generator, count: int) -> NDArray[np.uint8]:
    """Return pictures with detail of every size, (count, height, width, 3)."""
    height, width = PROJECTOR
    result = []
    for _ in range(count):
        picture = rng.uniform(0.1, 0.9, 3) * np.ones((height, width, 3))
        for cells in (3, 6, 12, 24, 48):
            grid = rng.normal(0, 0.16, (cells, cells, 3)) + rng.normal(0, 0.2, (cells, cells, 1))
            picture += cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
        result.append(np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8))
    return np.stack(result)


@dataclass(frozen=True)
class Wall:
    """A wall.

    seed : seed of its texture.
    shift : (x, y) in camera pixels that everything is shifted by.
    halo : share of a wide blur.
    """

    seed: int = 1
    shift: tuple[float, float] = (0.0, 0.0)
    halo: float = 0.0

    @property
    def places(self) -> NDArray[np.float32]:
        """The projector pixel that each camera pixel sees, (height, width, 2)."""
        y, x = np.mgrid[: CAMERA[0], : CAMERA[1]].astype(np.float64)
        x, y = x - self.shift[0], y - self.shift[1]
        at_x = 0.93 * x - 0.04 * y - 10 + 1.2 * np.sin(y / 23)
        at_y = 0.03 * x + 0.95 * y - 10 + 0.9 * np.sin(x / 31)
        return np.stack([at_x, at_y], axis=-1).astype(np.float32)

    @property
    def albedo(self) -> Pictures:
        rng = np.random.default_rng(self.seed)
        grid = rng.uniform(0.35, 0.9, (9, 12, 3))
        return np.asarray(cv2.resize(grid, CAMERA[::-1], interpolation=cv2.INTER_NEAREST))

    def light(self, codes: NDArray[np.uint8]) -> Pictures:
        """Return the radiance of a picture without noise, (height, width, 3)."""
        places = self.places
        drive = cv2.GaussianBlur((codes / 255.0) ** GAMMA, (0, 0), 0.7)
        direct = cv2.remap(drive, places[..., 0], places[..., 1], cv2.INTER_LINEAR) * self.albedo * 0.9
        return np.asarray(direct + self.halo * cv2.GaussianBlur(direct, (0, 0), 12.0) + AMBIENT)

    def capture(self, codes: NDArray[np.uint8], rng: np.random.Generator, noise: float = 0.002) -> NDArray[np.uint16]:
        light = self.light(codes) + rng.normal(0, noise, (*CAMERA, 3))
        return np.rint(np.clip(light, 0, 1) * 65535).astype(np.uint16)


def write_pairs(folder: Path, wall: Wall, rng: np.random.Generator, count: int = 16) -> tuple[Path, Path]:
    """Write folders of pictures and photographs with the same numbers."""
    pictures, photographs = folder / "pictures", folder / "photographs"
    for each in (pictures, photographs):
        each.mkdir(parents=True)
    for number, codes in enumerate(natural_pictures(rng, count)):
        write(pictures / f"frame{number:03}.png", codes)
        write(photographs / f"IMG_{number:03}.png", wall.capture(codes, rng))
    return pictures, photographs


def write(path: Path, picture: NDArray[np.generic]) -> None:
    assert cv2.imwrite(str(path), np.ascontiguousarray(picture[..., ::-1]))
