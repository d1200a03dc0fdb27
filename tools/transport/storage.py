"""The transport's files in a calibration folder: transport_*.npz (scipy's layout, no pickle), and the factors of far
and blurred light, if any, far_light.npz and blurred_light.npz.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.calibration import RADIANCE, REBUILD, StoredCalibration
from counterlight.errors import InputError
from counterlight.files.reading import Source
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.arrays import ArrayError, Members, opened_archive
from counterlight.tools.transport.blurred import BlurredLight
from counterlight.tools.transport.sparse_files import Shape, read_compressed, read_sparse
from counterlight.tools.transport.transport import CHANNELS, Csr, FarLight, Transport, channels, stacked

FAR_LIGHT, BLURRED_LIGHT = "far_light.npz", "blurred_light.npz"
MOST_CELLS = 1 << 15  # of far light, whose mix is dense
MOST_BLURRED_CELLS = 1 << 28
EXPORT = "save it with scipy.sparse.save_npz"


def write_transport(transport: Transport, folder: Path) -> None:
    """Write the three near matrices (float32 CSR) and, if there is far or blurred light, its factors.

    Raises InputError for numbers that `read_transport` would refuse.
    """
    for name, matrix in zip(CHANNELS, channels(transport.near), strict=True):
        check_entries(matrix.data, f"transport of the {name} channel")
        sparse.save_npz(folder / f"transport_{name}.npz", matrix.astype(np.float32))
    if transport.far is not None:
        _check_far_light(transport.far, "far light")
        _write_far_light(transport.far, folder / FAR_LIGHT)
    if transport.blurred is not None:
        _check_blurred_light(transport.blurred, "blurred light")
        _write_factors(transport.blurred.gather, transport.blurred.scatter, folder / BLURRED_LIGHT)


def read_transport(stored: StoredCalibration) -> Transport:
    """Read a calibration's transport; raises InputError if a file is damaged or does not fit the sizes."""
    calibration = stored.calibration
    shape = calibration.camera.pixels, calibration.projector.pixels
    near = []
    for name in CHANNELS:
        with stored.opened(f"transport_{name}.npz") as file:
            near.append(read_matrix(file, shape, REBUILD))
    far = blurred = None
    if FAR_LIGHT in stored.files:
        with stored.opened(FAR_LIGHT) as file:
            far = _read_far_light(file, shape)
    if BLURRED_LIGHT in stored.files:
        with stored.opened(BLURRED_LIGHT) as file:
            blurred = _read_blurred_light(file, shape)
    stored.refuse_replaced()
    return Transport(stacked(near), far, calibration.camera.shape, calibration.projector.shape, blurred)


def read_matrix(source: Source, shape: Shape, fix: str = EXPORT) -> Csr:
    """Read a scipy.sparse .npz as float32 CSR of `shape`, duplicates summed; never unpickles.

    Raises InputError for a missing file, another layout or shape, NaN or infinity, or indices out of range.
    """
    with opened_archive(source, "no sparse matrix", fix) as arrays:
        claimed = tuple(int(n) for n in arrays["shape"].expect("iu", 2).read())
        if claimed != shape:
            raise InputError(
                f"{arrays.file}: {claimed[0]}x{claimed[1]} entries, expected {shape[0]} camera pixels (rows) x "
                f"{shape[1]} projector pixels (columns); check --camera and --projector, or transpose it"
            )
        matrix = read_sparse(arrays, shape)
        matrix.sum_duplicates()
        check_entries(matrix.data, arrays.file)
        return matrix


def check_entries(values: NDArray[np.floating], where: str) -> None:
    """Raise InputError for entries of T, or of its factors, that are NaN, infinite or beyond the range of radiance."""
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    bad = 0 if np.isfinite([low, high]).all() else int(np.count_nonzero(~np.isfinite(values)))
    if bad:
        raise InputError(f"{where}: {bad} of {values.size} entries are NaN or infinite; repair the measurement")
    if max(-low, high) > RADIANCE[1]:
        raise InputError(
            f"{where}: an entry of {max(-low, high):g}, expected at most {RADIANCE[1]:g}; give light in another unit"
        )


def _write_far_light(far: FarLight, path: Path) -> None:
    _write_factors(far.gather, far.scatter, path, mix=far.mix.astype(np.float32))


def _write_factors(gather: SparseRows, scatter: SparseRows, path: Path, **beside: NDArray[np.float32]) -> None:
    arrays = {**beside, "cells": np.array(scatter.columns)}
    for part, rows in (("gather", gather), ("scatter", scatter)):
        for name, matrix in zip(CHANNELS, channels(rows), strict=True):
            arrays |= {
                f"{part}_{name}_data": matrix.data.astype(np.float32),
                f"{part}_{name}_indices": matrix.indices,
                f"{part}_{name}_indptr": matrix.indptr,
            }
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def _read_far_light(source: Source, shape: Shape) -> FarLight:
    with opened_archive(source, "not the far light of this calibration", REBUILD) as arrays:
        cells = _read_cells(arrays, MOST_CELLS)
        mix = arrays["mix"].expect("fiu", 3, cells, cells).read().astype(np.float64)
        gather, scatter = _read_factors(arrays, cells, shape)
        far = FarLight(gather, mix, scatter)
        _check_far_light(far, arrays.file)
        return far


def _read_blurred_light(source: Source, shape: Shape) -> BlurredLight:
    with opened_archive(source, "not the blurred light of this calibration", REBUILD) as arrays:
        blurred = BlurredLight(*_read_factors(arrays, _read_cells(arrays, MOST_BLURRED_CELLS), shape))
        _check_blurred_light(blurred, arrays.file)
        return blurred


def _read_cells(arrays: Members, most: int) -> int:
    cells = int(arrays["cells"].expect("iu").read())
    if not 1 <= cells <= most:
        raise ArrayError(f"{cells} cells, expected 1 to {most}")
    return cells


def _read_factors(arrays: Members, cells: int, shape: Shape) -> tuple[SparseRows, SparseRows]:
    """Read the gather and scatter that `_write_factors` wrote."""
    camera_pixels, projector_pixels = shape
    gather, scatter = (
        stacked([read_compressed(arrays, size, prefix=f"{part}_{name}_") for name in CHANNELS])
        for part, size in (("gather", (cells, projector_pixels)), ("scatter", (camera_pixels, cells)))
    )
    return gather, scatter


def _check_far_light(far: FarLight, where: str) -> None:
    """Raise InputError for factors, or products of them, that are NaN, infinite or beyond the range of radiance."""
    for values in (far.mix, *far.gather.weights.T, *far.scatter.weights.T):
        check_entries(values, where)
    D, U = _without_signs(far.gather, far.scatter)
    lit = FarLight(D, np.abs(far.mix), U).apply(np.ones((D.columns, len(CHANNELS))))
    check_entries(lit, f"{where}: its factors' product")


def _check_blurred_light(blurred: BlurredLight, where: str) -> None:
    """Raise InputError as `_check_far_light` does."""
    for values in (*blurred.gather.weights.T, *blurred.scatter.weights.T):
        check_entries(values, where)
    P, B = _without_signs(blurred.gather, blurred.scatter)
    lit = BlurredLight(P, B).apply(np.ones((P.columns, len(CHANNELS))))
    check_entries(lit, f"{where}: its factors' product")


def _without_signs(*factors: SparseRows) -> Iterator[SparseRows]:
    return (replace(rows, weights=np.abs(rows.weights)) for rows in factors)
