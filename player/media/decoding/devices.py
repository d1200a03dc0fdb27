"""Devices that decode films, through PyAV; a processor always can."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from av.codec.hwaccel import HWAccel

PROCESSOR, ANY = "no", "auto"
TYPES = "cuda", "vaapi", "videotoolbox", "d3d11va", "qsv", "amf", "vulkan"


def devices_of(hwdec: str) -> "list[HWAccel]":
    """Those to be tried, the first one first: of `TYPE`, `TYPE:DEVICE` or `auto`; only types that this FFmpeg has."""
    from av.codec.hwaccel import HWAccel, hwdevices_available

    kind, _, device = hwdec.partition(":")
    kinds = TYPES if kind == ANY else (kind,)
    return [HWAccel(each, device or None) for each in kinds if each in hwdevices_available()]
