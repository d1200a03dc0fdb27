"""Correct the predictions of a fit by a small network, for what the model of a room cannot hold.

The network sees the picture around the place of each camera pixel, the prediction, and the surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.tools.pairs.fitting import Fitted, Part, held_back, reduced
from counterlight.tools.pairs.geometry import Pictures
from counterlight.tools.pairs.model import SATURATED
from tests.real.network import GAMMA, Example, Network, around, encoded, surface, trained

STEPS = 600  # steps of training


@dataclass(frozen=True)
class Correction:
    """A trained correction of predictions of a fit."""

    fitted: Fitted
    network: Network

    def predict(self, pictures: NDArray[np.uint8], predicted: Pictures) -> Pictures:
        """Return the corrected predictions of the captures of pictures, at gain 1."""
        result = np.array(predicted, np.float32)
        for number, picture in enumerate(pictures):
            base = encoded(predicted[number])
            found = self.network.apply(_inputs(self.fitted, picture, base), base)
            result[number][self.fitted.lit] = (np.clip(found, 0, 1) ** GAMMA)[self.fitted.lit]
        return result


def fit_correction(
    fitted: Fitted, parts: Sequence[Part], pictures: NDArray[np.uint8], captures: Pictures, seed: int = 0
) -> Correction:
    """Train a correction on predictions of parts of the pairs by models of the other parts."""
    predicted = held_back(fitted, parts, pictures)

    def example(picture: NDArray[np.uint8], light: NDArray[np.floating], capture: NDArray[np.floating]) -> Example:
        base = encoded(light)
        known = fitted.lit[..., None] & (capture < SATURATED)
        return Example(_inputs(fitted, picture, base), base, np.where(known, encoded(capture), base))

    examples = (example(*each) for each in zip(pictures, predicted, captures, strict=True))
    return Correction(fitted, trained(examples, len(pictures), steps=STEPS, seed=seed))


def _inputs(fitted: Fitted, picture: NDArray[np.uint8], base: NDArray[np.floating]) -> NDArray[np.floating]:
    code = fitted.places.warped(reduced(picture / np.float32(255), fitted.factor))
    white = encoded(fitted.model.slope)
    parts = [around(code), code - 0.5, surface(fitted.model.slope, fitted.model.offset), base - 0.5, base - white]
    return np.concatenate(parts, axis=-1)
