"""Recover pictures from captures: the surrogate task of the projector compensation literature.

The first estimate is the light that each pixel's affine map gives. Each stage predicts the captures of the estimates,
corrects each pixel by the difference, and lets a small network judge the corrections. Trained on the pairs, the network
learns the noise and the look of natural pictures.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.tools.pairs.fitting import Fitted, Part, reduced
from counterlight.tools.pairs.geometry import Pictures, looked_up
from counterlight.tools.pairs.model import Model
from tests.real.network import Example, Network, around, encoded, surface, trained

SIZE = 256, 192  # (width, height) of the literature
STAGES, STEPS = 2, 1500  # stages; steps of training per stage
STEP, FLAT = 0.7, 0.3  # share of the difference that is corrected; slope of φ below which corrections are damped
NEAR = 0.02  # code values between which φ's slope is measured
SIMILARITY = 0.02  # weight of SSIM next to the squared error
NEWTON = 12  # steps of Newton's method


@dataclass(frozen=True)
class Surrogate:
    """A trained surrogate.

    raster : (height, width) of the pictures that the fit's places refer to.
    back : (height, width, 2) float32. The camera pixel that each pixel of the picture lights.
    networks : one network per stage.
    """

    fitted: Fitted
    raster: tuple[int, int]
    back: NDArray[np.floating]
    networks: tuple[Network, ...] = ()

    def start(self, captures: Pictures, model: Model | None = None) -> Pictures:
        """Return the estimate of each pixel alone, as code values."""
        slope, offset = self._surface(model or self.fitted.model)
        seen = np.stack([looked_up(capture, self.back) for capture in captures])
        light = (seen - offset) / np.maximum(slope, 0.02 * slope.mean())
        return np.asarray(encoded(light), np.float32)

    def pictures(self, captures: Pictures) -> Pictures:
        """Recover pictures, (captures, height, width, 3), code values from 0 to 1."""
        found = self.start(captures)
        for network in self.networks:
            corrected = self.corrected(found, captures, self.fitted.model)
            found = np.stack(list(self._judged(network, found, corrected)))
        return found

    def corrected(self, found: Pictures, captures: Pictures, model: Model) -> Pictures:
        """Correct code values by a damped Newton step from the prediction of their captures to the captures."""
        processing, slope = self.fitted.processing, self._surface(model)[0]
        light = (np.asarray(cv2.resize(processing.light(each), self.raster[::-1]), np.float32) for each in found)
        predicted = model.predict(np.stack([self.fitted.places.warped(each) for each in light]))
        result = np.empty_like(found)
        for number, (code, rest) in enumerate(zip(found, captures - predicted, strict=True)):
            missing = looked_up(rest, self.back) / np.maximum(slope, 0.05 * slope.mean())
            by_code = self._by_code(code)
            result[number] = np.clip(code + STEP * by_code * missing / (by_code**2 + FLAT**2), 0, 1)
        return result

    def _by_code(self, code: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return the derivative of each primary's light by its own code."""
        result = np.empty_like(code)
        for k in range(3):
            low, high = code.copy(), code.copy()
            low[..., k], high[..., k] = np.maximum(code[..., k] - NEAR, 0), np.minimum(code[..., k] + NEAR, 1)
            rise = self.fitted.processing.light(high) - self.fitted.processing.light(low)
            result[..., k] = rise[..., k] / (high - low)[..., k]
        return result

    def _surface(self, model: Model) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        slope, offset = (looked_up(each, self.back) for each in (model.slope, model.offset))
        return np.maximum(slope, 1e-3), offset

    def inputs(self, found: NDArray[np.floating], corrected: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return the network's numbers for a picture."""
        change = 5 * (corrected - found)
        parts = [around(found), found - 0.5, around(change), change, surface(*self._surface(self.fitted.model))]
        return np.concatenate(parts, axis=-1)

    def _judged(self, network: Network, found: Pictures, corrected: Pictures) -> Iterator[NDArray[np.floating]]:
        for before, after in zip(found, corrected, strict=True):
            yield np.clip(network.apply(self.inputs(before, after), before), 0, 1).astype(np.float32)


def reduced_codes(pictures: NDArray[np.uint8]) -> Pictures:
    """Return pictures at SIZE, code values from 0 to 1."""
    small = np.stack([cv2.resize(each, SIZE, interpolation=cv2.INTER_AREA) for each in pictures])
    return np.asarray(small / np.float32(255))


def fit_surrogate(
    fitted: Fitted, parts: Sequence[Part], pictures: NDArray[np.uint8], captures: Pictures, seed: int = 0
) -> Surrogate:
    """Train a surrogate on pairs. Each part is corrected by the model of the other parts, as new captures will be."""
    codes = reduced_codes(pictures)
    raster = reduced(pictures[0], fitted.factor).shape[:2]
    surrogate = Surrogate(fitted, (raster[0], raster[1]), _back(fitted, pictures.shape[1:3]))
    found, corrected = np.empty_like(codes), np.empty_like(codes)
    for part in parts:
        found[part.pairs] = surrogate.start(captures[part.pairs], part.model)
    for stage in range(STAGES):
        for part in parts:
            corrected[part.pairs] = surrogate.corrected(found[part.pairs], captures[part.pairs], part.model)
        examples = (
            Example(surrogate.inputs(*each[:2]), each[0], each[2]) for each in zip(found, corrected, codes, strict=True)
        )
        network = trained(examples, len(codes), steps=STEPS, similarity=SIMILARITY, seed=seed + stage)
        found = np.stack(list(surrogate._judged(network, found, corrected)))
        surrogate = replace(surrogate, networks=(*surrogate.networks, network))
    return surrogate


def _back(fitted: Fitted, projector: Sequence[int]) -> NDArray[np.floating]:
    """Invert the places of green: the camera pixel of each pixel of a picture of SIZE, by Newton steps."""
    places = fitted.places.places[1]
    height, width = places.shape[:2]
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    step = np.array([projector[1] / SIZE[0], projector[0] / SIZE[1]])
    target = ((np.stack([x, y], axis=-1) + 0.5) * step / fitted.factor - 0.5).astype(np.float32)
    at_y, at_x = np.nonzero(fitted.lit)
    A = np.column_stack([places[at_y, at_x], np.ones(len(at_x))])
    affine = np.linalg.lstsq(A, np.column_stack([at_x, at_y]), rcond=None)[0]
    back = (target @ affine[:2] + affine[2]).astype(np.float32)
    for _ in range(NEWTON):
        inside = np.clip(back, 0, [width - 1, height - 1]).astype(np.float32)
        here = cv2.remap(places, inside[..., 0], inside[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        back = (inside + (target - here) @ affine[:2]).astype(np.float32)
    return np.asarray(back)
