"""Cost of the row-map product by size: python -m tests.studies.scaling for docs/gpu.md and docs/scaling.png.

The fragment path is measured at four sizes and four row lengths; a row is a square of entries around each pixel's
place. On llvmpipe, milliseconds are processor time over all cores, which other load on the machine hardly changes.
"""

import os
from pathlib import Path

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.gl.context import headless_context
from counterlight.gl.gpu_maps import MapTextures
from counterlight.gl.passes import picture_texture
from tests.bench.frames import CAMERA, PROJECTOR, clock_of, local_map

PLOT = Path(__file__).resolve().parents[2] / "docs" / "scaling.png"
SCALES, SIDES = (1, 2, 3, 4), (2, 4, 6, 8)  # multiples of half the benchmark's sides; side of a row's square of entries
REPEATS = 15


def sizes() -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Returns (projector, camera), (height, width) each."""
    half = [(side[0] // 2, side[1] // 2) for side in (PROJECTOR, CAMERA)]
    return [((k * half[0][0], k * half[0][1]), (k * half[1][0], k * half[1][1])) for k in SCALES]


def measured(context: moderngl.Context) -> NDArray[np.float64]:
    """Returns milliseconds, (size, row length): the fastest of REPEATS."""
    rng = np.random.default_rng(1)
    clock = clock_of(context)
    found = np.empty((len(SCALES), len(SIDES)))
    for i, (output, source) in enumerate(sizes()):
        picture = picture_texture(context, rng.uniform(size=(*source, 3)).astype(np.float32))
        for j, side in enumerate(SIDES):
            textures = MapTextures(context, local_map(output, source, side, rng))
            product, fastest = textures.product("CLAMP"), np.inf
            for _ in range(REPEATS):
                begin = clock()
                product.run(picture)
                context.finish()
                fastest = min(fastest, clock() - begin)
            found[i, j] = 1000 * fastest
            product.release()
            textures.release()
        picture.release()
    return found


def line(milliseconds: NDArray[np.float64]) -> tuple[float, float, float]:
    """Returns nanoseconds per pixel and per entry, by least relative squares, and the largest relative error."""
    pixels = np.array([[projector[0] * projector[1]] * len(SIDES) for projector, _ in sizes()], float)
    terms = np.stack([pixels, pixels * np.square(SIDES)], axis=-1) / milliseconds[..., None]
    solution = np.linalg.lstsq(terms.reshape(-1, 2), np.ones(milliseconds.size), rcond=None)[0]
    return float(1e6 * solution[0]), float(1e6 * solution[1]), float(np.abs(terms @ solution - 1).max())


def draw(milliseconds: NDArray[np.float64]) -> None:
    """Draw milliseconds over the entries of a row, a line per size, and over the pixels, a line per row length."""
    from matplotlib import pyplot

    entries = np.square(SIDES)
    pixels = np.array([projector[0] * projector[1] / 1e6 for projector, _ in sizes()])
    figure, panels = pyplot.subplots(1, 2, figsize=(10, 4), sharey=True)
    for (projector, _), row in zip(sizes(), milliseconds, strict=True):
        panels[0].plot(entries, row, "o-", label=f"{projector[1]}x{projector[0]}")
    for count, column in zip(entries, milliseconds.T, strict=True):
        panels[1].plot(pixels, column, "o-", label=f"{count} entries")
    for panel, name in zip(panels, ("entries a pixel", "projector pixels, millions"), strict=True):
        panel.set_xlabel(name)
        panel.set_xlim(0)
        panel.set_ylim(0)
        panel.grid(alpha=0.3)
        panel.legend()
    panels[0].set_ylabel("milliseconds")
    figure.tight_layout()
    figure.savefig(PLOT, dpi=90)


def main() -> None:
    with headless_context() as context:
        print(f"{os.cpu_count()} cores, {context.info['GL_RENDERER']}")
        milliseconds = measured(context)
    print(f"| projector | {' | '.join(f'{side**2} entries' for side in SIDES)} |")
    print("|---" * (len(SIDES) + 1) + "|")
    for (projector, _), row in zip(sizes(), milliseconds, strict=True):
        print(f"| {projector[1]}x{projector[0]} | {' | '.join(f'{value:.3g} ms' for value in row)} |")
    pixel, entry, error = line(milliseconds)
    print(f"\n{pixel:.3g} ns a pixel and {entry:.3g} ns an entry, within {error:.0%}")
    draw(milliseconds)


if __name__ == "__main__":
    main()
