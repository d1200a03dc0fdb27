"""The transport's files in a calibration folder: transport_*.npz (scipy's layout, no pickle), and the factors of far
and blurred light, if any, far_light.npz and blurred_light.npz.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.calibration import RADIANCE, REBUILD, StoredCalibration
from counterlight.errors import InputError, shown
from counterlight.files.reading import Source
from counterlight.maps.chain import Chain
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.arrays import CODES, NOT_LIGHT, ArrayError, Members, opened_archive
from counterlight.tools.transport.sparse_files import Shape, read_compressed, read_sparse
from counterlight.tools.transport.transport import (
    CHANNELS,
    Csr,
    Dense,
    Factor,
    LightChain,
    Transport,
    channels,
    stacked,
)

Mix = TypeVar("Mix", bound=Dense | None)
FAR, BLURRED = "far light", "blurred light"
MOST_CELLS = 1 << 15  # limit for far light, whose mix is dense
MOST_BLURRED_CELLS = 1 << 28
EXPORT = "save it with scipy.sparse.save_npz(FILE, scipy.sparse.csr_array(T))"


def write_transport(transport: Transport, folder: Path) -> None:
    """Write the three near matrices (float32 CSR) and, if there is far or blurred light, its factors.

    Raises InputError for numbers that `read_transport` would refuse.
    """
    for name, matrix in zip(CHANNELS, channels(transport.near), strict=True):
        check_entries(matrix.data, f"transport of the {name} channel")
        sparse.save_npz(folder / f"transport_{name}.npz", matrix.astype(np.float32))
    chains: dict[str, LightChain | None] = {FAR: transport.far, BLURRED: transport.blurred}
    for what, chain in chains.items():
        if chain is not None:
            _check_chain(chain, what)
            _write_chain(chain, folder / file_of(what))


def file_of(what: str) -> str:
    """Return the file of a chain: far_light.npz of "far light"."""
    return f"{what.replace(' ', '_')}.npz"


def read_transport(stored: StoredCalibration) -> Transport:
    """Read a calibration's transport; raises InputError if a file is damaged or does not fit the sizes."""
    calibration = stored.calibration
    shape = calibration.camera.pixels, calibration.projector.pixels
    near = []
    for name in CHANNELS:
        with stored.opened(f"transport_{name}.npz") as file:
            near.append(read_matrix(file, shape, REBUILD))
    far = _read_chain(stored, FAR, shape, MOST_CELLS, _read_mix)
    blurred = _read_chain(stored, BLURRED, shape, MOST_BLURRED_CELLS, lambda *_: None)
    stored.refuse_replaced()
    return Transport(stacked(near), far, calibration.camera.shape, calibration.projector.shape, blurred)


def read_matrix(source: Source, shape: Shape, fix: str = EXPORT) -> Csr:
    """Read a scipy.sparse .npz as float32 CSR of `shape`, duplicates summed; never unpickles.

    Raises InputError for a missing file, another layout or shape, NaN or infinity, or indices out of range.
    """
    with opened_archive(source, "no sparse matrix", fix) as arrays:
        if "shape" not in arrays:
            raise ArrayError(f"it holds arrays of numpy.savez: {', '.join(map(shown, arrays)) or 'none'}")
        check_shape(tuple(int(n) for n in arrays["shape"].expect("iu", 2).read()), shape, arrays.file)
        if (codes := arrays["data"].dtype).newbyteorder("=") in CODES:
            raise InputError(f"{arrays.file}: entries of {codes}; {NOT_LIGHT}")
        matrix = read_sparse(arrays, shape)
        matrix.sum_duplicates()
        check_entries(matrix.data, arrays.file)
        return matrix


def check_shape(found: tuple[int, ...], expected: Shape, where: str) -> None:
    """Raise InputError for a T of another shape."""
    if found != expected:
        size = "x".join(map(str, found))
        raise InputError(
            f"{where}: {size} entries, expected {expected[0]} camera pixels (rows) x {expected[1]} projector pixels "
            "(columns); check --camera and --projector, or transpose it"
        )


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


def _write_chain(chain: LightChain, path: Path) -> None:
    arrays: dict[str, NDArray[np.number]] = {}
    if chain.mix is not None:
        arrays["mix"] = chain.mix.matrices.astype(np.float32)
    arrays["cells"] = np.array(chain.scatter.columns)
    for part, rows in (("gather", chain.gather), ("scatter", chain.scatter)):
        for name, matrix in zip(CHANNELS, channels(rows), strict=True):
            arrays |= {
                f"{part}_{name}_data": matrix.data.astype(np.float32),
                f"{part}_{name}_indices": matrix.indices,
                f"{part}_{name}_indptr": matrix.indptr,
            }
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def _read_chain(
    stored: StoredCalibration, what: str, shape: Shape, most: int, mix_of: Callable[[Members, int], Mix]
) -> Chain[SparseRows, Mix] | None:
    """Read the chain that `_write_chain` wrote; None if there is no such file. most : number of cells."""
    if file_of(what) not in stored.files:
        return None
    with (
        stored.opened(file_of(what)) as file,
        opened_archive(file, f"not the {what} of this calibration", REBUILD) as arrays,
    ):
        cells = int(arrays["cells"].expect("iu").read())
        if not 1 <= cells <= most:
            raise ArrayError(f"{cells} cells, expected 1 to {most}")
        mix = mix_of(arrays, cells)
        gather, scatter = (
            stacked([read_compressed(arrays, size, prefix=f"{part}_{name}_") for name in CHANNELS])
            for part, size in (("gather", (cells, shape[1])), ("scatter", (shape[0], cells)))
        )
        chain = Chain(gather, mix, scatter)
        _check_chain(chain, arrays.file)
        return chain


def _read_mix(arrays: Members, cells: int) -> Dense:
    return Dense(arrays["mix"].expect("fiu", 3, cells, cells).read().astype(np.float64))


def _check_chain(chain: Chain[Factor, Factor | None], where: str) -> None:
    """Raise InputError for factors, or products of them, that are NaN, infinite or beyond the range of radiance."""
    for factor in chain.factors:
        for values in [factor.matrices] if isinstance(factor, Dense) else factor.weights.T:
            check_entries(values, where)
    lit = chain.each(_without_signs).apply(np.ones((chain.gather.shape[1], len(CHANNELS))))
    check_entries(lit, f"{where}: its factors' product")


def _without_signs(factor: Factor) -> Factor:
    if isinstance(factor, Dense):
        return Dense(np.abs(factor.matrices))
    return replace(factor, weights=np.abs(factor.weights))
