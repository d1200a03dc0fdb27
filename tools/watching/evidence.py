"""The evidence of one capture for changes of the room: a quadratic cost of θ around the present estimate.

θ holds, per projector, a homography in eight numbers and the light of each channel; a smooth field of ambient light;
and a movement of the wall's texture per camera, which tells a moved camera from a moved projector. The residual of a
block is r = (c − T W(θ) p − e(θ)) / σ. Its derivative by the homography is ∇(W p) · u, mapped by the near light of T.

Each camera of a capture also has its own delay, which changes from the top to the bottom because of rolling shutters.
Without it, a film that pans would seem to have moved. The delay is eliminated. Weights fall to zero for large residuals
(Geman and McClure 1987) and for connected regions of them: people, shadows, a hand.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray
from counterlight.passes.moved import moved
from counterlight.passes.resample import tents
from counterlight.raster import Region
from counterlight.tools.acquisition.plan import MAD_TO_SIGMA
from counterlight.tools.acquisition.registration import homography, normal_positions
from counterlight.tools.watching.timeline import Exposed
from counterlight.tools.watching.view import RoomView

GEOMETRY, CHANNELS, CAMERA = 8, 3, 3
FIELD = 3, 4  # rows and columns of the ambient field
MODEL, FLOOR = 0.02, 0.001  # errors of the model, shares of the predicted light and of white
MISPLACED = 0.1  # error of T, in projector pixels along the gradient of the picture
LEAST_SCALE = 0.1  # smallest scale of residuals, in σ
HUBER, ROUNDS = 1.5, 4  # robust deviations from which on a residual counts less; rounds of a weighted fit
SCALE = 3.0  # residuals, in robust deviations, at which a block has a quarter of its weight
OUTLIER = 4.0  # residual of a block that belongs to a foreign object
REGION = 6  # least blocks of a region that is rejected together with its surroundings
FLAT = 0.02  # share of the floodlight; the place of a picture with a smaller deviation cannot be estimated
DELAY = 2.0  # deviation of a capture's delay, in errors of the latency; frames also appear with jitter
FAR = 0.1  # share of white; larger residuals count as this residual in a search


@dataclass(frozen=True)
class Layout:
    """The places of the unknowns in θ.

    Units: displacements of the picture's corners in projector pixels; light in shares of the calibrated light;
    ambient light in shares of white; the movement of each camera in its pixels.
    """

    projectors: int
    cameras: int = 1

    @property
    def size(self) -> int:
        return (GEOMETRY + CHANNELS) * self.projectors + CHANNELS * self.field + CAMERA * self.cameras

    @property
    def field(self) -> int:
        return FIELD[0] * FIELD[1]

    def geometry(self, projector: int) -> NDArray[np.int64]:
        return np.arange(GEOMETRY) + GEOMETRY * projector

    def gain(self, projector: int) -> NDArray[np.int64]:
        return np.arange(CHANNELS) + GEOMETRY * self.projectors + CHANNELS * projector

    @property
    def all_gains(self) -> NDArray[np.int64]:
        return np.arange(CHANNELS * self.projectors) + GEOMETRY * self.projectors

    @property
    def ambient(self) -> NDArray[np.int64]:
        """Channel by channel, (3 · field,)."""
        return np.arange(CHANNELS * self.field) + (GEOMETRY + CHANNELS) * self.projectors

    @property
    def camera(self) -> NDArray[np.int64]:
        """Camera by camera, (cameras · 3,)."""
        return np.arange(self.size - CAMERA * self.cameras, self.size)

    @property
    def all_geometry(self) -> NDArray[np.int64]:
        return np.arange(GEOMETRY * self.projectors)


@dataclass(frozen=True)
class Evidence:
    """½ θᵀ H θ − bᵀ θ + c, with H (n, n) and b (n,), from one or more captures.

    weight : sum of the blocks' weights.
    """

    H: FloatArray
    b: FloatArray
    c: float
    weight: float

    def __add__(self, other: "Evidence") -> "Evidence":
        return Evidence(self.H + other.H, self.b + other.b, self.c + other.c, self.weight + other.weight)

    def scaled(self, factor: float) -> "Evidence":
        return Evidence(factor * self.H, factor * self.b, factor * self.c, factor * self.weight)

    def ahead(self, change: FloatArray) -> "Evidence":
        """Return the cost for a θ that has changed by `change` since: J(θ − change)."""
        moved = self.H @ change
        c = self.c + float(self.b @ change + 0.5 * change @ moved)
        return Evidence(self.H, self.b + moved, c, self.weight)

    @classmethod
    def none(cls, size: int) -> "Evidence":
        return cls(np.zeros((size, size)), np.zeros(size), 0.0, 0.0)

    def cost(self, theta: FloatArray) -> float:
        return float(0.5 * theta @ self.H @ theta - self.b @ theta + self.c)


@dataclass(frozen=True)
class Compared:
    """A capture compared with its prediction.

    scale : robust deviation of the residuals, in σ.
    outliers : share of the counted blocks that belong to foreign objects.
    gain : slope of measured over predicted light; NaN for a flat picture. Ambient light does not change it.
    brightness : mean of the predicted light, share of white.
    coarse : error by rounded code values, share of white.
    agreement : correlation of measured and predicted light relative to the floodlight; NaN for a flat picture.
    predicted, weights : (blocks, 3) each. Predicted light, and the inverse of its squared error, also of blocks that
        seem to belong to foreign objects; 0 for blocks that are not counted.
    """

    evidence: Evidence
    scale: float
    outliers: float
    gain: float
    brightness: float
    coarse: float
    agreement: float
    predicted: FloatArray
    weights: FloatArray


class Comparison:
    """Compares captures with their predictions.

    counted : the blocks in use.
    """

    def __init__(self, view: RoomView) -> None:
        self._view, self.layout = view, Layout(len(view.boxes), len(view.cameras))
        self._used = np.flatnonzero(view.counted)
        self._hats = _hats(view.shape, FIELD)
        self._lit = (view.texture * view.white)[:, None, :] * self._hats[:, :, None]  # (blocks, field, channels)
        self._rows = _rows(view)
        self._halves = [max(box.height, box.width) / 2 for box in view.boxes]
        self._places = [normal_positions((box.height, box.width)) for box in view.boxes]

    def landed(self, picture: FloatArray, theta: FloatArray) -> FloatArray:
        """Return W(θ) p, the light of a shown reduced picture at the calibrated places."""
        view, result = self._view, np.zeros(picture.shape, np.float32)
        drive = np.ascontiguousarray(picture, np.float32)
        for number, box in enumerate(view.boxes):
            M = self._homography(number, theta)
            moved(drive, M, np.ones(3), box.left, box.top, box.width, box.height, result)
            result[box.part] *= (1 + theta[self.layout.gain(number)]).astype(np.float32)
        return result.astype(np.float64)

    def ambient(self, theta: FloatArray) -> FloatArray:
        """Return e(θ), (blocks, 3)."""
        field = theta[self.layout.ambient].reshape(CHANNELS, self.layout.field)
        return self._view.ambient + self._view.texture * self._view.white * (self._hats @ field.T)

    def predicted(self, picture: FloatArray, theta: FloatArray) -> FloatArray:
        """Return the blocks' light under a shown picture, (blocks, 3)."""
        return self._view.seen(self.landed(picture, theta)) + self.ambient(theta)

    def compare(
        self, exposed: Exposed, measured: FloatArray, theta: FloatArray, unclipped: BoolArray, noise: FloatArray
    ) -> Compared:
        """Compare a capture with its prediction at θ.

        measured : (blocks, 3), in screen primaries.
        unclipped : (blocks,) bool. Blocks without saturated pixels.
        noise : (blocks, 3). Error of a block's mean, radiance.
        """
        view, used = self._view, self._used
        landed = self.landed(exposed.picture, theta)
        light, ambient = view.seen(landed), self.ambient(theta)
        predicted = light + ambient
        lights = [light] if len(view.boxes) == 1 else [view.seen(self._only(landed, box)) for box in view.boxes]
        late = view.seen(exposed.change) if exposed.change.any() else np.zeros_like(light)
        slopes = self._slopes(landed)
        moves = [self._derivatives(slopes, number) for number in range(len(view.boxes))]
        # (projectors, channels, blocks, 8)
        steep = sum(np.sqrt(np.sum(each[..., :2] ** 2, axis=-1)).T for each in moves)
        variance = (MODEL * predicted) ** 2 + (FLOOR * view.white) ** 2 + noise**2 + (MISPLACED * steep) ** 2
        sigma = np.sqrt(variance)[used]
        residual = (measured - predicted)[used] / sigma
        texture = self._texture(predicted)
        columns = [self._columns(channel, moves, lights, theta, texture, late) for channel in range(CHANNELS)]
        J = [each[used] / sigma[:, channel, None] for channel, (_, each) in enumerate(columns)]
        unexplained = self._unexplained(residual, J, [places for places, _ in columns], unclipped[used])
        scale, weights, outliers = self._weights(unexplained, unclipped[used])
        size = self.layout.size + self._rows.shape[1]
        H, b = np.zeros((size, size)), np.zeros(size)
        for channel, (places, _) in enumerate(columns):
            weighted = weights[:, None] * J[channel]
            H[np.ix_(places, places)] += weighted.T @ J[channel]
            b[places] += weighted.T @ residual[:, channel]
        c = 0.5 * float(np.sum(weights[:, None] * residual**2))
        H, b, c = _without_last(self._rows.shape[1], H, b, c, (scale / DELAY) ** 2)
        c += float(b @ theta + 0.5 * theta @ H @ theta)
        found = Evidence(H, b + H @ theta, c, float(weights.sum())).scaled(1 / scale**2)
        gain = _slope(light[used], (measured - ambient)[used], weights)
        shares = [np.mean(each[used] / (view.flood + view.ambient)[used], axis=1) for each in (measured, predicted)]
        agreement = float(np.corrcoef(*shares)[0, 1]) if shares[1].std() > FLAT else np.nan
        brightness, coarse = (float(each[used].mean() / view.white) for each in (light, noise))
        trust = np.zeros_like(predicted)
        trust[used] = unclipped[used, None] / (scale**2 * (sigma**2 + late[used] ** 2))
        return Compared(found, scale, outliers, gain, brightness, coarse, agreement, predicted, trust)

    def misfit(self, exposed: Exposed, measured: FloatArray, theta: FloatArray) -> float:
        """Return a robust mean of the residuals, for comparing distant θ: each counts at most as much as an outlier."""
        view, used = self._view, self._used
        residual = (measured - self.predicted(exposed.picture, theta))[used] / (FAR * view.white)
        return float(np.mean(np.minimum(residual**2, 1)))

    def _unexplained(
        self, residual: FloatArray, J: list[FloatArray], places: list[NDArray[np.int64]], valid: BoolArray
    ) -> FloatArray:
        """Return the residuals that no movement, lamp, even ambient light or delay explains, (used blocks, channels).

        Otherwise every change of the whole room would look like a foreign object.
        """
        layout = self.layout
        delays = layout.size + np.arange(self._rows.shape[1])
        even = np.zeros((layout.size + delays.size,) * 2)
        kept = np.concatenate([layout.all_geometry, layout.all_gains, layout.camera, delays])
        even[kept, kept] = 1
        for cells in layout.ambient.reshape(CHANNELS, layout.field):
            even[cells, cells[0]] = 1
        even = even[:, even.any(axis=0)]
        Z = [each @ even[where] for each, where in zip(J, places, strict=True)]
        fitted = _fitted(Z, residual, valid, np.zeros(even.shape[1]), _huber)
        starts = [_fitted(Z, residual, valid, start, _redescending) for start in (np.zeros_like(fitted), fitted)]
        left = [residual - np.stack([z @ x for z in Z], axis=1) for x in starts]
        scale = min(_scale(each[valid]) for each in left)
        cost = [float(np.sum(each[valid] ** 2 * np.sqrt(_redescending(each[valid] / scale)))) for each in left]
        return left[int(cost[1] < cost[0])]

    def _weights(self, residual: FloatArray, unclipped: BoolArray) -> tuple[float, FloatArray, float]:
        """Return the robust scale, the weight of each used block, and the share of foreign blocks."""
        size = np.sqrt(np.mean(residual**2, axis=1))
        scale = _scale(residual[unclipped]) if unclipped.any() else 1.0
        weights = unclipped * _redescending(size / scale)
        foreign = np.zeros(self._view.blocks.count, np.bool_)
        foreign[self._used] = size > OUTLIER * scale
        grid = foreign.reshape(self._view.shape)
        labels, count = ndimage.label(grid, np.ones((3, 3)))
        sizes = np.bincount(labels.ravel(), minlength=count + 1)
        large = (sizes >= REGION)[labels] & grid
        around = ndimage.binary_dilation(large, np.ones((3, 3), np.bool_), iterations=2).ravel()[self._used]
        weights = np.where(around, 0, weights)
        return scale, np.asarray(weights), float(around.mean())

    def _slopes(self, landed: FloatArray) -> list[FloatArray]:
        """Return the gradient of each projector's picture, (height, width, 2, 3), right and down, per reduced pixel."""
        found = []
        for box in self._view.boxes:
            down, right = np.gradient(landed[box.part], axis=(0, 1))
            found.append(np.stack([right, down], axis=2))
        return found

    def _derivatives(self, slopes: list[FloatArray], number: int) -> FloatArray:
        """Return the derivative of the blocks by one projector's homography, (channels, blocks, 8).

        The unit of each number moves a corner by a projector pixel.
        """
        view, box, u = self._view, self._view.boxes[number], self._places[number]
        found = np.empty((CHANNELS, view.blocks.count, GEOMETRY))
        whole = np.zeros((view.raster[0] * view.raster[1], GEOMETRY))
        index = np.arange(view.raster[0] * view.raster[1]).reshape(view.raster)[box.part].ravel()
        for channel in range(CHANNELS):
            right, down = slopes[number][..., channel].reshape(-1, 2).T / view.factor
            along = right * u[:, 0] + down * u[:, 1]
            shift, stretch = [right, down], [slope * u[:, i] for slope in (right, down) for i in range(2)]
            whole[index] = np.stack([*shift, *stretch, -along * u[:, 0], -along * u[:, 1]], axis=1)
            found[channel] = view.near(whole, channel)
        return found

    def _columns(
        self,
        channel: int,
        moves: list[FloatArray],
        lights: list[FloatArray],
        theta: FloatArray,
        texture: FloatArray,
        late: FloatArray,
    ) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the unknowns that one channel depends on, and the derivative of its blocks by them, (blocks, n)."""
        layout = self.layout
        places, columns = [], []
        for number, (each, light) in enumerate(zip(moves, lights, strict=True)):
            gain = layout.gain(number)[channel]
            places += [layout.geometry(number), np.array([gain])]
            columns += [each[channel], (light[:, channel] / (1 + theta[gain]))[:, None]]
        field = layout.ambient.reshape(CHANNELS, layout.field)[channel]
        places += [field, layout.camera, layout.size + np.arange(self._rows.shape[1])]
        columns += [self._lit[:, :, channel], texture[channel], late[:, channel, None] * self._rows]
        return np.concatenate(places), np.concatenate(columns, axis=1)

    def _only(self, landed: FloatArray, box: Region) -> FloatArray:
        """Return a reduced picture with all but one projector black."""
        alone = np.zeros_like(landed)
        alone[box.part] = landed[box.part]
        return alone

    def _texture(self, predicted: FloatArray) -> FloatArray:
        """Return the derivative by a shift and a turn of the texture, per pixel: (channels, blocks, cameras · 3).

        If a camera moves, the texture moves in its captures. The picture on the wall moves, too, but its movement is
        left to the homographies of the projectors.
        """
        view, (rows, columns) = self._view, self._view.shape
        floodlit = view.flood + view.ambient
        share = np.where(floodlit > 0, predicted / np.maximum(floodlit, 1e-12), 0)
        right, down = (share * slope for slope in view.slopes)
        y, x = (np.mgrid[:rows, :columns] + 0.5 - np.array([rows, columns])[:, None, None] / 2) / max(rows, columns) * 2
        turn = down * x.reshape(-1, 1) - right * y.reshape(-1, 1)
        moves = np.stack([right, down, turn], axis=-1).transpose(1, 0, 2)
        return np.concatenate([moves * own[:, None] for own in view.cameras], axis=2)

    def _homography(self, number: int, theta: FloatArray) -> FloatArray:
        """Return M for positions in reduced pixels from the corner of the projector's picture."""
        box = self._view.boxes[number]
        unit = self._view.factor * self._halves[number]
        return homography(theta[self.layout.geometry(number)] / unit, (box.height, box.width))


def _fitted(
    Z: list[FloatArray],
    residual: FloatArray,
    valid: BoolArray,
    x: FloatArray,
    weight: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Minimise a robust sum over channels k of |residual_k − Z_k x|, starting from x. `valid` blocks count."""
    for _ in range(ROUNDS):
        left = residual - np.stack([z @ x for z in Z], axis=1)
        weights = valid[:, None] * weight(left / (_scale(left[valid]) if valid.any() else 1.0))
        H, b = np.zeros((x.size, x.size)), np.zeros(x.size)
        for k, z in enumerate(Z):
            weighted = (weights[:, k, None] * z).T
            H += weighted @ z
            b += weighted @ residual[:, k]
        x = np.asarray(np.linalg.lstsq(H, b, rcond=1e-8)[0], np.float64)
    return x


def _rows(view: RoomView) -> FloatArray:
    """Return the factors of each camera's delays, its mean and its change to the lower edge: (blocks, 2 · cameras)."""
    found = []
    for own in view.cameras:
        grid = own.reshape(view.shape)
        y = np.flatnonzero(grid.any(axis=1))
        place = (
            np.interp(np.arange(view.shape[0]), [y[0], y[-1] + 1e-9], [-1, 1]) if y.size else np.zeros(view.shape[0])
        )
        found += [own, own * np.repeat(place, view.shape[1])]
    return np.stack(found, axis=1).astype(np.float64)


def _without_last(
    count: int, H: FloatArray, b: FloatArray, c: float, least: float
) -> tuple[FloatArray, FloatArray, float]:
    """Minimise ½ xᵀ H x − bᵀ x + c over the last `count` unknowns.

    least : information about each of them that is not in H.
    """
    kept, last = slice(None, -count), slice(-count, None)
    inverse = np.linalg.inv(H[last, last] + least * np.eye(count))
    across = H[kept, last] @ inverse
    c -= 0.5 * float(b[last] @ inverse @ b[last])
    return H[kept, kept] - across @ H[last, kept], b[kept] - across @ b[last], c


def _scale(residual: FloatArray) -> float:
    return max(float(MAD_TO_SIGMA * np.median(np.abs(residual))), LEAST_SCALE)


def _huber(residual: FloatArray) -> FloatArray:
    return np.asarray(1 / np.maximum(np.abs(residual) / HUBER, 1))


def _redescending(residual: FloatArray) -> FloatArray:
    return np.asarray(1 / (1 + (residual / SCALE) ** 2) ** 2)


def _slope(predicted: FloatArray, measured: FloatArray, weights: FloatArray) -> float:
    """Return the slope of the regression of measured on predicted light, (blocks, channels); NaN for a flat picture."""
    share = weights / max(float(weights.sum()), 1e-9)
    x, y = (each - share @ each for each in (predicted, measured))
    spread = float(np.sum(share @ x**2))
    return float(np.sum(share @ (x * y))) / spread if spread > (FLAT * predicted.mean()) ** 2 > 0 else np.nan


def _hats(shape: tuple[int, int], field: tuple[int, int]) -> FloatArray:
    """Return the weights of the cells of a field, as the player interpolates it (AmbientLight), (blocks, cells)."""
    axes = [np.zeros(sizes) for sizes in zip(shape, field, strict=True)]
    for axis in axes:
        first, weights = tents(axis.shape[1], len(axis), 0, len(axis))
        np.put_along_axis(axis, first[:, None] + np.arange(weights.shape[1]), weights, axis=1)
    return np.asarray(np.einsum("ri,cj->rcij", *axes).reshape(shape[0] * shape[1], -1))
