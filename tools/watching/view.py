"""A calibrated room at the resolution of the watcher: blocks of the camera picture, reduced projector pictures.

The model is c = T W(θ) p + e. B takes means over blocks of the camera picture, and R repeats the pixels of a reduced
projector picture, so that B T R is small. Light is in screen primaries (counterlight.maps.mixing).
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.maps.chain import Chain
from counterlight.maps.mixing import mixed
from counterlight.maps.row_map import SparseRows
from counterlight.pipeline.correction import block_side
from counterlight.pipeline.shown_copies import reduced_boxes, reduced_shape
from counterlight.tools.acquisition.camera_shift import mean_around
from counterlight.tools.acquisition.cameras.camera import Shot
from counterlight.tools.acquisition.registration import lit
from counterlight.tools.colour.tiers import Tier
from counterlight.tools.transport.transport import Csr, Transport, channels, luminance, stacked
from counterlight.unattended.watch_link import GRID

REGIONS = 6, 8  # rows and columns of the regions of the camera picture in the search for the latency
FEWEST_BLOCKS = 50
WHOLE = 0.99  # share of a block's light that must come from inside the rasters
MASKED = 255  # value of OpenCV's masks
SURROUNDINGS = 0.05  # σ of the surroundings of a paint's texture, share of the camera's longer side
TEXTURE = 0.02, 4.0  # limits of the paint's texture


@dataclass(frozen=True)
class Blocks:
    """A grid of square blocks over the camera picture; pixels at the right and lower edge may belong to no block.

    side : camera pixels.
    rows, columns : number of blocks.
    """

    side: int
    rows: int
    columns: int

    @classmethod
    def over(cls, shape: tuple[int, int]) -> "Blocks":
        side = block_side(shape)
        return cls(side, shape[0] // side, shape[1] // side)

    @property
    def count(self) -> int:
        return self.rows * self.columns

    def means(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the mean of each block: (height, width, channels) or (height, width) -> (blocks, channels)."""
        inside = np.ascontiguousarray(picture[: self.rows * self.side, : self.columns * self.side])
        size = self.columns, self.rows
        return np.asarray(cv2.resize(inside, size, interpolation=cv2.INTER_AREA), np.float32).reshape(self.count, -1)

    def unclipped(self, shot: Shot) -> BoolArray:
        """Return the blocks without a pixel at the top of the camera's range, (blocks,) bool."""
        below = int(np.iinfo(shot.dtype).max) - 1
        fits = cv2.inRange(shot, (0,) * 3, (below,) * 3) if shot.ndim == 3 else cv2.inRange(shot, 0, below)
        return np.asarray(self.means(fits.astype(np.float32))[:, 0] == MASKED)

    def averaging(self, shape: tuple[int, int]) -> Csr:
        """Return B, (blocks, camera pixels)."""
        y, x = (axis.ravel() for axis in np.mgrid[: self.rows * self.side, : self.columns * self.side])
        block, pixel = (y // self.side) * self.columns + x // self.side, y * shape[1] + x
        share = np.full(len(block), self.side**-2.0, np.float32)
        return Csr(sparse.coo_array((share, (block, pixel)), shape=(self.count, shape[0] * shape[1])))


class RoomView:
    """The room as the watcher sees it.

    blocks : the grid; `counted` are the blocks that the estimate uses, (blocks,) bool.
    transport : B T R, (blocks, reduced pixels).
    ambient, flood, white : B e (blocks, 3), B T 1 (blocks, 3), and the radiance of white.
    paint : (camera height, camera width, 3) float16. Texture that the light of the room takes on.
    slopes : (blocks, 3) each. Gradient of the floodlit room, right and down, per camera pixel.
    boxes : region of each projector in the reduced picture.

    Raises InputError if too few blocks see the projectors.
    """

    def __init__(self, tier: Tier, factor: int) -> None:
        room = tier.calibration
        self.room, self.factor, self.white = room, factor, tier.white
        self._mixing = tier.mixing
        self.blocks = Blocks.over(room.camera.shape)
        self.boxes = reduced_boxes(room.regions, factor)
        self.raster = reduced_shape(self.boxes)
        B, R = self.blocks.averaging(room.camera.shape), repeating(room, factor)
        self.transport = _reduced(tier.transport, B, R)
        self.ambient = self.blocks.means(tier.ambient).astype(np.float64)
        flood = tier.transport.composition().reshape(*room.camera.shape, 3)
        self._mixed = None
        if tier.mixing.pixel is not None:
            B_pixel = tier.mixing.pixel.reshape(*room.camera.shape, 9)
            self._mixed = np.concatenate(
                [self.blocks.means(np.ascontiguousarray(B_pixel[..., i : i + 3])) for i in (0, 3, 6)], axis=1
            ).reshape(-1, 3, 3)
        self.flood = self.seen(np.ones((*self.raster, 3)))
        floodlit = np.asarray(tier.mixing.seen(flood) + tier.ambient)
        self.paint = _paint(floodlit, room)
        down, right = np.gradient(floodlit, axis=(0, 1))
        self.slopes = [self.blocks.means(each.astype(np.float32)).astype(np.float64) for each in (right, down)]
        self.texture = self.blocks.means(self.paint.astype(np.float32)).astype(np.float64)
        self.counted = self._counted(room)
        if self.counted.sum() < FEWEST_BLOCKS:
            raise InputError(
                f"the projectors are seen by {self.counted.sum()} blocks of the camera picture, expected "
                f"{FEWEST_BLOCKS} or more: acquire the room with a camera that sees more of the picture"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the blocks."""
        return self.blocks.rows, self.blocks.columns

    @property
    def camera_px(self) -> float:
        """Camera pixels per projector pixel: the least of all devices, if each camera sees all of a picture."""
        seen = min(
            np.count_nonzero(self.room.mask & self.room.pixels_of(number)) for number in range(len(self.cameras))
        )
        return float(np.sqrt(seen / max(region.width * region.height for region in self.room.regions)))

    def seen(self, landed: FloatArray) -> FloatArray:
        """Return the blocks' light above ambient under a reduced picture (height, width, 3): (blocks, 3)."""
        light = self.transport.apply(landed.reshape(-1, 3))
        return light if self._mixed is None else np.asarray(mixed(self._mixed, light))

    def near(self, columns: FloatArray, channel: int) -> FloatArray:
        """Return the near light of one channel for several pictures: (reduced pixels, n) -> (blocks, n)."""
        return np.asarray(self._near[channel] @ columns)

    def measured(self, radiance: NDArray[np.float32]) -> FloatArray:
        """Return the blocks of a capture (camera height, camera width, 3): (blocks, 3), in screen primaries."""
        means = self.blocks.means(radiance).astype(np.float64)
        for own, gain in zip(self.cameras, self.room.gains, strict=True):
            means[own] *= gain
        return np.asarray(self._mixing.on_screen(means))

    @cached_property
    def coarse(self) -> tuple[FloatArray, NDArray[np.int64]]:
        """B T of a grid of GRID cells, (3, regions, cells), and the region of every block, -1 if it is not counted.

        Regions are a grid of REGIONS over the camera picture. The matrix predicts their mean light from `Light.grid`.
        """
        y, x = np.divmod(np.arange(self.blocks.count), self.blocks.columns)
        region = (y * REGIONS[0] // self.blocks.rows) * REGIONS[1] + x * REGIONS[1] // self.blocks.columns
        region = np.where(self.counted, region, -1)
        down, right = (_cells(size, cells) for size, cells in zip(self.raster, GRID, strict=True))
        cell = (down[:, None] * GRID[1] + right).ravel()
        mixing = np.eye(3) if self._mixed is None else self._mixed
        found = np.zeros((3, REGIONS[0] * REGIONS[1], GRID[0] * GRID[1]))
        for number in np.unique(region[self.counted]):
            share = (region == number) / np.count_nonzero(region == number)
            for channel in range(3):
                back = self.transport.apply_transpose(share[:, None] * mixing[..., channel, :])
                found[channel, number] = np.bincount(cell, back.sum(axis=1), found.shape[2])
        return found, region

    def changes(self, camera: int, light: NDArray[np.float32]) -> float:
        """Return how much a change of light on GRID changes what a camera sees: RMS, share of the floodlit room."""
        coarse, region = self.coarse
        seen = np.unique(region[self.cameras[camera] & self.counted])
        change = np.einsum("krc,ck->rk", coarse[:, seen], light.reshape(-1, 3))
        return rms(change) / rms(coarse[:, seen].sum(axis=2))

    @cached_property
    def _near(self) -> tuple[Csr, ...]:
        near = channels(self.transport.near)
        if self.transport.blurred is None:
            return near
        B, P = (channels(part) for part in (self.transport.blurred.scatter, self.transport.blurred.gather))
        return tuple(Csr(S + b @ p) for S, b, p in zip(near, B, P, strict=True))

    @cached_property
    def cameras(self) -> list[BoolArray]:
        """The blocks of each camera, (blocks,) bool. Blocks at a seam belong to none, because slopes cross it."""
        found = []
        for number in range(len(self.room.views)):
            own = self.blocks.means(self.room.pixels_of(number).astype(np.float32))[:, 0] > WHOLE
            inner = ndimage.binary_erosion(own.reshape(self.shape), border_value=1)
            found.append(np.asarray(inner.ravel()))
        return found

    def _counted(self, room: Calibration) -> BoolArray:
        """Return the blocks inside the mask that are lit from inside the rasters, away from their borders."""
        mask = self.blocks.means(room.mask.astype(np.float32))[:, 0]
        inner = np.zeros((*self.raster, 3))
        for box in self.boxes:
            edge = max(2, round(0.03 * max(box.width, box.height)))
            inner[box.top + edge : box.top + box.height - edge, box.left + edge : box.left + box.width - edge] = 1
        near = luminance(np.stack([m @ np.ones(m.shape[1]) for m in self._near], axis=1))
        inside = luminance(np.stack([m @ inner.reshape(-1, 3)[:, 0] for m in self._near], axis=1))
        seen = np.any(self.cameras, axis=0)
        return np.asarray(seen & (mask > WHOLE) & lit(luminance(self.flood)) & (inside > WHOLE * near))


def _cells(size: int, cells: int) -> NDArray[np.int64]:
    """Return the cell of each of `size` pixels, as `Means` divides them, (size,)."""
    return np.searchsorted(np.arange(cells + 1) * size // cells, np.arange(size), side="right") - 1


def regional(values: FloatArray, region: NDArray[np.int64]) -> FloatArray:
    """Return the mean of blocks (blocks,) per region, (regions,); 0 for a region without blocks."""
    counted, size = region >= 0, REGIONS[0] * REGIONS[1]
    sums = np.bincount(region[counted], values[counted], size)
    counts = np.bincount(region[counted], minlength=size)
    return np.asarray(sums / np.maximum(counts, 1))


def rms(values: NDArray[np.floating]) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def repeating(room: Calibration, factor: int) -> Csr:
    """Return R, (projector pixels, reduced pixels), which repeats every reduced pixel."""
    boxes, number = reduced_boxes(room.regions, factor), np.full(room.projector.shape, -1, np.int64)
    height, columns = reduced_shape(boxes)
    for box, region in zip(boxes, room.regions, strict=True):
        y, x = np.arange(region.height) // factor + box.top, np.arange(region.width) // factor + box.left
        number[region.part] = y[:, None] * columns + x
    pixel = np.flatnonzero(number.ravel() >= 0)
    entries = np.ones(len(pixel), np.float32), (pixel, number.ravel()[pixel])
    return Csr(sparse.coo_array(entries, shape=(number.size, height * columns)))


def _reduced(transport: Transport, B: Csr, R: Csr) -> Transport:
    """Return B T R."""

    def rows(part: SparseRows, left: Csr | None, right: Csr | None) -> SparseRows:
        found = []
        for matrix in channels(part):
            matrix = matrix if left is None else left @ matrix
            found.append(Csr(matrix if right is None else matrix @ right))
        return stacked(found)

    far = transport.far and Chain(
        rows(transport.far.gather, None, R), transport.far.mix, rows(transport.far.scatter, B, None)
    )
    blurred = transport.blurred and Chain(
        rows(transport.blurred.gather, None, R), None, rows(transport.blurred.scatter, B, None)
    )
    return Transport(rows(transport.near, B, R), far, blurred=blurred)


def _paint(floodlit: FloatArray, room: Calibration) -> NDArray[np.float16]:
    """Return the texture of the floodlit room relative to its surroundings, which the light of the room takes on."""
    sigma = SURROUNDINGS * max(room.camera.shape)
    found = np.ones(floodlit.shape)
    for view in room.views:
        for i in range(3):
            light = floodlit[view][..., i]
            clear = light > 0.05 * np.percentile(light, 90)
            around = mean_around(light, clear, sigma)
            found[view][..., i] = np.where(clear, np.clip(light / np.maximum(around, 1e-12), *TEXTURE), 1)
    return found.astype(np.float16)
