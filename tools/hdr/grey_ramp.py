"""Measured light of a projector's grey levels: a table of readings, or a folder with one picture per level."""

import csv
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError, shown
from counterlight.files.exr import read_rgb
from counterlight.files.reading import read_bytes
from counterlight.response import Response
from counterlight.tools.hdr.camera_response import exposure_table
from counterlight.tools.hdr.photographs import SUFFIXES, read_photograph, refuse_curve

FULL_LEVEL = 255
MAX_TABLE_BYTES = 4 << 20
LIT = 0.5  # share of the brightest parts; brighter pixels belong to the projector's picture
MOST_CLIPPED = 0.01  # largest share of the lit pixels that may be clipped
COLUMNS = "columns level,red,green,blue or level,grey; levels 0 to 255, linear light"


def read_ramp(source: Path, camera_response: Response) -> tuple[FloatArray, FloatArray]:
    """Read levels and their light from a table (`.csv`) or a folder of pictures.

    camera_response : response of the pictures' code values; a table and OpenEXR pictures hold linear light.

    Returns levels (readings,), 0 to 1, and light (readings, 1 or 3), in any unit.
    """
    return _from_pictures(source, camera_response) if source.is_dir() else _from_table(source)


def _from_table(path: Path) -> tuple[FloatArray, FloatArray]:
    try:
        text = read_bytes(path, MAX_TABLE_BYTES, "check the path").decode("utf-8")
        rows = list(csv.reader(text.splitlines()))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a table of text ({error}); expected {COLUMNS}") from None
    names = [name.strip().lower() for name in rows[0]] if rows else []
    if names not in (["level", "red", "green", "blue"], ["level", "grey"]):
        raise InputError(f"{path}: columns {shown(','.join(names)) if names else 'none'}; expected {COLUMNS}")
    numbers = np.array([_numbers(path, i, row, len(names)) for i, row in enumerate(rows[1:], 2) if row])
    if not len(numbers):
        raise InputError(f"{path}: no readings; expected {COLUMNS}")
    return numbers[:, 0] / FULL_LEVEL, numbers[:, 1:]


def _numbers(path: Path, line: int, row: list[str], count: int) -> list[float]:
    try:
        values = [float(text) for text in row]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all() or not 0 <= values[0] <= FULL_LEVEL:
        raise InputError(f"{path}:{line}: {shown(','.join(row))}, expected {count} numbers; {COLUMNS}")
    return values


def _from_pictures(folder: Path, camera_response: Response) -> tuple[FloatArray, FloatArray]:
    """Returns the levels and the mean light of the pixels that the projector lights, per picture."""
    paths = _paths_by_level(folder)
    black, white = (_light(paths[level], camera_response) for level in (0, FULL_LEVEL))
    if black.shape != white.shape:
        raise InputError(f"{paths[0]}: another size than {paths[FULL_LEVEL].name}; all come from one fixed camera")
    rise = (white - black).sum(axis=-1)
    lit = rise >= LIT * np.percentile(rise, 99)
    clipped = float(np.mean(np.any(white[lit] >= 1, axis=-1)))
    if paths[FULL_LEVEL].suffix.lower() != ".exr" and clipped > MOST_CLIPPED:
        raise InputError(
            f"{paths[FULL_LEVEL]}: {clipped:.1%} of the lit pixels are saturated; expose less, or merge brackets"
        )
    readings = []
    for path in paths.values():
        light = _light(path, camera_response)
        if light.shape != white.shape:
            raise InputError(f"{path}: another size than {paths[FULL_LEVEL].name}; all come from one fixed camera")
        readings.append(light[lit].mean(axis=0))
    return np.array(list(paths), np.float64) / FULL_LEVEL, np.array(readings, np.float64)


def _paths_by_level(folder: Path) -> Mapping[int, Path]:
    """Find pictures by the last number of their names: `ramp_035.png` shows level 35."""
    paths: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        number = re.search(r"(\d+)\D*$", path.stem)
        if path.suffix.lower() not in (*SUFFIXES, ".exr") or path.name.startswith(".") or not number:
            continue
        level = int(number[1])
        if level > FULL_LEVEL or level in paths:
            reason = f"as {paths[level].name}" if level in paths else f"beyond {FULL_LEVEL}"
            raise InputError(
                f"{path}: shows level {level}, {reason}; name each picture by its level, 0 to {FULL_LEVEL}"
            )
        paths[level] = path
    for level in (0, FULL_LEVEL):
        if level not in paths:
            raise InputError(
                f"{folder}: {len(paths)} pictures, none of level {level}; name them by the level they show, such as "
                f"ramp_{level:03}.png"
            )
    return paths


def _light(path: Path, camera_response: Response) -> FloatArray:
    """Returns linear light (height, width, 1 or 3)."""
    if path.suffix.lower() == ".exr":
        return read_rgb(path).astype(np.float64)
    refuse_curve(path, camera_response, "--camera-response")
    picture = read_photograph(path)
    codes = picture if picture.ndim == 3 else picture[..., None]
    exposure = exposure_table(camera_response, int(np.iinfo(codes.dtype).max) + 1, codes.shape[2])
    return np.stack([column[codes[..., i]] for i, column in enumerate(exposure.T)], axis=-1)
