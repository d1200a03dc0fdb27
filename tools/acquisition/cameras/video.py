"""A video camera through OpenCV and Video4Linux, with manual, verified exposure and white balance.

A driver may accept a setting and ignore it. Each setting is therefore read back, and the pre-flight compares the light
of two exposure times.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from counterlight.errors import InputError
from counterlight.tools.acquisition.cameras.camera import Shot

MANUAL = 1.0  # V4L2_EXPOSURE_MANUAL
UNIT_S = 1e-4  # seconds per unit of V4L2_CID_EXPOSURE_ABSOLUTE
OBEYED = 0.05  # allowed relative difference between the exposure times set and read back
BY_HAND = {
    cv2.CAP_PROP_AUTO_EXPOSURE: ("automatic exposure", MANUAL),
    cv2.CAP_PROP_AUTO_WB: ("automatic white balance", 0.0),
}
DO_BY_HAND = "set it with v4l2-ctl --set-ctrl, or take another camera"


class Capture(Protocol):
    """The part of cv2.VideoCapture that is used here."""

    def get(self, prop: int, /) -> float: ...
    def set(self, prop: int, value: float, /) -> bool: ...
    def grab(self) -> bool: ...
    def retrieve(self) -> tuple[bool, Shot]: ...


class VideoDevice:
    """The frames of an open video camera; InputError if a setting cannot be made by hand."""

    timed = True

    def __init__(self, device: str, capture: Capture) -> None:
        self._device, self._capture = device, capture
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # a longer buffer holds old frames; not every driver supports this
        for prop, (name, value) in BY_HAND.items():
            capture.set(prop, value)
            if capture.get(prop) != value:
                raise InputError(f"{device}: the camera keeps its {name} on; {DO_BY_HAND}")

    @property
    def name(self) -> str:
        return f"v4l2 {self._device}"

    def begin(self, number: int) -> None:
        """Does nothing: frames do not depend on a capture's number."""

    def expose(self, time: float) -> None:
        wanted = max(1, round(time / UNIT_S))
        self._capture.set(cv2.CAP_PROP_EXPOSURE, wanted)
        found = self._capture.get(cv2.CAP_PROP_EXPOSURE)
        if abs(found - wanted) > max(1, OBEYED * wanted):
            raise InputError(
                f"{self._device}: asked for an exposure of {wanted * UNIT_S:g} s, it is at {found * UNIT_S:g} s; "
                "choose a time within its range (v4l2-ctl --list-ctrls)"
            )

    def skip(self) -> None:
        if not self._capture.grab():
            raise self._gone()

    def last(self) -> Shot:
        came, bgr = self._capture.retrieve()
        if not came:
            raise self._gone()
        return np.ascontiguousarray(bgr[..., ::-1]) if bgr.ndim == 3 else bgr

    def frame(self) -> Shot:
        self.skip()
        return self.last()

    def _gone(self) -> InputError:
        return InputError(f"{self._device}: gives no more frames; plug it in again and run the same command again")


@contextmanager
def open_video_device(number: str) -> Iterator[VideoDevice]:
    """Open the camera /dev/videoNUMBER; InputError if there is none, or if another program has it open."""
    if not number.isdecimal():
        raise InputError(f"--camera v4l2:{number}: expected a number, such as v4l2:0 for /dev/video0")
    device = Path(f"/dev/video{number}")
    if not device.exists():
        found = ", ".join(path.name for path in sorted(Path("/dev").glob("video*"))) or "none"
        raise InputError(f"{device}: no such camera, found: {found}; plug it in, or give another number")
    capture = cv2.VideoCapture(int(number), cv2.CAP_V4L2)
    try:
        if not capture.isOpened():
            raise InputError(f"{device}: cannot be opened; close the program that uses it, or check your rights to it")
        yield VideoDevice(str(device), capture)
    finally:
        capture.release()
