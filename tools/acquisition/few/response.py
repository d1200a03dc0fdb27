"""Measure the projector's response from the same pictures: a gamma from the sines, then each code from the ramps."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from counterlight.arrays import FloatArray
from counterlight.response import Response
from counterlight.tools.acquisition.few.far import Far
from counterlight.tools.acquisition.few.fitting import sampled, smooth
from counterlight.tools.acquisition.few.near import Windows
from counterlight.tools.acquisition.few.order import FIRST_SINE, RAMPS
from counterlight.tools.acquisition.few.places import Spots, located
from counterlight.tools.acquisition.few.seen import Seen, Table, some
from counterlight.tools.acquisition.ramps import CODES
from counterlight.tools.hdr.projector_response import fit_projector_response

ROUNDS = 2  # rounds between response and far light, which both affect the ramps
GAMMAS = 1.0, 4.0
OFF, BENT = 0.1, 0.02  # standard deviations of the levels' offset from a gamma curve, and of its second differences
INDEPENDENT = 1000  # camera pixels that count as independent, because neighbours have similar errors
AS_SEEN = 0.01  # error of a ramp that comes from a spot's place, as a share of the floodlight


@dataclass(frozen=True)
class Curves:
    """The projector's response.

    table : light per code value.
    gammas : approximate gammas; empty if the response was given.
    pooled : largest change that made the levels monotone; 0 if given.
    noise : standard deviation of a level; 0 if given.
    """

    response: Response
    table: Table
    gammas: tuple[float, ...] = ()
    pooled: float = 0.0
    noise: float = 0.0


def curves_of(seen: Seen, given: Response | None) -> tuple[Curves, Spots]:
    """Returns the projector's response, given or measured, and the spots found with it."""
    if given is not None:
        table = _table(given)
        return Curves(given, table), located(seen, table)
    table, random = gamma_table(seen), seen.order.random(seen.count)
    for _ in range(ROUNDS):
        windows, far = smooth(seen, table, located(seen, table), random)
        levels, noise = by_ramps(seen, table, windows, far)
        found = fit_projector_response(CODES / 255.0, levels)
        table = _table(found.response)
    return Curves(found.response, table, found.gammas, found.pooled, noise), located(seen, table)


def _table(response: Response) -> Table:
    codes = np.repeat(np.linspace(0, 1, 256)[:, None], 3, axis=1)
    return np.asarray(response.to_linear(codes), np.float32)


def gamma_table(seen: Seen) -> Table:
    """Returns a table (256, 3) with the gamma per primary that gives the sines' mean light, whatever the blur."""
    numbers = list(range(FIRST_SINE, seen.order.least))
    weights = (seen.clarity > 0) & ~seen.room.saturated.reshape(-1, 1)
    whole = np.einsum("nk,nkl->kl", weights, seen.primaries)
    means = [np.linalg.lstsq(whole, (weights * seen.above[number]).sum(axis=0), rcond=1e-6)[0] for number in numbers]
    codes = np.concatenate([seen.codes[number][:, 0] for number in numbers]) / 255.0
    histogram, edges = np.histogram(codes, 256, (0, 1))
    middles = (edges[1:] + edges[:-1]) / 2
    shares = histogram / histogram.sum()

    def gamma(mean: float) -> float:
        least, most = ((shares * middles**each).sum() for each in GAMMAS[::-1])
        target = float(np.clip(mean, least, most))
        return float(brentq(lambda each: (shares * middles**each).sum() - target, *GAMMAS))

    gammas = [gamma(float(mean)) for mean in np.mean(means, axis=0)]
    return np.stack([np.linspace(0, 1, 256) ** each for each in gammas], axis=1).astype(np.float32)


def by_ramps(seen: Seen, table: Table, windows: Windows, far: Far) -> tuple[FloatArray, float]:
    """Fit the light at each of CODES, (17, 3), to the ramps; returns it with the largest standard deviation.

    table : initial estimate.
    """
    levels, chosen = len(CODES), sampled(windows)
    squares, sums = np.zeros((3 * levels, 3 * levels)), np.zeros(3 * levels)
    for part in some(chosen, windows.size * 3 * levels):
        design, target, sigma = _equations(seen, windows.of(chosen[part]), far)
        weighted = design / sigma[..., None]
        squares += np.einsum("neu,nev->uv", weighted, weighted)
        sums += np.einsum("neu,ne->u", weighted, target / sigma)
    alike = min(INDEPENDENT / max(len(chosen), 1), 1.0)
    expected = table[CODES].T.ravel().astype(np.float64)
    bends = np.kron(np.eye(3), np.diff(np.eye(levels), 2, axis=0))
    inner = np.tile(np.isin(np.arange(levels), (0, levels - 1), invert=True), 3)
    system = (alike * squares + np.eye(3 * levels) / OFF**2 + bends.T @ bends / BENT**2)[np.ix_(inner, inner)]
    expected[inner] += np.linalg.solve(system, alike * (sums - squares @ expected)[inner])
    noise = float(np.sqrt(np.diag(np.linalg.inv(system)).max()))
    return expected.reshape(3, levels).T, noise


def _equations(seen: Seen, windows: Windows, far: Far) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns the ramps as camera pixels see them per level of each primary: (n, 3, 3 · levels)."""
    pixels, codes = windows.pixel, seen.codes[RAMPS] / 255.0
    near, whole = (1 - far.total[pixels])[:, None] * windows.start[..., None], far.of(pixels)
    parts = []
    for primary in range(3):
        levels = np.stack([np.interp(codes[:, primary], CODES / 255.0, hat) for hat in np.eye(len(CODES))], axis=1)
        cells = far.cells.labels()
        summed = np.stack([np.bincount(cells, level, far.cells.count) for level in levels.T], axis=1)
        of_cells = summed / np.bincount(cells, minlength=far.cells.count)[:, None]
        share = np.einsum("nw,nwu->nu", near[..., primary], levels[windows.columns]) + whole[:, primary] @ of_cells
        parts.append(seen.mixture[pixels][:, :, primary, None] * share[:, None])
    target, sigma = seen.targets(pixels, [RAMPS])
    return np.concatenate(parts, axis=2), target, np.hypot(sigma, AS_SEEN)
