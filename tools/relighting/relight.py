"""Compute one of the four views of the thesis' Figure 5.3 from a calibration folder and a picture, and write it.

camera : the composition c = T p + e (eq. 3.11), the camera picture under a projector picture; T is undecomposed.
dual : p' = Tᵀ c' (eq. 3.12), the scene from the projector's place, lit by the camera; without ambient light.
inverse-dual : T⁺ c', the projector picture for a camera picture c', without the clamp. For white it sums the columns of
    T⁺, the pattern that looks uniformly white; times the room's white level it is drive.
inverse-camera : T⁺ᵀ p', the column sums of T⁺ in camera space, drive per unit radiance. A pixel is bright where its
    radiance needs much drive, on dark or badly lit surfaces, and negative where its neighbours must give way.
Camera pictures are in screen primaries (counterlight.maps.mixing).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from counterlight import calibration as calibrations
from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, StoredCalibration
from counterlight.errors import InputError
from counterlight.maps.room_maps import RoomMaps, read_maps
from counterlight.pipeline.operators import compensation
from counterlight.raster import Raster
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.relighting.pictures import SUFFIXES, read_placed, white_level, write_view
from counterlight.tools.transport.storage import read_transport
from counterlight.writing.outputs import check_file
from counterlight.writing.replacing import replacing_file

LIT_BY_PROJECTOR = ("camera", "inverse-camera")  # views that take a projector picture; the others take a camera picture
ROUNDING = 1e-6  # excess over full white that resampling may cause


@dataclass(frozen=True)
class RelightOptions:
    """Options of a view.

    view : one of RELIT_VIEWS.
    ambient : whether the camera view includes ambient light; None includes it if there is any.
    white : value that a PNG shows as white; None for the picture's 99th percentile.
    colour : one of COLOURS.
    """

    view: str
    ambient: bool | None = None
    white: float | None = None
    colour: str = "auto"

    def __post_init__(self) -> None:
        if self.ambient and self.view != "camera":
            raise InputError(f"--ambient: the view {self.view} holds no ambient light; it goes with --view camera")


def relight(folder: Path, picture: Path | None, output: Path, options: RelightOptions) -> str:
    """Compute a view and write it; returns a one-line summary that states the scale."""
    check_file(output, suffixes=SUFFIXES, inputs=[] if picture is None else [picture])
    with replacing_file(output) as temporary:
        stored = calibrations.read(folder)
        view = make_view(stored, _picture(stored, picture, options.view), options)
        if not np.abs(view).max() <= np.finfo(np.float32).max:
            raise InputError(
                f"{folder}: the view {options.view} holds NaN or light beyond float32; check the calibration"
            )
        white = white_level(view) if options.white is None else options.white
        write_view(temporary, view, white)
    height, width = view.shape[:2]
    scale = "linear values" if output.suffix.lower() == ".exr" else f"white is {white:.4g}{_cut(view, white)}"
    return f"{output}: {options.view}, {width}x{height}, {scale}"


def make_view(stored: StoredCalibration, picture: FloatArray | None, options: RelightOptions) -> FloatArray:
    """Returns one of the four views of a stored calibration, (height, width, 3); without a picture it is white."""
    calibration = stored.calibration
    if picture is None:
        picture = np.ones((*_lit_from(calibration, options.view).shape, 3))
    if options.view.startswith("inverse"):
        return _inverse_view(read_maps(stored), picture, options.view)
    tier = tier_of(calibration, read_transport(stored), options.colour)
    if options.view == "dual":
        return tier.dual(picture)
    seen = tier.seen(picture)
    return seen - tier.ambient if options.ambient is False else seen


def _inverse_view(maps: RoomMaps, picture: FloatArray, view: str) -> FloatArray:
    """Returns T⁺ A c', or its transpose, in the colour tier for which the maps were built."""
    T_pinv, mixing = compensation(maps), maps.mixing
    if view == "inverse-dual":
        return T_pinv.apply(mixing.unmixed(picture))
    return np.asarray(mixing.unmixed_transpose(T_pinv.apply_transpose(picture)), np.float64)


def _lit_from(calibration: Calibration, view: str) -> Raster:
    return calibration.projector if view in LIT_BY_PROJECTOR else calibration.camera


def _picture(stored: StoredCalibration, path: Path | None, view: str) -> FloatArray | None:
    if path is None:
        return None
    calibration, device = stored.calibration, _lit_from(stored.calibration, view)
    picture = read_placed(path, device.shape, None if view in LIT_BY_PROJECTOR else calibration.screen)
    if view == "camera" and not (picture.min() >= -ROUNDING and picture.max() <= 1 + ROUNDING):
        raise InputError(
            f"{path}: drive from {picture.min():.4g} to {picture.max():.4g}, a projector shows 0 to 1; scale it"
        )
    return picture


def _cut(view: FloatArray, white: float) -> str:
    below, above = (100 * float(np.mean(share)) for share in (view < 0, view > white))
    return f" ({above:.2g} % of the values above, {below:.2g} % below 0 are cut)" if below or above else ""
