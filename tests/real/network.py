"""A small network that estimates colours from numbers at each pixel, trained on square crops of pictures.

Some numbers describe the neighbourhood of a pixel (`around`), so the network sees patches. The loss is the squared
error minus a share of SSIM (Wang 2004), which keeps detail that the squared error alone would smooth away.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.tools.pairs.geometry import Pictures

REACH = 2  # pixels from the middle of a patch to its edge
WIDE = 2.0, 6.0  # standard deviations of blurs that describe a pixel's surroundings
HIDDEN = 48, 32
GAMMA = 2.2  # colours are light^(1/GAMMA), so that errors in the dark count as the eye sees them
# pixels per side of a crop; crops in memory; crops per step
CROP, CROPS, BATCH = 32, 700, 8
RATE, WARM, DECAY = 2e-3, 50, 2.0  # of Adam; steps until the rate is full; decay of weights relative to the rate
WINDOW, SIGMA = (11, 11), 1.5  # window and standard deviation of SSIM
C1, C2 = 0.01**2, 0.03**2  # constants of SSIM

Numbers = NDArray[np.floating]


@dataclass(frozen=True)
class Example:
    """A picture to train on: the network's numbers, what the network adds to, and the colours that should result."""

    inputs: Numbers
    base: Numbers
    wanted: Numbers


@dataclass(frozen=True)
class Network:
    """A trained network: the weights and the offsets of each layer."""

    layers: Sequence[tuple[Numbers, Numbers]]

    def apply(self, inputs: Numbers, base: Numbers) -> Numbers:
        """Return a picture, (height, width, 3), from its inputs (height, width, numbers) and its base."""
        values = _activations([w for w, _ in self.layers], [b for _, b in self.layers], inputs)[-1]
        return np.asarray(base + values)


def encoded(light: Numbers) -> Numbers:
    return np.asarray(np.clip(light, 0, 1) ** np.float32(1 / GAMMA))


def around(picture: Numbers) -> Numbers:
    """Return what surrounds each pixel, relative to the pixel: (height, width, numbers)."""
    height, width = picture.shape[:2]
    padded = cv2.copyMakeBorder(picture, REACH, REACH, REACH, REACH, cv2.BORDER_REFLECT)
    side = 2 * REACH + 1
    parts = [padded[dy : dy + height, dx : dx + width] - picture for dy in range(side) for dx in range(side)]
    del parts[len(parts) // 2]
    parts += [cv2.GaussianBlur(picture, (0, 0), sigma) - picture for sigma in WIDE]
    return np.concatenate(parts, axis=-1)


def surface(slope: Numbers, offset: Numbers) -> Numbers:
    """Return numbers that describe a surface: its reflectance and its ambient light, both (height, width, 3)."""
    scale = slope.mean()
    return np.asarray(np.concatenate([np.log(np.maximum(slope, 0) / scale + 0.05), 10 * offset / scale], axis=-1))


def trained(examples: Iterable[Example], count: int, *, steps: int, similarity: float = 0.0, seed: int = 0) -> Network:
    """Train a network.

    examples : pictures to train on, of which random crops are kept.
    count : the number of examples.
    steps : steps of Adam.
    similarity : weight of SSIM in the loss.
    """
    rng = np.random.default_rng(seed)
    crops = [crop for example in examples for crop in _crops(example, -(-CROPS // count), rng)]
    first = crops[0]
    sizes = [first.inputs.shape[-1], *HIDDEN, 3]
    weights = [rng.normal(0, np.sqrt(2 / a), (a, b)).astype(np.float32) for a, b in pairwise(sizes)]
    weights[-1] *= np.float32(0.1)
    offsets = [np.zeros(b, np.float32) for b in sizes[1:]]
    parameters = [*weights, *offsets]
    means, squares = ([np.zeros_like(each) for each in parameters] for _ in range(2))
    for number in range(steps):
        chosen = [crops[n] for n in rng.integers(0, len(crops), BATCH)]
        gradients = _gradients(weights, offsets, chosen, similarity)
        rate = RATE * 0.5 * (1 + np.cos(np.pi * number / steps)) * min(1, (number + 1) / WARM)
        corrected = rate * np.sqrt(1 - 0.999 ** (number + 1)) / (1 - 0.9 ** (number + 1))
        for each, gradient, m, v in zip(parameters, gradients, means, squares, strict=True):
            m += 0.1 * (gradient - m)
            v += 0.001 * (gradient**2 - v)
            each -= np.float32(corrected) * m / (np.sqrt(v) + 1e-8)
        for weight in weights:
            weight *= np.float32(1 - rate * DECAY)
    return Network(list(zip(weights, offsets, strict=True)))


def _crops(example: Example, count: int, rng: np.random.Generator) -> list[Example]:
    height, width = example.base.shape[:2]
    result = []
    for _ in range(count):
        y, x = rng.integers(0, max(1, height - CROP + 1)), rng.integers(0, max(1, width - CROP + 1))
        here = slice(y, y + CROP), slice(x, x + CROP)
        parts = (example.inputs[here], example.base[here], example.wanted[here])
        result.append(Example(*(each.astype(np.float32) for each in parts)))
    return result


def _activations(weights: Sequence[Numbers], offsets: Sequence[Numbers], inputs: Numbers) -> list[Numbers]:
    values = [inputs]
    for weight, offset in zip(weights[:-1], offsets[:-1], strict=True):
        values.append(np.maximum(values[-1] @ weight + offset, 0))
    return [*values, values[-1] @ weights[-1] + offsets[-1]]


def _gradients(
    weights: Sequence[Numbers], offsets: Sequence[Numbers], crops: Sequence[Example], similarity: float
) -> list[Numbers]:
    """Return the gradients of the loss: of all weights, then of all offsets."""
    inputs = np.stack([crop.inputs for crop in crops])
    *values, added = _activations(weights, offsets, inputs.reshape(-1, inputs.shape[-1]))
    found = added.reshape(*inputs.shape[:-1], 3) + np.stack([crop.base for crop in crops])
    slopes = []
    for each, crop in zip(found, crops, strict=True):
        slopes.append(2 * (each - crop.wanted))
        if similarity:
            slopes[-1] -= similarity * ssim_slope(each, crop.wanted)
    error: Numbers = np.asarray(np.stack(slopes) / found.size, np.float32).reshape(-1, 3)
    of_weights: list[Numbers] = []
    of_offsets: list[Numbers] = []
    for number in reversed(range(len(weights))):
        of_weights.insert(0, values[number].T @ error)
        of_offsets.insert(0, error.sum(axis=0))
        error = (error @ weights[number].T) * (values[number] > 0)
    return [*of_weights, *of_offsets]


def ssim_slope(found: Pictures, true: Pictures) -> Numbers:
    """Return the derivative of the sum of the SSIM map by each value of `found`, both (height, width, 3)."""
    mean, true_mean = _window(found), _window(true)
    a1 = 2 * mean * true_mean + C1
    a2 = 2 * (_window(found * true) - mean * true_mean) + C2
    b1 = mean**2 + true_mean**2 + C1
    b2 = _window(found**2) - mean**2 + _window(true**2) - true_mean**2 + C2
    similar = a1 * a2 / (b1 * b2)
    by_mean = 2 * true_mean * (a2 - a1) / (b1 * b2) - 2 * mean * similar * (1 / b1 - 1 / b2)
    by_square, by_product = -similar / b2, 2 * a1 / (b1 * b2)
    return np.asarray(_window(by_mean) + 2 * found * _window(by_square) + true * _window(by_product))


def _window(picture: Numbers) -> Numbers:
    return np.asarray(cv2.GaussianBlur(picture, WINDOW, SIGMA, borderType=cv2.BORDER_REFLECT))
