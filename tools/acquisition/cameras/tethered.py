"""A still camera on a cable, through gphoto2 (the optional extra of that name): RAW or JPEG, with shutter control."""

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from typing import Any

import numpy as np

from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.acquisition.cameras.camera import Shot
from counterlight.tools.hdr.photographs import decode_photograph, refuse_curve
from counterlight.tools.hdr.raw_files import is_raw

SHUTTERS = ("shutterspeed", "shutterspeed2")
OBEYED = 0.1  # allowed relative difference to the nearest shutter time


class TetheredDevice:
    """The frames of a still camera: each frame is a new shot, so that no old frame can appear.

    response : camera response of JPEGs; RAW is linear.
    """

    timed = True

    def __init__(self, gphoto2: Any, camera: Any, response: Response) -> None:
        self._gphoto2, self._camera, self._response = gphoto2, camera, response
        self._model = str(camera.get_abilities().model)

    @property
    def name(self) -> str:
        return f"gphoto2 {self._model}"

    def begin(self, number: int) -> None:
        """Does nothing: frames do not depend on a capture's number."""

    def expose(self, time: float) -> None:
        config = self._camera.get_config()
        shutter = self._shutter(config)
        offered = {choice: seconds for choice in shutter.get_choices() if (seconds := shutter_time(choice))}
        if not offered:
            raise InputError(f"{self._model}: offers no shutter times; turn its dial to manual (M)")
        nearest = min(offered, key=lambda choice: abs(np.log(offered[choice] / time)))
        if abs(offered[nearest] / time - 1) > OBEYED:
            raise InputError(f"{self._model}: no shutter time of {time:g} s; the nearest is {offered[nearest]:g} s")
        if shutter.get_value() != nearest:
            shutter.set_value(nearest)
            self._camera.set_config(config)

    def skip(self) -> None:
        """Does nothing: the camera buffers no frames."""

    def last(self) -> Shot:
        return self.frame()

    def frame(self) -> Shot:
        place = self._camera.capture(self._gphoto2.GP_CAPTURE_IMAGE)
        file = self._camera.file_get(place.folder, place.name, self._gphoto2.GP_FILE_TYPE_NORMAL)
        content = bytes(memoryview(file.get_data_and_size()))
        self._camera.file_delete(place.folder, place.name)
        try:
            refuse_curve(place.name, self._response, "--camera-response")
            return np.ascontiguousarray(decode_photograph(content, place.name))
        except InputError as error:
            advice = "" if is_raw(place.name) else "; set the camera to RAW or JPEG"
            raise InputError(f"{self._model}: {error}{advice}") from None

    def _shutter(self, config: Any) -> Any:
        for name in SHUTTERS:
            try:
                return config.get_child_by_name(name)
            except self._gphoto2.GPhoto2Error:
                continue
        raise InputError(f"{self._model}: its shutter cannot be set from here; turn its dial to manual (M)")


def shutter_time(choice: str) -> float | None:
    """Returns the seconds of `1/250`, `0.3` or `2s`; None for `bulb` and the like."""
    try:
        seconds = float(Fraction(choice.strip().removesuffix("s").strip()))
    except (ValueError, ZeroDivisionError):
        return None
    return seconds if seconds > 0 else None


@contextmanager
def open_tethered_device(response: Response) -> Iterator[TetheredDevice]:
    """Open the first camera that gphoto2 finds; InputError if there is none or it is in use."""
    try:
        import gphoto2
    except ImportError:
        raise InputError("--camera gphoto2 needs an extra package: pip install 'counterlight[gphoto2]'") from None
    camera = gphoto2.Camera()
    try:
        camera.init()
    except gphoto2.GPhoto2Error as error:
        raise InputError(
            f"gphoto2: no camera answers ({error.string}); switch it on, plug it in, close programs that hold it (gvfs)"
        ) from None
    try:
        yield TetheredDevice(gphoto2, camera, response)
    finally:
        camera.exit()
