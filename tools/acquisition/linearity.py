"""Test whether the camera is linear, with a picture and its complement, for any response of the projector.

The light p of a picture and the light q of its complement add up to the light w of white in every camera pixel. A
camera with a curve (sRGB, a gamma, contrast) captures another sum where both pictures give light: with sRGB, two halves
add up to 1.42 of the whole. Where one picture gives all of the light, the sum is right. The excess is fitted by

    (p + q) / w − 1 = k + a (1 − x²) + b x,    x = (p − q) / w,

and a is the bend: 0 for a linear camera. k absorbs a projector or lamp that is brighter for dark pictures, and b
absorbs a capture of another picture. Cells of all sizes let x take all values in and out of focus.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.screen import parts_of
from counterlight.tools.acquisition.cameras.camera import LINEAR, Camera
from counterlight.tools.acquisition.cameras.together import views_of
from counterlight.tools.acquisition.plan import Pattern, Reference

SEED = 20250318
SHOTS = 4  # captures of the picture, and of its complement
CLEARLY_LIT = 20  # light of a clearly lit value, in multiples of the noise of a dark capture
# darkest share of the clearly lit values, which is skipped: noise and JPEG blocks also bend the sums of dark values
BRIGHT = 0.5
MOST_BENT = 0.08  # linear cameras measured up to 0.05, as JPEG of quality 50; a gamma of 1.2 gives 0.10
SURELY = 4  # standard deviations by which a bend must exceed its limit
SCATTERED = 2  # a bend must exceed this multiple of the sums' scatter to count as a curve
MODEL = 0.02  # relative error of the sums that the fit does not explain
SUSPECT = 0.02  # bend from which on the curve is measured
FEWEST = 30  # camera values that a fit needs
LEAST_SPREAD = 1e-3  # least variance of 1 − x²; with less, no pixel sees both pictures, or each pixel sees both alike


@dataclass(frozen=True)
class Bend:
    """The bend of a camera.

    amount : a; two halves of the light are captured as 1 + a of the whole.
    deviation : standard deviation of the amount.
    scatter : RMS of the fit's residuals. A large scatter means that the captures show something else.
    """

    amount: float
    deviation: float
    scatter: float = 0.0

    @property
    def is_linear(self) -> bool:
        """Whether a linear camera can have the bend, or the bend is too scattered to come from a camera."""
        return abs(self.amount) <= max(MOST_BENT + SURELY * self.deviation, SCATTERED * self.scatter)

    @property
    def is_suspect(self) -> bool:
        """Whether the camera may have a curve, even a weak one."""
        return abs(self.amount) > max(SUSPECT + SURELY * self.deviation, SCATTERED * self.scatter)

    def described(self, response: Response = LINEAR, *, measured: bool = False) -> str:
        """Returns the fault and its remedy.

        response : the response given for the camera.
        measured : whether the captures were read with a measured curve.
        """
        half = f"half and half of the light are captured as {100 * (1 + self.amount):.0f} % of the whole"
        expected = f"expected 100 ± {100 * MOST_BENT:.0f} %"
        if measured:
            return (
                f"{half} ({expected}), even with the camera's curve as measured: lock the camera's exposure, gain and "
                "white balance, switch the projector's dynamic contrast and scaling off, and acquire again"
            )
        if response != LINEAR:
            cause = "--camera-response is not the camera's curve"
        elif self.amount > 0:
            cause = "the captures have a curve, as JPEGs and webcams have (sRGB, gamma, contrast)"
        else:
            cause = (
                "the captures have a contrast curve, or the projector resamples pictures (switch keystone, zoom and "
                "scaling off)"
            )
        return (
            f"{half} ({expected}): {cause}; save RAW, set the camera to linear, or give its curve with "
            "--camera-response: srgb, a gamma such as 2.2, or a file of counterlight merge-exposures --save-response"
        )


def halves_of(projector: tuple[int, int]) -> Pattern:
    """Returns a pattern of cells of all sizes with half of the pixels lit."""
    (field,) = cells_of(projector)
    return np.asarray(field > np.median(field))


def cells_of(projector: tuple[int, int], fields: int = 1) -> FloatArray:
    """Returns random fields of superposed cells of 1, 2, 4 … pixels: (fields, height, width); the seed is fixed."""
    rng, found = np.random.default_rng(SEED), np.zeros((fields, *projector))
    side = 1
    while side <= max(max(projector) // 4, 1):
        cells = rng.standard_normal([fields, *(-(-length // side) for length in projector)])
        found += cells.repeat(side, axis=1).repeat(side, axis=2)[:, : projector[0], : projector[1]]
        side *= 2
    return found


def shown_halves(projector: tuple[int, int]) -> list[Pattern]:
    """Returns the picture SHOTS times, then its complement SHOTS times."""
    picture = halves_of(projector)
    return [picture] * SHOTS + [~picture] * SHOTS


def bend_of(room: Reference, picture: FloatArray, complement: FloatArray) -> Bend | None:
    """Fit the bend of captures; None if too few camera pixels are lit.

    picture, complement : (camera height, camera width, 3). Radiance, each the mean of SHOTS captures.
    """
    p, q, w = (each - room.black for each in (picture, complement, room.floodlight))
    lit = ~room.saturated[..., None] & (w >= CLEARLY_LIT * room.noise.dark) & (w > 0)
    if lit.sum() < FEWEST:
        return None
    lit &= w >= np.quantile(w[lit], BRIGHT)
    variance = (room.noise.sigma(p) ** 2 + room.noise.sigma(q) ** 2) / SHOTS
    p, q, w, variance = p[lit], q[lit], w[lit], variance[lit]
    return _fitted((p + q) / w - 1, (p - q) / w, 1 / (variance / w**2 + MODEL**2))


def bend_of_shares(captured: FloatArray, shares: FloatArray, white: FloatArray, dark: FloatArray) -> Bend | None:
    """Fit the bend from pictures whose shares of white were fitted; None if too few values are lit.

    The fitted shares already absorb some of the bend.

    captured, shares, white : (…, 3). Light above black, the fitted shares, and light of white.
    dark : (3,). Noise of a dark capture.
    """
    lit = (white >= CLEARLY_LIT * dark) & (white > 0)
    if lit.sum() < FEWEST:
        return None
    lit &= white >= np.quantile(white[lit], BRIGHT)
    share = shares[lit]
    bend = _fitted(2 * (captured[lit] / white[lit] - share), 2 * share - 1, np.ones_like(share))
    # the curve of the camera also causes scatter, so the scatter is ignored
    return None if bend is None else replace(bend, scatter=0.0)


def _fitted(excess: FloatArray, x: FloatArray, weights: FloatArray) -> Bend | None:
    """Weighted least squares; the deviation uses the actual residuals, whatever the weights (White 1980)."""
    if np.var(1 - x**2) < LEAST_SPREAD:
        return None
    design = np.stack([1 - x**2, np.ones_like(x), x], axis=1)
    weighted = design * weights[:, None]
    inverse = np.linalg.pinv(design.T @ weighted)
    found = inverse @ (weighted.T @ excess)
    left = excess - design @ found
    scores = weighted * left[:, None]
    deviation = np.sqrt((inverse @ (scores.T @ scores) @ inverse)[0, 0])
    return Bend(float(found[0]), float(deviation), float(np.sqrt(np.average(left**2, weights=weights))))


def bends_of(camera: Camera, room: Reference, picture: FloatArray, complement: FloatArray) -> list[Bend | None]:
    """Returns `bend_of` for each camera."""
    parts = parts_of(views_of(camera)) or (...,)
    return [
        bend_of(
            replace(room, black=room.black[part], floodlight=room.floodlight[part], saturated=room.saturated[part]),
            picture[part],
            complement[part],
        )
        for part in parts
    ]


def refuse_bends(camera: Camera, bends: Sequence[Bend | None], name: str = "", *, measured: bool = False) -> None:
    """Raises InputError for a bend that a linear camera cannot have.

    name : prefix that names the projector.
    measured : whether the captures were read with a measured curve.
    """
    for number, bend in enumerate(bends, 1):
        if bend is not None and not bend.is_linear:
            who = f"{name}camera {number}: " if len(bends) > 1 else name
            bending = bend.described(camera.exposures.response, measured=measured)
            raise InputError(f"{who}light does not add up in the captures: {bending}")
