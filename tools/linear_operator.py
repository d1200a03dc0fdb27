"""T as a scipy LinearOperator, for scipy's solvers (lsqr, lsmr, svds, eigsh) and for `T @ picture`.

Pixel order: a vector is a flattened picture, `picture.ravel()`. All channels: index = 3 (x + y · width) + channel.
One channel: index = x + y · width. Row 0 is at the top.
"""

from abc import abstractmethod
from functools import cached_property, reduce
from typing import Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.memory import check
from counterlight.tools import arguments
from counterlight.tools.transport.transport import CHANNELS, Csr, Transport, channel, channels, in_one

BYTES_PER_ENTRY = 150  # three channels while they are written out: rows, their union, the copies, the result


class _PictureOperator(LinearOperator):
    """A real linear operator from pictures to pictures, or from flattened pictures to flattened pictures.

    source, target : shapes of the pictures: (height, width, 3), or (height, width) for one channel.
    """

    def __init__(self, parts: Transport, *channel_axis: int) -> None:
        if parts.camera is None or parts.projector is None:
            raise InputError("T of unknown picture sizes; give camera and projector as (height, width)")
        self.parts = parts
        self.source, self.target = (*parts.projector, *channel_axis), (*parts.camera, *channel_axis)
        super().__init__(np.float64, (int(np.prod(self.target)), int(np.prod(self.source))))  # type: ignore[call-arg]

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.shape}: from pictures {self.source} to {self.target}>"

    def dot(self, x: Any) -> Any:
        """Return T x of a picture, a vector (pixels,) or columns (pixels, k): linear floating-point light.

        Another operator gives the product of operators, and a number gives a scaled operator.
        """
        if isinstance(x, LinearOperator) or np.isscalar(x):
            return super().dot(x)  # type: ignore[arg-type]
        light = arguments.real_array(x, "light")
        if light.dtype.kind in "iu":
            raise InputError(f"light as {light.dtype}, expected linear light in floating point; convert it first")
        light = light.astype(np.float64, copy=False)  # compiled products take no float16 and no other byte order
        if light.ndim in (1, 2) and light.shape[0] == self.shape[1]:
            return super().dot(light)
        if light.shape != self.source:
            swapped = light.shape == (self.source[1], self.source[0], *self.source[2:])
            likely = "width and height are swapped" if swapped else f"or a flattened picture ({self.shape[1]},)"
            raise InputError(f"light of shape {light.shape}, expected {self.source}; {likely}")
        return self.matvec(light.ravel()).reshape(self.target)

    @overload  # type: ignore[override]
    def __matmul__(self, x: LinearOperator) -> LinearOperator: ...
    @overload
    def __matmul__(self, x: ArrayLike) -> FloatArray: ...
    def __matmul__(self, x: Any) -> Any:
        return super().__matmul__(x)

    @abstractmethod
    def _transpose(self) -> Self: ...

    def _adjoint(self) -> Self:
        return self._transpose()

    @cached_property
    def T(self) -> Self:  # type: ignore[override]  # noqa: N802 - as numpy calls it
        """Tᵀ: camera pictures to projector pictures, the dual picture (thesis eq. 3.12)."""
        return self._transpose()


class TransportOperator(_PictureOperator):
    """T of all three channels: camera picture = T @ projector picture, without ambient light.

    parts : near light, and blurred and far light if any.
    """

    def __init__(self, parts: Transport) -> None:
        super().__init__(parts, len(CHANNELS))

    def channel(self, k: int) -> "ChannelOperator":
        """Return T of channel k: 0 red, 1 green, 2 blue."""
        return ChannelOperator(self.parts, arguments.whole(k, "channel", 0, len(CHANNELS) - 1))

    def to_csr(self) -> Csr:
        """Return T as one sparse matrix, (3 camera pixels, 3 projector pixels), float32.

        Raises InputError if the matrix does not fit into memory.
        """
        red, green, blue = (
            sparse.kron(T, np.diag(place), "csr")
            for T, place in zip(_written_out(self.parts), np.eye(3, dtype=np.float32), strict=True)
        )
        T: Csr = Csr(red + green + blue)
        return T

    def _matvec(self, x: FloatArray) -> FloatArray:
        return self.parts.apply(np.reshape(x, (-1, len(CHANNELS)))).ravel()

    def _transpose(self) -> "TransportOperator":
        return TransportOperator(self.parts.T)


class ChannelOperator(_PictureOperator):
    """T of one channel: camera picture (height, width) = T @ projector picture (height, width)."""

    def __init__(self, parts: Transport, k: int) -> None:
        super().__init__(parts)
        self.k = k

    def to_csr(self) -> Csr:
        """Return T as a sparse matrix, (camera pixels, projector pixels), float32.

        Raises InputError if the matrix does not fit into memory.
        """
        return _written_out(self.parts)[self.k]

    @cached_property
    def _products(self) -> list[list[Csr | FloatArray]]:
        """The factors of S, B P and U M D, the last factor first."""
        products: list[list[Csr | FloatArray]] = [[channel(self.parts.near, self.k)]]
        for chain in self.parts.chains:
            mix = [] if chain.mix is None else [chain.mix.matrices[self.k]]
            products.append([channel(chain.gather, self.k), *mix, channel(chain.scatter, self.k)])
        return products

    def _matvec(self, x: FloatArray) -> FloatArray:
        return np.asarray(reduce(np.add, (reduce(_times, factors, x) for factors in self._products)))

    def _matmat(self, X: FloatArray) -> FloatArray:
        return self._matvec(X)

    def _transpose(self) -> "ChannelOperator":
        return ChannelOperator(self.parts.T, self.k)


def _times(light: FloatArray, A: Csr | FloatArray) -> FloatArray:
    return np.asarray(A @ light)


def _written_out(parts: Transport) -> tuple[Csr, ...]:
    """Return T of three channels by entries; InputError if they do not fit into memory."""
    entries, (rows, columns) = float(parts.near.indices.size), parts.shape
    if parts.blurred is not None:
        entries += parts.blurred.gather.lengths[parts.blurred.scatter.indices].sum()
    entries = float(rows * columns) if parts.far is not None else min(entries, rows * columns)
    what = f"T of {rows}x{columns} pixels as a sparse matrix, {entries / 1e6:.3g} million entries per channel,"
    check(BYTES_PER_ENTRY * entries, what, "pass T itself to scipy's solvers, or use a smaller camera or projector")
    return channels(in_one(parts))
