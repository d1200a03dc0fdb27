"""Recover pictures from captures: the surrogate task of the projector compensation literature.

Each capture is brought to the picture's raster, and the light that each pixel's affine map implies is a first estimate.
A small network then estimates code values from the estimates around a pixel and from the pixel's surface. Trained on
the pairs, it learns the response, the spread, the noise, and the look of natural pictures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.pairs.fitting import Fitted
from counterlight.tools.pairs.geometry import Pictures, looked_up, regression

SIZE = 256, 192  # (width, height) of the literature
GAMMA = 2.2
REACH = 2  # pixels from the middle of a patch to its edge
WIDE = 2.0, 6.0  # standard deviations of blurs that describe a pixel's surroundings
HIDDEN = 48, 32
BATCH, EPOCHS, SAMPLES, RATE = 1024, 6, 1_000_000, 2e-3
NEWTON = 12  # steps of Newton's method


@dataclass(frozen=True)
class Surrogate:
    """A trained surrogate.

    back : (height, width, 2) float32. The camera pixel that each pixel of the picture lights.
    slope, offset : (height, width, 3). The affine map from light to capture.
    layers : weights and offsets of the network.
    """

    back: NDArray[np.floating]
    slope: NDArray[np.floating]
    offset: NDArray[np.floating]
    layers: Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]]

    def start(self, captures: Pictures) -> Pictures:
        """Return the estimate of each pixel alone, as code values."""
        seen = np.stack([looked_up(capture, self.back) for capture in captures])
        light = (seen - self.offset) / np.maximum(self.slope, 0.02 * self.slope.mean())
        return np.asarray(np.clip(light, 0, 1.5) ** np.float32(1 / GAMMA))

    def pictures(self, captures: Pictures) -> Pictures:
        """Recover pictures, (captures, height, width, 3), code values from 0 to 1."""
        result = []
        for start in self.start(captures):
            inputs = _inputs(start, self.slope, self.offset)
            result.append(_output(self.layers, inputs, start.reshape(-1, 3)).reshape(start.shape))
        return np.stack(result)


def reduced_codes(pictures: NDArray[np.uint8]) -> Pictures:
    """Return pictures at SIZE, code values from 0 to 1."""
    small = np.stack([cv2.resize(each, SIZE, interpolation=cv2.INTER_AREA) for each in pictures])
    return np.asarray(small / np.float32(255))


def fit_surrogate(fitted: Fitted, pictures: NDArray[np.uint8], captures: Pictures, seed: int = 0) -> Surrogate:
    """Train a surrogate on pairs."""
    codes = reduced_codes(pictures)
    back = _back(fitted, pictures.shape[1:3])
    seen = np.stack([looked_up(capture, back) for capture in captures])
    light: Pictures = np.stack(
        [cv2.resize(fitted.processing.light(each / 255), SIZE, interpolation=cv2.INTER_AREA) for each in pictures]
    )
    slope, offset, _ = regression(light, seen)
    untrained = Surrogate(back, np.maximum(slope, 1e-3).astype(np.float32), offset.astype(np.float32), ())
    starts = untrained.start(captures)
    rng = np.random.default_rng(seed)
    share = min(1.0, SAMPLES / (len(codes) * SIZE[0] * SIZE[1]))
    inputs, rest, base = [], [], []
    for start, code in zip(starts, codes, strict=True):
        chosen = np.flatnonzero(rng.random(SIZE[0] * SIZE[1]) < share)
        inputs.append(_inputs(start, untrained.slope, untrained.offset)[chosen])
        base.append(start.reshape(-1, 3)[chosen])
        rest.append(code.reshape(-1, 3)[chosen])
    layers = _trained(np.concatenate(inputs), np.concatenate(base), np.concatenate(rest), rng)
    return Surrogate(back, untrained.slope, untrained.offset, layers)


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


def _inputs(
    start: NDArray[np.floating], slope: NDArray[np.floating], offset: NDArray[np.floating]
) -> NDArray[np.floating]:
    """Return the network's inputs, (pixels, inputs): the patch around a pixel, its surroundings, and its surface."""
    height, width = start.shape[:2]
    padded = cv2.copyMakeBorder(start, REACH, REACH, REACH, REACH, cv2.BORDER_REFLECT)
    side = 2 * REACH + 1
    parts = [padded[dy : dy + height, dx : dx + width] - start for dy in range(side) for dx in range(side)]
    del parts[len(parts) // 2]
    parts += [cv2.GaussianBlur(start, (0, 0), sigma) - start for sigma in WIDE]
    scale = slope.mean()
    parts += [start - 0.5, np.log(slope / scale + 0.05), 10 * offset / scale]
    parts.append(np.broadcast_to(start.mean(axis=(0, 1)) - 0.5, start.shape))
    return np.asarray(np.concatenate(parts, axis=-1).reshape(height * width, -1), np.float32)


def _output(
    layers: Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]], inputs: NDArray[np.floating], base: Pictures
) -> NDArray[np.floating]:
    values = inputs
    for weight, offset in layers[:-1]:
        values = np.maximum(values @ weight + offset, 0)
    return np.asarray(base + values @ layers[-1][0] + layers[-1][1])


def _trained(
    inputs: NDArray[np.floating], base: NDArray[np.floating], wanted: NDArray[np.floating], rng: np.random.Generator
) -> list[tuple[NDArray[np.floating], NDArray[np.floating]]]:
    """Train the network by Adam on squared errors, with a rate that falls to zero."""
    sizes = [inputs.shape[1], *HIDDEN, 3]
    weights = [
        rng.normal(0, np.sqrt(2 / a), (a, b)).astype(np.float32) * (0.1 if b == 3 else 1) for a, b in pairwise(sizes)
    ]
    offsets = [np.zeros(b, np.float32) for b in sizes[1:]]
    parameters = [*weights, *offsets]
    first, second = ([np.zeros_like(each) for each in parameters] for _ in range(2))
    steps = EPOCHS * (len(inputs) // BATCH)
    for number in range(steps):
        chosen = rng.integers(0, len(inputs), BATCH)
        gradients = _gradients(weights, offsets, inputs[chosen], wanted[chosen] - base[chosen])
        rate = RATE * 0.5 * (1 + np.cos(np.pi * number / steps))
        corrected = rate * np.sqrt(1 - 0.999 ** (number + 1)) / (1 - 0.9 ** (number + 1))
        for each, gradient, m, v in zip(parameters, gradients, first, second, strict=True):
            m += 0.1 * (gradient - m)
            v += 0.001 * (gradient**2 - v)
            each -= np.float32(corrected) * m / (np.sqrt(v) + 1e-8)
    return list(zip(weights, offsets, strict=True))


def _gradients(
    weights: list[NDArray[np.floating]],
    offsets: list[NDArray[np.floating]],
    inputs: NDArray[np.floating],
    wanted: NDArray[np.floating],
) -> list[FloatArray]:
    """Return the gradients of the mean squared error: of all weights, then of all offsets."""
    values = [inputs]
    for weight, offset in zip(weights[:-1], offsets[:-1], strict=True):
        values.append(np.maximum(values[-1] @ weight + offset, 0))
    error = (values[-1] @ weights[-1] + offsets[-1] - wanted) / len(inputs)
    of_weights: list[FloatArray] = []
    of_offsets: list[FloatArray] = []
    for number in reversed(range(len(weights))):
        of_weights.insert(0, values[number].T @ error)
        of_offsets.insert(0, error.sum(axis=0))
        error = (error @ weights[number].T) * (values[number] > 0)
    return [*of_weights, *of_offsets]
