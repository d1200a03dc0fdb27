"""Trust in camera pixels, and the visibility of projector pixels to trusted camera pixels, from T alone.

The border of the projector's raster cuts footprints. A pixel with a cut footprint cannot reach its target, and attempts
to reach it make its neighbours wrong. The cut shows in T's row, without any knowledge of the scene. The line of
projector pixels at the raster's border then has a larger share of the row's light than any line of a whole footprint.

Where several cameras see one place, each point of the screen counts once: w = a f / Σ f. a is the screen area that the
pixel sees. f is how far the seen projector pixels are from the border of the camera's picture. The sum is over all
cameras that see them. Towards the border of one camera's picture, its weight therefore fades into the other cameras'.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration
from counterlight.maps.row_map import SparseRows
from counterlight.screen import Screen
from counterlight.tools.transport.transport import Csr, Transport, channel, luminance, luminance_matrix

LEAST_TRUST = 0.01  # trust in pixels outside the mask
CUT_TRUST = 0.2  # 0.1: a folded wall is 0.4 dB below the optimum inside the border; 1: twice the light outside its view
CLEAR = 0.01  # share of the bright pixels' light; darker light may be noise
BRIGHT_PERCENTILE = 99
CUT, WIDE_AND_CUT, FALL = 1.1, 1.3, 0.5  # relative to the largest share of one line in a whole footprint
UNTOUCHED = 0.05  # share of a row's light at the border, below which its footprint is certainly whole
NEARBY = 9  # camera pixels per side, over which whole footprints are averaged
FEW = 0.1  # least share of those pixels
LARGEST_PERCENTILE = 99.0  # percentile of areas; folds of a screen that is continued far have any area
LEAST = 1e-3  # smallest weight; pixels that other cameras see better are kept


@dataclass(frozen=True)
class _Shares:
    """T by rows, each entry as a share of its row's light, without far light.

    near : (camera pixels, projector pixels).
    blurred : the same over cells, and P.
    """

    near: Csr
    blurred: tuple[Csr, Csr] | None
    projector: tuple[int, int]

    @classmethod
    def of(cls, T: Transport, projector: tuple[int, int]) -> "_Shares":
        total = _light(T)
        near, blurred = _shares(T.near, total), None
        if T.blurred is not None:
            blurred = _shares(T.blurred.scatter, total), channel(T.blurred.gather, 0).astype(np.float64)
        return cls(near, blurred, projector)

    def lines(self, axis: int) -> Csr:
        """Return the shares of the raster's lines, by y for axis 0, by x for axis 1: (camera pixels, lines)."""
        places = np.indices(self.projector, np.int32)[axis].ravel()
        lines = _over_lines(self.near, places, self.projector[axis])
        if self.blurred is not None:
            scatter, gather = self.blurred
            lines = Csr(lines + scatter @ _over_lines(gather, places, self.projector[axis]))
        return lines


def _light(T: Transport) -> FloatArray:
    """Return the luminance of the floodlight without far light, (camera pixels,)."""
    rows = [T.near] if T.blurred is None else [T.near, T.blurred.scatter]
    return np.asarray(sum(np.bincount(each.rows, luminance(each.weights), each.shape[0]) for each in rows))


def _shares(rows: SparseRows, total: FloatArray) -> Csr:
    """Return luminance as shares of each row's `total`."""
    light, whole = luminance(rows.weights), total[rows.rows]
    shares = np.divide(light, whole, out=np.zeros_like(light), where=whole > 0)
    return Csr((shares, rows.indices, rows.indptr), shape=rows.shape)


def _over_lines(matrix: Csr, places: NDArray[np.int32], count: int) -> Csr:
    """Sum columns by the line that each is in."""
    lines = Csr((matrix.data, places[matrix.indices], matrix.indptr), shape=(matrix.shape[0], count), copy=True)
    lines.sum_duplicates()  # sums in place
    return lines


def trust(T: Transport, counts: NDArray[np.bool_], projector: tuple[int, int]) -> FloatArray:
    """Return w, (camera pixels,): the weight of each camera pixel; 0 without near or blurred light.

    w is 1 inside the mask. If the raster's border cuts the footprint of a clearly lit pixel, w falls from 0.52 to
    CUT_TRUST for `cut_by_edges` from 1.1 to 1.3. Narrow footprints, nearly all in one line, do not disturb other
    pixels. Other pixels outside the mask have LEAST_TRUST: they decide only where no trusted pixel does. Such pixels
    could not be measured, or a user's mask excludes them.

    counts : (camera height, camera width). The mask.
    projector : (height, width).
    """
    light = _light(T)
    lit = light > 0
    clear = lit & (light > CLEAR * np.percentile(light[lit], BRIGHT_PERCENTILE)) if lit.any() else lit
    cut = cut_by_edges(T, (counts.shape[0], counts.shape[1]), projector)
    narrow = np.clip((WIDE_AND_CUT - cut) / FALL, 0, 1)
    outside = np.where(clear & (cut >= CUT), CUT_TRUST + (1 - CUT_TRUST) * narrow, LEAST_TRUST * lit)
    return np.where(counts.ravel(), 1.0, outside)


def cut_by_edges(T: Transport, camera: tuple[int, int], projector: tuple[int, int]) -> FloatArray:
    """Return s / m, (camera pixels,): how much of a footprint lies at a border of the raster, which may cut it.

    s is the share of a row's light on the outermost line of the raster. m is the largest share of one line in the whole
    footprints nearby: almost 1 in focus, small for wide footprints. s / m is 1 for a whole footprint in the outermost
    line, and larger for a cut footprint.

    camera, projector : (height, width).
    """
    shares = _Shares.of(T, projector)
    return np.asarray(np.maximum(*(_cut(shares.lines(axis), camera) for axis in (1, 0))))


def _cut(lines: Csr, camera: tuple[int, int]) -> FloatArray:
    """Return s / m for two opposite borders, the first and the last line."""
    at_edge = _largest(Csr(lines[:, np.unique([0, lines.shape[1] - 1])]))
    return np.asarray(at_edge / _around(_largest(lines), at_edge < UNTOUCHED, camera))


def _largest(lines: Csr) -> FloatArray:
    """Return the largest entry of each row, (rows,)."""
    return np.asarray(lines.max(axis=1).toarray(), np.float64).ravel()


def _around(largest: FloatArray, untouched: NDArray[np.bool_], camera: tuple[int, int]) -> FloatArray:
    """Return the mean of `largest` over untouched footprints nearby, or over the nearest ones; 1 if there are none."""
    whole = (untouched & (largest > 0)).reshape(camera)
    weight = ndimage.uniform_filter(whole.astype(np.float64), NEARBY, mode="constant")
    enough = weight > FEW
    if not enough.any():
        return np.ones(largest.size)
    total = ndimage.uniform_filter(np.where(whole, largest.reshape(camera), 0), NEARBY, mode="constant")
    nearest = ndimage.distance_transform_edt(~enough, return_distances=False, return_indices=True)
    return np.asarray((total / np.maximum(weight, FEW))[tuple(nearest)].ravel())


def seen(T: Transport, trusted: NDArray[np.bool_]) -> FloatArray:
    """Return how well trusted camera pixels see each projector pixel, 1 for most pixels: (projector pixels,).

    Sums over the camera pixels to which projector pixel j contributes, relative to the usual contribution there: Σ_i
    min(1, T_ij / m_i), m_i = Σ_k T_ik² / Σ_k T_ik. Paint cancels. Fifty pixels that a lens gathers into one camera
    pixel all count as seen. A pixel with only the rim of its footprint in view does not.

    trusted : (camera pixels,).
    """
    total, squares = _light(T), _squares(T)
    total[~trusted] = 0
    usual = np.divide(squares, total, out=np.zeros_like(total), where=total > 0)
    count = _contributions(T.near, luminance(T.near.weights), usual)
    if T.blurred is not None:
        # All pixels of a cell contribute equally.
        gather, scatter = T.blurred.gather, T.blurred.scatter
        share = _largest_of_rows(gather)
        cells = _contributions(scatter, luminance(scatter.weights) * share[scatter.indices], usual)
        count += np.bincount(gather.indices, cells[gather.rows], gather.columns)
    return _relative_to_usual(count)


def camera_pixels(T: Transport, trusted: NDArray[np.bool_]) -> FloatArray:
    """Return how many trusted camera pixels each projector pixel fills, v_j = Σ_i T_ij / (T·1)_i: (projector pixels,).

    The shares of a camera pixel's light say which projector pixels fill it, regardless of paint.

    trusted : (camera pixels,).
    """
    total = _light(T)
    total[~trusted] = 0
    made = _made(T.near, total)
    if T.blurred is not None:
        cells, gather = _made(T.blurred.scatter, total), T.blurred.gather
        made += np.bincount(gather.indices, cells[gather.rows] * gather.weights[:, 0], gather.columns)
    return made


def _squares(T: Transport) -> FloatArray:
    """Return Σ_k T_ik² of luminance without far light, (camera pixels,)."""
    found = np.bincount(T.near.rows, luminance(T.near.weights) ** 2, T.near.shape[0])
    if T.blurred is not None:
        gather, scatter = T.blurred.gather, T.blurred.scatter
        of_cell = np.bincount(gather.rows, gather.weights[:, 0].astype(np.float64) ** 2, gather.shape[0])
        found += np.bincount(scatter.rows, luminance(scatter.weights) ** 2 * of_cell[scatter.indices], found.size)
    return np.asarray(found, np.float64)


def _contributions(rows: SparseRows, light: FloatArray, usual: FloatArray) -> FloatArray:
    """Return Σ_i min(1, light / usual) of every column, (columns,); rows with usual 0 count nothing."""
    expected = usual[rows.rows]
    compared = np.divide(light, expected, out=np.zeros_like(light), where=expected > 0)
    return np.bincount(rows.indices, np.minimum(compared, 1), rows.columns).astype(np.float64)


def _largest_of_rows(rows: SparseRows) -> FloatArray:
    """Return the largest weight of each row, (rows,)."""
    largest = np.zeros(rows.shape[0])
    np.maximum.at(largest, rows.rows, rows.weights[:, 0])
    return largest


def _relative_to_usual(count: FloatArray) -> FloatArray:
    """Scale counts so that half of their sum belongs to counts up to 1.

    Neither the many pixels that no camera sees nor a few whose light a pane scatters over the view change this scale.
    """
    share = np.maximum(count, 0)  # an imported T may hold slightly negative values
    if not share.any():
        return count
    return np.asarray(count / np.quantile(share, 0.5, weights=share, method="inverted_cdf"))


def _made(rows: SparseRows, total: FloatArray) -> FloatArray:
    """Return each column's sum of shares of its rows' `total`, (columns,); rows without light add nothing."""
    shares = _shares(rows, total)
    return np.bincount(shares.indices, shares.data, rows.columns).astype(np.float64)


def shares(near: SparseRows, calibration: Calibration) -> FloatArray:
    """Return weights (camera pixels,), above 0 to 1; all 1 for one camera.

    near : T, (camera pixels, projector pixels).
    """
    screen = calibration.screen
    if screen is None:
        return np.ones(near.shape[0])
    T, inner = luminance_matrix(near).astype(np.float64), _depths(screen, calibration.mask).ravel()
    pixels = np.arange(near.shape[0]).reshape(calibration.camera.shape)
    light = np.asarray(T.sum(axis=1)).ravel()
    own, all_of_them = np.zeros(near.shape[0]), np.zeros(near.shape[0])
    for part in screen.parts:
        rows = pixels[part].ravel()
        seen, weighted = (T[rows].T @ values[rows] for values in ((inner > 0).astype(np.float64), inner))
        depth = T @ np.divide(weighted, seen, out=np.zeros_like(weighted), where=seen > 0)
        depth = np.divide(depth, light, out=np.zeros_like(depth), where=light > 0)
        all_of_them += depth
        own[rows] = depth[rows]
    say = np.divide(own, all_of_them, out=np.ones_like(own), where=all_of_them > 0)
    return np.asarray(np.maximum(say * _areas(screen, calibration.mask).ravel(), LEAST))


def _depths(screen: Screen, mask: BoolArray) -> FloatArray:
    """Return each pixel's distance from the border of its camera's mask, in screen pixels; 0 outside the mask."""
    depths, scale = np.zeros(mask.shape), np.sqrt(_areas(screen, mask))
    for part in screen.parts:
        depths[part] = ndimage.distance_transform_edt(np.pad(mask[part], 1))[1:-1, 1:-1]
    return np.asarray(depths * scale)


def _areas(screen: Screen, mask: BoolArray) -> FloatArray:
    """Return the screen area that each pixel sees, relative to the largest area of pixels that count."""
    across, down = (axis.astype(np.float64) for axis in screen.axes)
    areas = np.abs(across[..., 1] * down[..., 2] - across[..., 2] * down[..., 1])
    return np.asarray(np.clip(areas / np.percentile(areas[mask], LARGEST_PERCENTILE), 0, 1))
