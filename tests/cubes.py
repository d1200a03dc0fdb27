"""Colour tables for tests: a bent identity with noise, which makes every sample and every axis differ."""

from pathlib import Path

import numpy as np

UNIT = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


def write_cube(
    path: Path, rng: np.random.Generator, size: int, domain: tuple[tuple[float, ...], tuple[float, ...]] = UNIT
) -> Path:
    """Write a .cube file, in which red changes fastest."""
    axis = np.linspace(0, 1, size)
    blue, green, red = np.meshgrid(axis, axis, axis, indexing="ij")
    colours = np.stack([red**1.5, 0.9 * green + 0.1 * red, blue**0.7], axis=-1) + rng.normal(
        0, 0.02, (size,) * 3 + (3,)
    )
    ends = [f"DOMAIN_{name} {' '.join(map(str, codes))}" for name, codes in zip(("MIN", "MAX"), domain, strict=True)]
    rows = [" ".join(f"{value:.6f}" for value in row) for row in colours.reshape(-1, 3)]
    path.write_text("\n".join(['TITLE "a look"', f"LUT_3D_SIZE {size}", *ends, *rows]) + "\n")
    return path
