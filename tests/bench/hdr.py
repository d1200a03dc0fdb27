"""Cost of a radiance map: the thesis' figure 3.4 on this machine, next to OpenCV in the same run.

Prints medians of wall time and of processor time, and ratios; no test depends on them. The input is 13 exposures, one
stop apart, at 1280x1024 in colour, 8 bit, and the mean of 13 shots. Pictures are in memory; results are read back.
"""

import os
import time
from collections.abc import Callable, Iterator

import cv2
import moderngl
import numpy as np

from counterlight.gl.context import headless_context
from counterlight.gl.exposure_sums import GlSums
from counterlight.response import Response
from counterlight.tools.choices import MERGES
from counterlight.tools.hdr.camera_response import exposure_table
from counterlight.tools.hdr.estimators import (
    SLACK,
    USUAL_WEIGHTING,
    CpuSums,
    Estimator,
    ExposureSums,
    make_estimator,
    weight_table,
)
from tests.brackets import codes_of

SHAPE, EXPOSURES = (1024, 1280, 3), 13
WARM_UP, REPEATS = 1, 7
COLUMNS = "scene", "method", "shader", "numpy", "OpenCV", "OpenCV / shader", "differs by (median, 99 % of the values)"
Times = tuple[float, float]


def interleaved(works: dict[str, Callable[[], object]]) -> dict[str, Times]:
    """Returns median wall and processor time of each, ms; runs take turns, so that other load affects all equally."""
    times: dict[str, list[Times]] = {name: [] for name in works}
    for _ in range(WARM_UP + REPEATS):
        for name, work in works.items():
            wall, cpu = time.perf_counter(), time.process_time()
            work()
            times[name].append((1000 * (time.perf_counter() - wall), 1000 * (time.process_time() - cpu)))
    medians = {name: np.median(values[WARM_UP:], axis=0) for name, values in times.items()}
    return {name: (float(wall), float(cpu)) for name, (wall, cpu) in medians.items()}


def merging(
    sums: ExposureSums, estimator: Estimator, codes: list[np.ndarray], times: np.ndarray
) -> Callable[[], np.ndarray]:
    def work() -> np.ndarray:
        for picture, t in zip(codes, times, strict=True):
            sums.add(picture, estimator.coefficients(float(t)), float(t))
        return sums.estimate()

    return work


def opencv(method: str, codes: list[np.ndarray], times: np.ndarray, exposure: np.ndarray) -> Callable[[], np.ndarray]:
    """Returns the same merge by OpenCV. OpenCV has no average: a look-up table and an accumulation replace it."""
    curve = np.maximum(exposure, exposure[1] / 2).astype(np.float32)  # the logarithm of 0 has a weight of 0
    if method == "average":
        return lambda: opencv_mean(codes, curve)
    merge = cv2.createMergeDebevec() if method == "debevec" else cv2.createMergeRobertson()
    return lambda: merge.process(codes, times, curve.reshape(256, 1, 3))


def opencv_mean(codes: list[np.ndarray], curve: np.ndarray) -> np.ndarray:
    total = np.zeros(SHAPE, np.float32)
    for picture in codes:
        cv2.accumulate(cv2.LUT(picture, curve[None]), total)
    return total / np.float32(len(codes))


def agreement(ours: np.ndarray, theirs: np.ndarray, codes: list[np.ndarray]) -> str:
    """Compare pixels with every channel between 10 % and 90 % of the range in some picture."""
    well = np.any([np.all((z > 25) & (z < 230), axis=-1) for z in codes], axis=0)
    error = np.abs(ours[well] / theirs[well] - 1)
    return f"{np.median(error):.0e}, {np.percentile(error, 99):.0e}"


def compare(
    context: moderngl.Context, method: str, codes: list[np.ndarray], times: np.ndarray, exposure: np.ndarray
) -> str:
    """Returns a row of the table: times of the three implementations, and the shader's difference from OpenCV."""
    estimator = make_estimator(method, exposure, weight_table(USUAL_WEIGHTING.get(method, "hat"), 256), margin=0)
    with GlSums(context, estimator.table, SHAPE, estimator.exponential, SLACK) as gl:
        works = {
            "GPU": merging(gl, estimator, codes, times),
            "CPU": merging(CpuSums(estimator, SHAPE), estimator, codes, times),
            "OpenCV": opencv(method, codes, times, exposure),
        }
        medians = interleaved(works)
        apart = "" if method == "average" else agreement(works["GPU"](), works["OpenCV"](), codes)
    took = " | ".join(f"{cpu:.0f} ({wall:.0f})" for wall, cpu in medians.values())
    return f"{took} | {medians['OpenCV'][1] / medians['GPU'][1]:.2f} | {apart}"


def radiance_maps() -> Iterator[str]:
    """13 exposures of 1280x1024: shader, numpy and OpenCV, medians of 7, processor ms (wall ms)."""
    rng = np.random.default_rng(1)
    response = Response("gamma", gamma=2.2)
    exposure = exposure_table(response, 256, 3)
    times = (0.01 * 2.0 ** np.arange(EXPOSURES)).astype(np.float32)
    light = np.exp(rng.normal(0, 1.5, (*SHAPE[:2], 1)))
    scenes = {"neutral": light.repeat(3, axis=2), "coloured": light * np.exp(rng.normal(0, 0.3, SHAPE))}
    with headless_context() as context:
        yield f"{os.cpu_count()} cores, {context.info['GL_RENDERER']}, OpenCV {cv2.__version__}"
        yield f"| {' | '.join(COLUMNS)} |"
        yield "|---" * len(COLUMNS) + "|"
        for name, scene in scenes.items():
            codes = [codes_of(scene, float(t), response) for t in times]
            for method in MERGES:
                yield f"| {name} | {method} | {compare(context, method, codes, times, exposure)} |"


def main() -> None:
    for line in radiance_maps():
        print(line, flush=True)


if __name__ == "__main__":
    main()
