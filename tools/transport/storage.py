"""The transport's files in a calibration folder: transport_*.npz (scipy's layout, no pickle) and far_light.npz."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.calibration import RADIANCE, REBUILD, StoredCalibration
from counterlight.errors import InputError
from counterlight.files.reading import Source
from counterlight.tools.transport.arrays import ArrayError, opened_archive
from counterlight.tools.transport.sparse_files import Shape, read_compressed, read_sparse
from counterlight.tools.transport.transport import CHANNELS, Csr, FarLight, Transport, channels, stacked

FAR_LIGHT = "far_light.npz"
MOST_CELLS = 1 << 15
EXPORT = "save it with scipy.sparse.save_npz"


def write_transport(transport: Transport, folder: Path) -> None:
    """Write the three near matrices (float32 CSR) and, if there is far light, its factors.

    Raises InputError for numbers that `read_transport` would refuse.
    """
    for name, matrix in zip(CHANNELS, channels(transport.near), strict=True):
        check_entries(matrix.data, f"transport of the {name} channel")
        sparse.save_npz(folder / f"transport_{name}.npz", matrix.astype(np.float32))
    if transport.far is not None:
        _check_far_light(transport.far, "far light")
        _write_far_light(transport.far, folder / FAR_LIGHT)


def read_transport(stored: StoredCalibration) -> Transport:
    """Read a calibration's transport; InputError when a file is damaged or does not fit the calibration's sizes."""
    calibration = stored.calibration
    shape = calibration.camera.pixels, calibration.projector.pixels
    near = []
    for name in CHANNELS:
        with stored.opened(f"transport_{name}.npz") as file:
            near.append(read_matrix(file, shape, REBUILD))
    far = None
    if FAR_LIGHT in stored.files:
        with stored.opened(FAR_LIGHT) as file:
            far = _read_far_light(file, shape)
    stored.refuse_replaced()
    return Transport(stacked(near), far, calibration.camera.shape, calibration.projector.shape)


def read_matrix(source: Source, shape: Shape, fix: str = EXPORT) -> Csr:
    """Read a scipy.sparse .npz as float32 CSR of `shape`, duplicates summed; never unpickles.

    Raises InputError for no such file, another layout, another shape, numbers that are no light (NaN, infinity), or
    indices out of range.
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
    """InputError for entries of T, or of its factors, that are no light in any unit."""
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    bad = 0 if np.isfinite([low, high]).all() else int(np.count_nonzero(~np.isfinite(values)))
    if bad:
        raise InputError(f"{where}: {bad} of {values.size} entries are NaN or infinite; repair the measurement")
    if max(-low, high) > RADIANCE[1]:
        raise InputError(
            f"{where}: an entry of {max(-low, high):g}, expected at most {RADIANCE[1]:g}; give light in another unit"
        )


def _write_far_light(far: FarLight, path: Path) -> None:
    arrays = {"mix": far.mix.astype(np.float32), "cells": np.array(far.mix.shape[1])}
    for part, rows in (("gather", far.gather), ("scatter", far.scatter)):
        for name, matrix in zip(CHANNELS, channels(rows), strict=True):
            arrays |= {
                f"{part}_{name}_data": matrix.data.astype(np.float32),
                f"{part}_{name}_indices": matrix.indices,
                f"{part}_{name}_indptr": matrix.indptr,
            }
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def _read_far_light(source: Source, shape: Shape) -> FarLight:
    camera_pixels, projector_pixels = shape
    with opened_archive(source, "not the far light of this calibration", REBUILD) as arrays:
        cells = int(arrays["cells"].expect("iu").read())
        if not 1 <= cells <= MOST_CELLS:
            raise ArrayError(f"{cells} cells, expected 1 to {MOST_CELLS}")
        mix = arrays["mix"].expect("fiu", 3, cells, cells).read().astype(np.float64)
        gather, scatter = (
            stacked([read_compressed(arrays, size, prefix=f"{part}_{name}_") for name in CHANNELS])
            for part, size in (("gather", (cells, projector_pixels)), ("scatter", (camera_pixels, cells)))
        )
        far = FarLight(gather, mix, scatter)
        _check_far_light(far, arrays.file)
        return far


def _check_far_light(far: FarLight, where: str) -> None:
    """InputError for factors, or products of them, that are no light in any unit."""
    for values in (far.mix, *far.gather.weights.T, *far.scatter.weights.T):
        check_entries(values, where)
    D, U = (replace(rows, weights=np.abs(rows.weights)) for rows in (far.gather, far.scatter))
    lit = FarLight(D, np.abs(far.mix), U).apply(np.ones((D.columns, len(CHANNELS))))
    check_entries(lit, f"{where}: its factors' product")
