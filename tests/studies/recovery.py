"""Recovery of a camera's response from brackets: python -m tests.studies.recovery (docs/hdr.md).

The data are simulated: 8000 pixels, 1 % noise, 8 bit. The figure is the standard deviation of ln f⁻¹ / truth over codes
16 to 249, by the camera's curve; tests/test_hdr.py bounds the same figure.
"""

import numpy as np

from counterlight.response import Response
from counterlight.tools.hdr.camera_response import exposure_table
from counterlight.tools.hdr.recovery import recover_response
from tests.brackets import CURVES, codes_of

BRACKETS = ((13, 1), (5, 2), (3, 3))  # number of exposures, and stops between them
METHODS = ("debevec", "robertson")
COLUMNS = ("exposures, stops apart", "method", *CURVES)
PIXELS, NOISE = 8000, 0.01
INSIDE = slice(16, 250)


def samples_of(
    rng: np.random.Generator, response: Response, times: list[float], pixels: int, noise: float
) -> np.ndarray:
    """Returns samples (pictures, pixels, 1), 0..1, of a camera with noise of `noise` relative to the light."""
    light = 10 ** rng.uniform(-3, 0.5, (pixels, 1, 1))
    shots = [codes_of(light * (1 + rng.normal(0, noise, light.shape)), t, response) for t in times]
    return np.stack(shots)[:, :, 0] / 255


def recovered(rng: np.random.Generator, name: str, method: str, pictures: int, stops: int) -> np.ndarray:
    """Returns the recovered f⁻¹ relative to the truth, for codes INSIDE.

    name : one of CURVES.
    """
    times = [2.0 ** (stops * (i - pictures // 2)) for i in range(pictures)]
    samples = samples_of(rng, CURVES[name], times, PIXELS, NOISE)
    found = exposure_table(recover_response(samples, np.array(times), method), 256, 1)[:, 0]
    truth = exposure_table(CURVES[name], 256, 1)[:, 0]
    return np.asarray(found[INSIDE] / truth[INSIDE])


def main() -> None:
    print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|")
    for pictures, stops in BRACKETS:
        for method in METHODS:
            ratios = (recovered(np.random.default_rng(2006), name, method, pictures, stops) for name in CURVES)
            spread = " | ".join(f"{100 * np.std(np.log(ratio)):.1f} %" for ratio in ratios)
            print(f"| {pictures}, {stops} | {method} | {spread} |", flush=True)


if __name__ == "__main__":
    main()
