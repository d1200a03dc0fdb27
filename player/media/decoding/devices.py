"""Hardware devices that decode films, through PyAV. The processor can always decode."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from av.codec.hwaccel import HWAccel

PROCESSOR, ANY = "no", "auto"
TYPES = "cuda", "vaapi", "videotoolbox", "d3d11va", "qsv", "amf", "vulkan"


def devices_of(hwdec: str) -> "list[HWAccel]":
    """Return the devices to try, in order, for `TYPE`, `TYPE:DEVICE` or `auto`. Includes only types of this FFmpeg."""
    from av.codec.hwaccel import HWAccel, hwdevices_available

    kind, _, device = hwdec.partition(":")
    kinds = TYPES if kind == ANY else (kind,)
    return [HWAccel(each, device or None) for each in kinds if each in hwdevices_available()]
