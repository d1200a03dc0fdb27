"""A camera's sensor: electrons, their noise, and code values."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.rig.rays import FloatArray

STORED_BITS = 16
MOST_SIGMAS = 2.0  # largest deviation of a wandering gain, standard deviations


@dataclass(frozen=True)
class Sensor:
    """A linear sensor.

    full_well : electrons at full scale; 0 is a sensor without noise.
    read_noise : electrons.
    wander : standard deviation of the gain of a capture's channel, as of an automatic white balance.
    """

    bits: int = 14
    full_well: float = 20000.0
    read_noise: float = 5.0
    wander: float = 0.0

    def codes(self, radiance: FloatArray, weakness: FloatArray, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Returns stored codes (…, 3) of radiance relative to full scale, in the upper bits of 16.

        weakness : (3,). Gain of each channel; a channel with gain g has g times fewer electrons for the same code.
        """
        seen = np.asarray(radiance, np.float64)
        if self.wander:
            seen = seen * (1 + self.wander * np.clip(rng.normal(size=3), -MOST_SIGMAS, MOST_SIGMAS))
        if self.full_well:
            electrons = seen * self.full_well / weakness
            noisy = rng.poisson(np.maximum(electrons, 0)) + rng.normal(0, self.read_noise, seen.shape)
            seen = noisy * weakness / self.full_well
        top = (1 << self.bits) - 1
        levels = np.clip(np.rint(seen * top), 0, top).astype(np.uint32)
        return np.asarray(levels * ((1 << STORED_BITS) - 1) // top, np.uint16)
