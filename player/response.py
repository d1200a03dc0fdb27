"""Transfer curves: how code values become light, for projectors and for pictures.

A *response* maps a code value (0..1, the projector's input) to linear drive (0..1). Shaders use only tables, so that
analytic and measured curves take the same path. CPU functions read the same tables.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeAlias, TypeGuard

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import brief
from counterlight.errors import InputError, shown
from counterlight.files.reading import read_toml
from counterlight.files.tables import Table
from counterlight.processing import CELLS, Processing
from counterlight.raster import Region, Shape, side_by_side

TABLE_SIZE = 1024
FIX = "a response file holds: response = [[0, 0, 0], …, [1, 1, 1]], as in a calibration.toml"
MOST_SAMPLES = 1 << 12  # most samples in the table of a white segment
BRIGHTEST = 20.0  # largest light of a white segment, relative to the white of the primaries
MOST_ROWS = 1 << 16  # most rows of a measured table: one per code of a 16-bit camera
_SRGB_KNEE = 0.04045
Matrix: TypeAlias = tuple[tuple[float, ...], ...]  # rows of numbers
PQ_PEAK = 10_000.0  # cd/m² of PQ's highest code
_PQ_M = 2610 / 16384, 2523 / 4096 * 128
_PQ_C = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
_HLG_A, _HLG_B, _HLG_C = 0.17883277, 0.28466892, 0.55991073


@dataclass(frozen=True)
class WhiteSegment:
    """A projector's white segment: extra light that grey has besides its red, green and blue.

    For codes with primaries p and darkest primary m = min p, such a projector shows p + s(m). s rises from s(0) = 0.
    Instead of p, the player sends c = p − s(m), where m is the least of the m_l that solve m_l + s_l(m_l) = p_l. The
    darkest of c is then m and the light is p, so that light adds up as T requires. White beyond the sum of the
    primaries is lost.

    Raises InputError unless s begins at 0 and m + s(m) rises.

    samples : (samples, 3). s at equal steps of m from 0 to 1, in units of each primary's full light.
    """

    samples: tuple[tuple[float, ...], ...]

    __repr__ = brief

    def __post_init__(self) -> None:
        if not (2 <= len(self.samples) <= MOST_SAMPLES and {len(row) for row in self.samples} == {3}):
            raise InputError(f"white segment: expected 2 to {MOST_SAMPLES} rows of three numbers")
        table = np.array(self.samples, np.float64)
        if (
            not np.isfinite(table).all()
            or table[0].any()
            or np.abs(table).max() > BRIGHTEST
            or np.any(np.diff(table + self._levels[:, None], axis=0) <= 0)
        ):
            raise InputError(
                f"white segment: expected light from 0 to at most {BRIGHTEST:g} that never falls faster than the "
                "primaries rise"
            )

    def added(self, darkest: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return s(m): (…) -> (…, 3)."""
        return np.stack([np.interp(darkest, self._levels, column) for column in np.array(self.samples).T], axis=-1)

    def white(self) -> NDArray[np.float64]:
        """Return 1 + s(1), full white in units of the primaries: (3,)."""
        return 1 + np.array(self.samples[-1])

    def tables(self) -> NDArray[np.float32]:
        """Return two tables, (2, samples, 3) float32: m_l at equal steps of √p_l, and s_l at equal steps of √m."""
        at = np.linspace(0, 1, TABLE_SIZE) ** 2
        whole = self._levels[:, None] + np.array(self.samples)
        darkest = np.stack([np.interp(at, column, self._levels) for column in whole.T], axis=-1)
        return np.stack([darkest, self.added(at)]).astype(np.float32)

    @property
    def _levels(self) -> NDArray[np.float64]:
        return np.linspace(0, 1, len(self.samples))


@dataclass(frozen=True)
class Response:
    """A monotone curve per channel, code value -> linear light, both 0..1.

    Raises InputError if the curve cannot be inverted: gamma outside 0.1..10, or a table that does not rise from 0 to 1.

    kind : "linear", "srgb", "gamma" or "table".
    gamma : exponent, for "gamma".
    table : (samples, 1 or 3), at equally spaced codes, for "table".
    segment : a projector's white segment, whose light is added to the light of the curves.
    processing : a projector's colour processing, whose factor the light of the curves is multiplied with. A projector
        has either of the two.
    """

    kind: str
    gamma: float = 1.0
    table: tuple[tuple[float, ...], ...] = ()
    segment: WhiteSegment | None = None
    processing: Processing | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        if self.segment is not None and self.processing is not None:
            raise InputError("response: expected a white segment or colour processing, not both")
        if self.kind not in ("linear", "srgb", "gamma", "table"):
            raise InputError(f"response {self.kind!r}: expected linear, srgb, a gamma such as 2.2, or a table")
        if self.kind == "gamma" and not 0.1 <= self.gamma <= 10:
            raise InputError(f"response: gamma {self.gamma}, expected 0.1 to 10")
        if self.kind == "table":
            _check_table(self.table)

    def to_linear(self, codes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the linear light of code values; the last axis is the channel. White segments make white exceed 1."""
        light = self.curves(codes)
        if self.processing is not None:
            return light * self.processing.factor(codes)
        return light if self.segment is None else light + self.segment.added(light.min(axis=-1))

    def curves(self, codes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the light of the curves alone."""
        if self.kind == "table":
            table = np.array(self.table, np.float64)
            grid = np.linspace(0, 1, len(table))
            return np.stack([np.interp(codes[..., i], grid, table[:, i % table.shape[1]]) for i in range(3)], axis=-1)
        return _analytic(self.kind, self.gamma, codes)

    def inverse_table(self) -> NDArray[np.float32]:
        """Return code values for light = (i / (n − 1))², i = 0 … n − 1: (n, 3) float32.

        Equal steps of √light follow the curves' steepness near black. For sRGB and gammas up to 2.4, linear
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

    def processing_table(self) -> NDArray[np.float32]:
        """Return the player's table of the colour processing (`Processing.table`); ones if there is no processing."""
        if self.processing is None:
            return np.ones((CELLS, CELLS, CELLS, 3), np.float32)
        inverse, at = self.inverse_table().astype(np.float64), np.linspace(0, 1, TABLE_SIZE)
        return self.processing.table(
            lambda light: np.stack([np.interp(np.sqrt(light[..., i]), at, inverse[:, i]) for i in range(3)], axis=-1)
        )

    def over(self, shape: Shape) -> "RasterResponse":
        """Return this response for a whole raster of (height, width)."""
        return RasterResponse((self,), side_by_side([shape])[1])

    def to_toml(self) -> object:
        """Return the value of `response` in calibration.toml: a name, a gamma or a table."""
        return {"gamma": self.gamma, "table": [list(row) for row in self.table]}.get(self.kind, self.kind)


@dataclass(frozen=True)
class RasterResponse:
    """The responses of projectors side by side in one raster, and their colour matrices if they have any.

    responses : response of each projector.
    regions : region of each projector in the raster.
    colours : D of each projector, (3, 3). D converts a drive q of the shared primaries into the drive D q of the
        projector's own primaries. None means the identity. Empty if no projector has a matrix.
    """

    responses: tuple[Response, ...]
    regions: tuple[Region, ...]
    colours: tuple[Matrix | None, ...] = ()

    __repr__ = brief

    @cached_property
    def row_height(self) -> int:
        """Height of a row of projectors in the raster, in pixels."""
        return next((region.top for region in self.regions if region.top), max(each.height for each in self.regions))

    @cached_property
    def of_column(self) -> NDArray[np.int32]:
        """Index of the distinct projector in each column, (rows of projectors, width); 0 where there is none."""
        rows = self.regions[-1].top // self.row_height + 1
        columns = np.zeros((rows, max(region.left + region.width for region in self.regions)), np.int32)
        for region, each in zip(self.regions, self._each, strict=True):
            right, row = region.left + region.width, region.top // self.row_height
            columns[row, region.left : right] = self._distinct.index(each)
        return columns

    def to_linear(self, codes: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Return the linear drive of the shared primaries for a raster's 8-bit code values, (height, width, 3)."""
        inverse = None if self.matrices is None else np.linalg.inv(self.matrices.astype(np.float64))
        drive = np.empty(codes.shape)
        for top, each in zip(range(0, len(codes), self.row_height), self.of_column, strict=True):
            row = slice(top, top + self.row_height)
            drive[row] = self._light[each[:, None], codes[row], np.arange(3)]
            for number in np.unique(each):
                response, own = self._distinct[number][0], (row, each == number)
                if response.segment is not None:
                    drive[own] += response.segment.added(drive[own].min(axis=-1))
                if response.processing is not None:
                    drive[own] *= response.processing.factor(codes[own] / 255)
            if inverse is not None:
                drive[row] = np.einsum("xkl,yxl->yxk", inverse[each], drive[row])
        return drive

    def inverse_tables(self) -> NDArray[np.float32]:
        """Return `Response.inverse_table` of each distinct projector: (projectors, samples, 3)."""
        return np.stack([response.inverse_table() for response, _ in self._distinct])

    def segment_tables(self) -> NDArray[np.float32] | None:
        """Return the segment tables of each distinct projector, (projectors, 2, samples, 3). None without segments."""
        if all(response.segment is None for response, _ in self._distinct):
            return None
        none = WhiteSegment(((0.0, 0.0, 0.0),) * 2)
        return np.stack([(response.segment or none).tables() for response, _ in self._distinct])

    @cached_property
    def processing_tables(self) -> NDArray[np.float32] | None:
        """`Response.processing_table` of each distinct projector, (projectors, CELLS, CELLS, CELLS, 3).

        None if no projector processes colours.
        """
        if all(response.processing is None for response, _ in self._distinct):
            return None
        return np.stack([response.processing_table() for response, _ in self._distinct])

    @cached_property
    def matrices(self) -> NDArray[np.float32] | None:
        """D of each distinct projector, (projectors, 3, 3). None if no projector has one."""
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
        """Drive of every 8-bit code by the curves alone: (projectors, 256, 3)."""
        codes = np.repeat(np.linspace(0, 1, 256)[:, None], 3, axis=1)
        return np.stack([response.curves(codes) for response, _ in self._distinct])


def parse_response(value: object) -> Response:
    """Parse `"linear"`, `"srgb"`, a gamma (number or text), or a table of rising values."""
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
    """Read a table's `response`, linear by default, and the table's `white_segment` or `processing` if there is one.

    table : table of a TOML file.
    folder : folder of named response files; None if the table may not name files.
    """
    try:
        if folder is not None and _names_file(table.values.get("response")):
            response = named_response(str(table.path("response", folder)))
        else:
            response = parse_response(table.raw("response", "linear"))
        if "white_segment" in table:
            response = replace(response, segment=WhiteSegment(_rows(table, "white_segment", "white segment")))
        if "processing" in table:
            response = replace(response, processing=Processing(_rows(table, "processing", "processing")))
        return response
    except InputError as error:
        raise table.refusal(f": {error}") from None


def _rows(table: Table, key: str, name: str) -> Matrix:
    value = table.raw(key, None)
    rows = value if isinstance(value, list) else []
    if not rows or not all(isinstance(row, list) and all(_is_number(v) for v in row) for row in rows):
        raise InputError(f"{name}: expected rows of three numbers")
    return tuple(tuple(float(v) for v in row) for row in rows)


def named_response(text: str) -> Response:
    """Parse `linear`, `srgb`, a gamma such as `2.2`, or the name of a .toml file with `response = …`.

    Raises InputError for other text.
    """
    if not text.endswith(".toml"):
        return parse_response(text)
    path = Path(text)
    values = read_toml(path, FIX)
    if "response" not in values:
        raise InputError(f"{path}: has no entry named response; {FIX}")
    return read_response(Table(values, f"{path}", FIX))


def projector_response(text: str) -> Response:
    """Parse a response like `named_response`. A .toml file may also be a scene or a calibration.toml."""
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
    """Return the linear light of picture code values i / (n − 1): (n,). BT.1886 with zero black is a gamma of 2.4.

    PQ gives shares of PQ_PEAK, HLG gives scene light.
    """
    gammas = {"bt1886": 2.4, "gamma22": 2.2, "gamma28": 2.8}
    codes = np.linspace(0, 1, TABLE_SIZE)
    if transfer in ("pq", "hlg"):
        return (pq_light(codes) if transfer == "pq" else _hlg_light(codes)).astype(np.float32)
    kind = "gamma" if transfer in gammas else transfer
    return _analytic(kind, gammas.get(transfer, 1.0), codes).astype(np.float32)


def pq_light(codes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply SMPTE ST 2084's EOTF. Returns shares of PQ_PEAK."""
    power = np.asarray(codes) ** (1 / _PQ_M[1])
    return np.asarray((np.maximum(power - _PQ_C[0], 0) / (_PQ_C[1] - _PQ_C[2] * power)) ** (1 / _PQ_M[0]))


def pq_codes(light: NDArray[np.floating]) -> NDArray[np.float64]:
    """Apply the inverse of SMPTE ST 2084's EOTF.

    light : light in shares of PQ_PEAK.
    """
    power = np.asarray(light, np.float64) ** _PQ_M[0]
    return np.asarray(((_PQ_C[0] + _PQ_C[1] * power) / (1 + _PQ_C[2] * power)) ** _PQ_M[1])


def _hlg_light(codes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply the inverse of HLG's OETF (ITU-R BT.2100-2). Returns scene light, 0..1."""
    return np.where(codes <= 0.5, codes**2 / 3, (np.exp((codes - _HLG_C) / _HLG_A) + _HLG_B) / 12)


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
