"""Import a folder of Gray-code captures as a calibration folder, by direct mapping."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.acquisition.captures import Captures, find_captures
from counterlight.tools.acquisition.direct_mapping import NOBODY, Mapping, direct_mapping, direct_transport
from counterlight.tools.acquisition.graycode import Decoded, decode
from counterlight.tools.choices import GRAYCODE_ORDERS
from counterlight.tools.transport.mask import lit_pixels
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Transport

LINEAR = Response("linear")
MAX_STEP, MAX_FILL_RADIUS = 64, 256


@dataclass(frozen=True)
class GraycodeOptions:
    """How captures are read.

    projector : size and response.
    camera_response : response of the captures' code values.
    order : one of GRAYCODE_ORDERS; None infers it from the names.
    step : side of a code cell in projector pixels.
    min_contrast : least difference of a pattern and its inverse, in 8-bit code values.
    fill_radius : gaps between decoded cells up to twice as wide (in cells) are filled; 0 fills none.

    Raises InputError for a number out of range.
    """

    projector: Device
    camera_response: Response = LINEAR
    order: str | None = None
    step: int = 1
    min_contrast: float = 5.0
    fill_radius: int = 4

    def __post_init__(self) -> None:
        if self.order not in (None, *GRAYCODE_ORDERS):
            raise InputError(f"--order {self.order}: expected {' or '.join(GRAYCODE_ORDERS)}")
        if not 1 <= self.step <= MAX_STEP:
            raise InputError(f"--step {self.step}: expected 1 to {MAX_STEP} projector pixels")
        if not 0 < self.min_contrast <= 255:
            raise InputError(f"--min-contrast {self.min_contrast:g}: expected above 0, at most 255 code values")
        if not 0 <= self.fill_radius <= MAX_FILL_RADIUS:
            raise InputError(f"--fill-radius {self.fill_radius}: expected 0 to {MAX_FILL_RADIUS} cells")

    @property
    def cells(self) -> tuple[int, int]:
        """(rows, columns) of the code."""
        return -(-self.projector.height // self.step), -(-self.projector.width // self.step)


@dataclass(frozen=True)
class GraycodeSummary:
    """Counts of decoded, filled and rejected pixels; the text is the command's output."""

    order: str
    camera: tuple[int, int]
    valid: int
    undecided: int
    saturated: int
    seen: int
    filled: int
    never_seen: int
    darkened: int
    left_out: int
    camera_response: Response

    def __str__(self) -> str:
        notes = [f"{self.saturated} saturated"]
        if self.darkened:
            notes.append(f"{self.darkened} channel values with black above white set to 0")
        if self.left_out:
            notes.append(f"{self.left_out} other pictures left out")
        return (
            f"{self.order} order, camera taken as {_name(self.camera_response)}: {self.valid} of "
            f"{self.camera[1]}x{self.camera[0]} camera pixels valid ({self.undecided} lit but undecided), projector "
            f"pixels: {self.seen} seen, {self.filled} filled, {self.never_seen} never seen; {', '.join(notes)}"
        )


def import_graycode_room(
    captures_folder: Path, folder: Path, options: GraycodeOptions, *, name: str | None = None, force: bool = False
) -> GraycodeSummary:
    """Decode the captures and write the calibration `folder`, which appears whole or not at all.

    Raises InputError for captures that are missing, superfluous, damaged, of different sizes, or without a code.
    """
    with calibration.replacing(folder, force=force, inputs=[captures_folder]) as stage:
        room, transport, summary = _decode_room(captures_folder, options, folder.name if name is None else name)
        write_transport(transport, stage)
        calibration.write(room, stage)
    return summary


def _decode_room(
    captures_folder: Path, options: GraycodeOptions, name: str
) -> tuple[Calibration, Transport, GraycodeSummary]:
    captures = find_captures(captures_folder, options.cells, options.order)
    decoded = decode(captures, options.camera_response)
    rise, darkened = _rise(decoded)
    lit = lit_pixels(rise, decoded.black)
    valid = lit & decoded.valid(options.cells, options.min_contrast)
    if not valid.any():
        raise InputError(_nothing_decoded(captures_folder, captures, decoded, options))
    mapping = direct_mapping(
        decoded.x,
        decoded.y,
        valid,
        options.projector.shape,
        step=options.step,
        fill_radius=options.fill_radius,
    )
    room = Calibration(
        name,
        _provenance(captures_folder, captures, options),
        (options.projector,),
        Device(*decoded.shape, LINEAR),
        decoded.black,
        valid,
    )
    summary = _summary(captures, decoded, options, mapping, lit, valid, int(darkened[valid].sum()))
    return room, direct_transport(mapping, rise.reshape(-1, 3)), summary


def _rise(decoded: Decoded) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Returns white − black, clamped at 0, and where it was negative (noise)."""
    rise = decoded.white - decoded.black
    return np.maximum(rise, 0), rise < 0


def _summary(
    captures: Captures,
    decoded: Decoded,
    options: GraycodeOptions,
    mapping: Mapping,
    lit: NDArray[np.bool_],
    valid: NDArray[np.bool_],
    darkened: int,
) -> GraycodeSummary:
    owned, seen = int(np.count_nonzero(mapping.owner != NOBODY)), int(mapping.decoded.sum())
    return GraycodeSummary(
        order=captures.order,
        camera=decoded.shape,
        valid=int(valid.sum()),
        undecided=int((lit & ~valid).sum()),
        saturated=int((decoded.saturated & valid).sum()),
        seen=seen,
        filled=owned - seen,
        never_seen=options.projector.pixels - owned,
        darkened=darkened,
        left_out=captures.left_out,
        camera_response=options.camera_response,
    )


def _nothing_decoded(folder: Path, captures: Captures, decoded: Decoded, options: GraycodeOptions) -> str:
    sure = int((decoded.contrast * 255 >= options.min_contrast).sum())
    if sure:
        bits = f"{len(captures.columns)} + {len(captures.rows)} bits"
        return (
            f"{folder}: {sure} pixels decode ({bits}, {captures.order} order), none of them lit and inside "
            f"{options.projector.width}x{options.projector.height}; check --projector, --step and --order"
        )
    return (
        f"{folder}: no camera pixel shows a pattern and its inverse at least {options.min_contrast:g} code values "
        f"apart in all {2 * (len(captures.columns) + len(captures.rows))} captures; check the order of the files, "
        f"or lower --min-contrast"
    )


def _provenance(folder: Path, captures: Captures, options: GraycodeOptions) -> str:
    floodlight = "white and black captured" if captures.white and captures.black else "white or black from the pairs"
    return (
        f"counterlight import-graycode of {folder.resolve().name}: {captures.order} order, "
        f"{len(captures.columns)} + {len(captures.rows)} bits of {options.step} projector pixels, {floodlight}, "
        f"camera {_name(options.camera_response)}, least contrast {options.min_contrast:g}, "
        f"fill radius {options.fill_radius}, direct mapping"
    )


def _name(response: Response) -> str:
    return f"gamma {response.gamma:g}" if response.kind == "gamma" else response.kind
