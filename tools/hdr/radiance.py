"""Merge pictures of one scene at several exposure times to a radiance map (thesis 3.3.1)."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.choices import MERGES
from counterlight.tools.hdr.camera_response import exposure_table
from counterlight.tools.hdr.estimators import (
    USUAL_WEIGHTING,
    WEIGHTINGS,
    Estimator,
    ExposureSums,
    make_estimator,
    summing,
    weight_table,
)

LEAST_MEASURED = 1e-3  # share of all values; with less, the exposures are far too long or too short
Shot = tuple[NDArray[Any], float]


@dataclass(frozen=True)
class MergeOptions:
    """Options of merging.

    method : one of MERGES.
    weighting : one of WEIGHTINGS; None for the method's default.
    gpu : whether to merge in OpenGL.
    """

    method: str = "debevec"
    weighting: str | None = None
    gpu: bool = False

    def __post_init__(self) -> None:
        if self.method not in MERGES:
            raise InputError(f"--method {self.method}: expected {', '.join(MERGES)}")
        if self.weighting is not None and self.method == "average":
            raise InputError(f"--weighting {self.weighting}: --method average weighs all shots alike; leave one out")
        if self.weighting is not None and self.weighting not in WEIGHTINGS:
            raise InputError(f"--weighting {self.weighting}: expected {', '.join(WEIGHTINGS)}")

    @property
    def weights(self) -> str:
        """The weighting in use; `average` ignores it."""
        return self.weighting or USUAL_WEIGHTING.get(self.method, "hat")


@dataclass(frozen=True)
class RadianceMap:
    """The light of a scene, measured by a bracket.

    radiance : (height, width, channels) float32. 1 is the light that reaches the highest code in one second.
    saturated : (height, width, channels) bool. Clipped in every picture that is not black: radiance is a lower bound.
    black : (height, width, channels) bool. Black in every picture; the radiance is 0.
    """

    radiance: NDArray[np.float32]
    saturated: NDArray[np.bool_]
    black: NDArray[np.bool_]


def merge(shots: Iterable[Shot], response: Response, options: MergeOptions) -> RadianceMap:
    """Merge pictures that arrive one at a time, so that memory does not grow with their number.

    shots : code values (height, width, 1 or 3), all uint8 or all uint16, with their exposure times in seconds.

    Raises InputError if almost nothing is well exposed.
    """
    remaining = iter(shots)
    codes, exposure_s = next(remaining)
    levels = int(np.iinfo(codes.dtype).max) + 1
    exposure = exposure_table(response, levels, codes.shape[2])
    estimator = make_estimator(options.method, exposure, weight_table(options.weights, levels))
    with summing(estimator, codes.shape, gpu=options.gpu) as sums:
        _add(sums, estimator, codes, exposure_s)
        for codes, exposure_s in remaining:
            _add(sums, estimator, codes, exposure_s)
        estimate = sums.estimate()
    merged = RadianceMap(np.abs(estimate), estimate < 0, estimate == 0)
    _check_measured(merged)
    return merged


def _add(sums: ExposureSums, estimator: Estimator, codes: NDArray[Any], exposure_s: float) -> None:
    sums.add(codes, estimator.coefficients(exposure_s), exposure_s)


def _check_measured(merged: RadianceMap) -> None:
    saturated, black = float(merged.saturated.mean()), float(merged.black.mean())
    if 1 - saturated - black >= LEAST_MEASURED:
        return
    if saturated >= black:
        raise InputError(
            f"{saturated:.1%} of the values are saturated even in the shortest exposure that is not black; take "
            "shorter exposures, or close the aperture"
        )
    raise InputError(
        f"{black:.1%} of the values are black even in the longest exposure; take longer ones, open the aperture, or "
        "check that the lens cap is off"
    )
