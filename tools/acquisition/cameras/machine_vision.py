"""A machine-vision camera through Basler's pylon (the optional extra `pylon`), which gives the sensor's raw light.

All automatic functions are switched off and read back. A software trigger starts each exposure, so that no frame shows
an earlier picture. Cameras differ in their settings: a missing setting is skipped, and a setting that does not change
is an error.
"""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError, one_line
from counterlight.tools.acquisition.cameras.camera import Shot
from counterlight.tools.hdr.raw_files import binned, grey

OFF = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BslLightSourcePreset", "LightSourcePreset")
NOT = ("GammaEnable", "LUTEnable", "ColorTransformationEnable", "AcquisitionFrameRateEnable")
TIMES = ("ExposureTime", "ExposureTimeAbs")  # in microseconds; older GigE cameras have the second
# lowest: gain adds noise, and a black level would count as light
LOWEST = (("Gain", "GainRaw"), ("BlackLevel", "BlackLevelRaw"))
MOSAICS = {  # colours of a quad, by the name of its first row
    "RG": ((0, 1), (1, 2)),
    "GR": ((1, 0), (2, 1)),
    "GB": ((1, 2), (0, 1)),
    "BG": ((2, 1), (1, 0)),
}
BITS = (12, 10, 16, 8)  # preferred first: containers of 16 bits hold 12 bits and noise
ANSWER_S = 5.0  # seconds beyond the exposure time to wait for a trigger or a frame
TRIES = 3  # attempts for a frame that loses packets
AGAIN = "plug it in again and run the same command again"
OBEYED = 0.05  # allowed relative difference between the exposure times set and read back


class MachineVisionDevice:
    """The frames of an open pylon camera; InputError if it cannot be set by hand."""

    timed = True

    def __init__(self, camera: Any) -> None:
        pylon, self._genicam = _libraries()
        self._pylon, self._camera, self._exposed_s = pylon, camera, 0.0
        self._sites: NDArray[np.unsignedinteger] = np.zeros((0, 0), np.uint16)  # of the last frame
        info = camera.GetDeviceInfo()
        self.name = f"pylon {info.GetModelName()} {info.GetSerialNumber()}"
        with self._answering():
            self._set_by_hand()
            self._colours, self._bits = self._choose_format()
            self._trigger_by_hand()
            camera.StartGrabbing(pylon.GrabStrategy_OneByOne)

    def begin(self, number: int) -> None:
        """Does nothing: frames do not depend on a capture's number."""

    def expose(self, time: float) -> None:
        with self._answering():
            node = self._first(TIMES)
            if node is None:
                raise InputError(f"{self.name}: its exposure time cannot be set; take another camera")
            least, most = node.Min / 1e6, node.Max / 1e6
            if not least <= time <= most:
                raise InputError(f"{self.name}: no exposure of {time:g} s, its range is {least:g} to {most:g} s")
            node.Value = time * 1e6
            found = node.Value / 1e6
            if abs(found / time - 1) > OBEYED:
                raise InputError(f"{self.name}: asked for an exposure of {time:g} s, it is at {found:g} s")
            self._exposed_s = time

    def skip(self) -> None:
        """Take a frame whose exposure begins now; InputError if no frame arrives."""
        throw, within_ms = self._pylon.TimeoutHandling_ThrowException, round(1e3 * (self._exposed_s + ANSWER_S))
        why = ""
        with self._answering():
            for _ in range(TRIES):
                self._camera.WaitForFrameTriggerReady(within_ms, throw)
                self._camera.ExecuteSoftwareTrigger()
                with self._camera.RetrieveResult(within_ms, throw) as result:
                    if result.GrabSucceeded():
                        self._sites = np.array(result.Array)
                        return
                    why = result.ErrorDescription
        raise InputError(
            f"{self.name}: {TRIES} frames in a row were damaged ({one_line(why)}); try another cable or port"
        )

    def last(self) -> Shot:
        """Return 16-bit (height, width, 3), one pixel per quad, or (height, width) for a grey sensor."""
        white = float((1 << self._bits) - 1)
        if self._colours is None:
            return grey(self._sites, 0.0, white)
        return binned(self._sites, self._colours, np.zeros((2, 2)), white)

    def frame(self) -> Shot:
        self.skip()
        return self.last()

    def _set_by_hand(self) -> None:
        for name in OFF:
            self._set(name, "Off")
        for name in NOT:
            self._set(name, "0")
        gamma = self._node("Gamma")
        if gamma is not None:
            gamma.Value = 1.0
        self._set("ExposureMode", "Timed")
        for names in LOWEST:
            node = self._first(names)
            if node is not None:
                node.Value = node.Min

    def _choose_format(self) -> tuple[NDArray[np.intp] | None, int]:
        """Select the format with the most usable bits; returns the mosaic's colours (None for grey) and the bits."""
        formats = self._node("PixelFormat")
        offered: Sequence[str] = formats.Symbolics if formats is not None else ()
        for bits in BITS:
            for first, colours in MOSAICS.items():
                if f"Bayer{first}{bits}" in offered:
                    self._set("PixelFormat", f"Bayer{first}{bits}")
                    return np.array(colours), bits
        for bits in BITS:
            if f"Mono{bits}" in offered:
                self._set("PixelFormat", f"Mono{bits}")
                return None, bits
        raise InputError(
            f"{self.name}: offers {', '.join(offered) or 'no formats'}; expected Bayer or Mono of 8 to 16 bits"
        )

    def _trigger_by_hand(self) -> None:
        """Expose one frame per software trigger; other triggers, such as bursts, stay off."""
        selector = self._node("TriggerSelector")
        for name in () if selector is None else selector.Symbolics:
            self._set("TriggerSelector", name)
            self._set("TriggerMode", "On" if name == "FrameStart" else "Off")
        self._set("TriggerSelector", "FrameStart")
        self._set("TriggerMode", "On")
        self._set("TriggerSource", "Software")

    def _set(self, name: str, value: str) -> None:
        node = self._node(name)
        if node is not None and node.ToString() != value:
            node.FromString(value)
            if node.ToString() != value:
                raise InputError(f"{self.name}: keeps {name} at {node.ToString()}, expected {value}; set it by hand")

    def _first(self, names: Sequence[str]) -> Any:
        """Returns the first of the settings that the camera has."""
        return next((node for name in names if (node := self._node(name)) is not None), None)

    def _node(self, name: str) -> Any:
        """Returns a setting; None if the camera lacks it or cannot change it now."""
        node = self._camera.GetNodeMap().GetNode(name)
        return node if node is not None and self._genicam.IsWritable(node) else None

    @contextmanager
    def _answering(self) -> Iterator[None]:
        """Convert pylon's exceptions to one-line InputErrors."""
        try:
            if not self._camera.IsOpen():
                raise InputError(f"{self.name}: is unplugged; {AGAIN}")
            yield
        except self._genicam.TimeoutException:
            raise InputError(f"{self.name}: gives no more frames; {AGAIN}") from None
        except self._genicam.GenericException as error:
            what = "is unplugged" if self._camera.IsCameraDeviceRemoved() else _said(error)
            raise InputError(f"{self.name}: {what}; {AGAIN}") from None


@contextmanager
def open_machine_vision_device(wanted: str) -> Iterator[MachineVisionDevice]:
    """Open the camera with this serial number, or else the camera with this index in the list, from 0.

    Raises InputError if there is none, or if another program has it open.
    """
    pylon, genicam = _libraries()
    factory = pylon.TlFactory.GetInstance()
    found = list(factory.EnumerateDevices())
    serials = [device.GetSerialNumber() for device in found]
    if wanted in serials:
        chosen = found[serials.index(wanted)]
    elif wanted.isdecimal() and int(wanted) < len(found):
        chosen = found[int(wanted)]
    else:
        names = (f"{i}: {device.GetModelName()} {serials[i]}" for i, device in enumerate(found))
        raise InputError(
            f"--camera pylon:{wanted}: no such camera, found: {', '.join(names) or 'none'}; plug it in, or give a "
            "serial number or number of these"
        )
    camera = pylon.InstantCamera()
    try:
        try:
            camera.Attach(factory.CreateDevice(chosen))
            camera.Open()
        except genicam.GenericException as error:
            raise InputError(
                f"pylon {chosen.GetModelName()} {chosen.GetSerialNumber()}: cannot be opened ({_said(error)}); close "
                "the program that uses it, or check your rights to it"
            ) from None
        yield MachineVisionDevice(camera)
    finally:
        with suppress(genicam.GenericException):
            camera.Close()


def _libraries() -> tuple[Any, Any]:
    """Returns pypylon's modules pylon and genicam; InputError if pypylon is not installed."""
    try:
        # importing pypylon warns, and with warnings as errors the warning would end the process
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from pypylon import genicam, pylon
    except ImportError:
        raise InputError("--camera pylon: needs an extra package: pip install 'counterlight[pylon]'") from None
    return pylon, genicam


def _said(error: Exception) -> str:
    """Returns pylon's message without the position in its source."""
    return one_line(str(error).partition(" : ")[0].rstrip(". "))
