"""Detect a moved camera, projector or scene from two pictures of the floodlit room, apart from their brightness."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.tools.acquisition.plan import Noise

MOST_MOVED, MOST_DIMMED = 0.03, 0.05  # relative change of the floodlit room, and of its brightness alone


def refuse_moved(before: FloatArray, after: FloatArray, noise: Noise, captures: float, advice: str) -> None:
    """Raises InputError if the floodlit room changes by more than noise explains, or changes its brightness.

    before, after : (pixels, 3). Light above black.
    captures : Σ 1/n over the two pictures, each the mean of n captures.
    advice : what to do; follows a semicolon in the message.
    """
    gain = float(np.sum(before * after) / np.sum(before * before))
    change = float(np.sqrt(np.sum((after - gain * before) ** 2) / np.sum(before**2)))
    by_noise = float(np.sqrt(captures * np.sum(noise.sigma(before) ** 2) / np.sum(before**2)))
    if change > MOST_MOVED + 2 * by_noise:
        raise InputError(
            f"the floodlit room now differs by {100 * change:.1f} % from what it was at first (noise alone: "
            f"{100 * by_noise:.1f} %): camera, projector or scene moved; {advice}"
        )
    if abs(gain - 1) > MOST_DIMMED:
        raise InputError(
            f"the floodlit room is now {100 * gain:.0f} % as bright as at first: lamp or exposure changed; let "
            f"the lamp warm up, lock the exposure; {advice}"
        )
