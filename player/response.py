"""Transfer curves: how code values become light, for projectors and for pictures.

A *response* maps a code value (0..1, what goes over the cable) to linear drive (0..1). Shaders use tables only, so that
an analytic curve and a measured one take the same path; player/pipeline/reference.py reads the same tables.
"""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeAlias, TypeGuard

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError, shown
from counterlight.files.reading import read_toml
from counterlight.files.tables import Table

TABLE_SIZE = 1024
FIX = "a response file holds: response = [[0, 0, 0], …, [1, 1, 1]], as in a calibration.toml"
MOST_ROWS = 1 << 16  # of a measured table: one for each code of a 16-bit camera
_SRGB_KNEE = 0.04045
Matrix: TypeAlias = tuple[tuple[float, ...], ...]  # rows


@dataclass(frozen=True)
class Response:
    """A monotone curve per channel, code value -> linear light, both 0..1.

    kind : "linear", "srgb", "gamma" (with `gamma`) or "table" (with `table`: (samples, 1 or 3), equally spaced codes).
    Raises InputError when the curve cannot be inverted: gamma out of 0.1..10, a table that falls or stays within 0..1.
    """

    kind: str
    gamma: float = 1.0
    table: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in ("linear", "srgb", "gamma", "table"):
            raise InputError(f"response {self.kind!r}: expected linear, srgb, a gamma such as 2.2, or a table")
        if self.kind == "gamma" and not 0.1 <= self.gamma <= 10:
            raise InputError(f"response: gamma {self.gamma}, expected 0.1 to 10")
        if self.kind == "table":
            _check_table(self.table)

    def to_linear(self, codes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Linear light of code values; the last axis is the channel."""
        if self.kind == "table":
            table = np.array(self.table, np.float64)
            grid = np.linspace(0, 1, len(table))
            return np.stack([np.interp(codes[..., i], grid, table[:, i % table.shape[1]]) for i in range(3)], axis=-1)
        return _analytic(self.kind, self.gamma, codes)

    def inverse_table(self) -> NDArray[np.float32]:
        """Code values for linear light at light = (i / (n − 1))², i = 0 … n − 1: (n, 3).

        Equal steps of √light follow the curves' steepness near black: for sRGB and gammas up to 2.4, linear
        interpolation in the table is off by less than a tenth of an 8-bit code value.
        """
        light = np.linspace(0, 1, TABLE_SIZE) ** 2
        if self.kind != "table":
            codes = _analytic_inverse(self.kind, self.gamma, light)
            return np.repeat(codes[:, None], 3, axis=1).astype(np.float32)
        table = np.array(self.table, np.float64)
        grid = np.linspace(0, 1, len(table))
        columns = (table[:, i % table.shape[1]] for i in range(3))
        return np.stack([np.interp(light, column, grid) for column in columns], axis=-1).astype(np.float32)

    def over(self, width: int) -> "RasterResponse":
        """The same in every column of a raster."""
        return RasterResponse((self,), (width,))

    def to_toml(self) -> object:
        """What calibration.toml holds: a name, a gamma or a table."""
        return {"gamma": self.gamma, "table": [list(row) for row in self.table]}.get(self.kind, self.kind)


@dataclass(frozen=True)
class RasterResponse:
    """The responses of projectors side by side in one raster, and their colour matrices if they have any.

    responses : of each, from the left.  widths : columns of the raster that are its own.
    colours : D of each, (3, 3): of a drive q of primaries that all projectors share, it shows D q of its own; None for
    q itself. Empty if none has one.
    """

    responses: tuple[Response, ...]
    widths: tuple[int, ...]
    colours: tuple[Matrix | None, ...] = ()

    @cached_property
    def of_column(self) -> NDArray[np.int32]:
        """Which of the distinct projectors each column of the raster is of, (width,)."""
        return np.repeat([self._distinct.index(each) for each in self._each], self.widths).astype(np.int32)

    def to_linear(self, codes: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Linear drive of a raster's 8-bit code values, (height, width, 3), of the shared primaries."""
        drive = self._light[self.of_column[:, None], codes, np.arange(3)]
        if self.matrices is None:
            return np.asarray(drive)
        inverse = np.linalg.inv(self.matrices.astype(np.float64))
        return np.asarray(np.einsum("xkl,yxl->yxk", inverse[self.of_column], drive))

    def inverse_tables(self) -> NDArray[np.float32]:
        """`Response.inverse_table` of each distinct projector: (projectors, samples, 3)."""
        return np.stack([response.inverse_table() for response, _ in self._distinct])

    @cached_property
    def matrices(self) -> NDArray[np.float32] | None:
        """D of each distinct projector, (projectors, 3, 3); None if none has one."""
        if not any(self.colours):
            return None
        return np.array([np.eye(3) if colour is None else colour for _, colour in self._distinct], np.float32)

    @cached_property
    def _each(self) -> list[tuple[Response, Matrix | None]]:
        return list(zip(self.responses, self.colours or (None,) * len(self.responses), strict=True))

    @cached_property
    def _distinct(self) -> list[tuple[Response, Matrix | None]]:
        return list(dict.fromkeys(self._each))

    @cached_property
    def _light(self) -> NDArray[np.float64]:
        """Drive of every 8-bit code: (projectors, 256, 3)."""
        codes = np.repeat(np.linspace(0, 1, 256)[:, None], 3, axis=1)
        return np.stack([response.to_linear(codes) for response, _ in self._distinct])


def parse_response(value: object) -> Response:
    """`"linear"`, `"srgb"`, a gamma (number or its text), or a table of rising values -> Response."""
    if isinstance(value, str) and value in ("linear", "srgb"):
        return Response(value)
    if isinstance(value, list):
        rows = [row if isinstance(row, list) else [row] for row in value]
        if len(rows) > MOST_ROWS or not all(_is_number(v) for row in rows for v in row):
            raise InputError(f"response: a table holds numbers, or rows of three numbers, at most {MOST_ROWS} of them")
        return Response("table", table=tuple(tuple(float(v) for v in row) for row in rows))
    if isinstance(value, str):
        with suppress(ValueError):
            value = float(value)
    if not _is_number(value):
        raise InputError(f"response {shown(value)}: expected linear, srgb, a gamma such as 2.2, or a table")
    return Response("gamma", gamma=float(value))


def read_response(table: Table, folder: Path | None = None) -> Response:
    """A table's `response`, linear where it says nothing.

    folder : where response files may be named, there or below; None for a table that names none.
    """
    if folder is not None and _names_file(table.values.get("response")):
        return named_response(str(table.path("response", folder)))
    try:
        return parse_response(table.raw("response", "linear"))
    except InputError as error:
        raise table.refusal(f": {error}") from None


def named_response(text: str) -> Response:
    """`linear`, `srgb`, a gamma such as `2.2`, or a .toml file with `response = …`; InputError for anything else."""
    if not text.endswith(".toml"):
        return parse_response(text)
    path = Path(text)
    values = read_toml(path, FIX)
    if "response" not in values:
        raise InputError(f"{path}: has no entry named response; {FIX}")
    return read_response(Table(values, f"{path}", FIX))


def projector_response(text: str) -> Response:
    """As `named_response`; a .toml file may also be a scene or a calibration.toml, whose projector's it is."""
    path = Path(text)
    values = read_toml(path, FIX) if text.endswith(".toml") else {}
    if "response" in values or not {"projector", "projectors"} & values.keys():
        return named_response(text)
    file = Table(values, f"{path}", FIX)
    projector = file.table("projector") if "projector" in values else file.tables("projectors")[0]
    return read_response(projector, path.parent)


def _names_file(value: object) -> bool:
    return isinstance(value, str) and value.endswith(".toml")


def _is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def transfer_table(transfer: str) -> NDArray[np.float32]:
    """Linear light of picture code values i / (n − 1): (n,). BT.1886 with zero black is a gamma of 2.4."""
    gammas = {"bt1886": 2.4, "gamma22": 2.2, "gamma28": 2.8}
    codes = np.linspace(0, 1, TABLE_SIZE)
    kind = "gamma" if transfer in gammas else transfer
    return _analytic(kind, gammas.get(transfer, 1.0), codes).astype(np.float32)


def _analytic(kind: str, gamma: float, codes: NDArray[np.float64]) -> NDArray[np.float64]:
    if kind == "linear":
        return codes
    if kind == "gamma":
        return np.asarray(codes**gamma)
    return np.where(codes <= _SRGB_KNEE, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1


def _analytic_inverse(kind: str, gamma: float, light: NDArray[np.float64]) -> NDArray[np.float64]:
    if kind == "linear":
        return light
    if kind == "gamma":
        return np.asarray(light ** (1 / gamma))
    return np.where(light <= _SRGB_KNEE / 12.92, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


def _check_table(table: tuple[tuple[float, ...], ...]) -> None:
    values = np.array(table, np.float64) if len({len(row) for row in table}) == 1 else np.empty(0)
    if values.ndim != 2 or len(values) < 2 or values.shape[1] not in (1, 3):
        raise InputError("response: a table has at least two rows of one or three numbers")
    if (
        not np.isfinite(values).all()
        or values[0].any()
        or np.any(values[-1] != 1)
        or np.any(np.diff(values, axis=0) <= 0)
    ):
        raise InputError(
            "response: a table rises strictly from 0 to 1 in each column (subtract black, divide by white)"
        )
