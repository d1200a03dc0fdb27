"""A projector and a camera that this program controls: show a picture, wait until it is visible, photograph it."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.tools.acquisition.plan import Codes, Picture, codes_of


class Screen(Protocol):
    """A device that shows pictures.

    shape : (height, width).
    refresh_hz : refresh rate; None if unknown.
    """

    @property
    def shape(self) -> tuple[int, int]: ...
    @property
    def refresh_hz(self) -> float | None: ...
    def show(self, codes: Codes) -> None:
        """Show a picture; it may reach the camera some frames later."""


class CameraDevice(Protocol):
    """A device that photographs frame by frame.

    name : identifies the device.
    timed : whether the times of `expose` are seconds; for a simulated sensor they are mere factors.
    """

    @property
    def name(self) -> str: ...
    @property
    def timed(self) -> bool: ...
    def begin(self, number: int) -> None:
        """Start a capture; the noise of a simulated sensor depends only on the number."""

    def expose(self, time: float) -> None:
        """Set the exposure time of the frames that follow; InputError if the camera does not obey."""

    def skip(self) -> None:
        """Wait for one frame, and leave it unread. Cameras that buffer no frames do nothing."""

    def last(self) -> Shot:
        """Read the frame for which `skip` has waited, or take one."""

    def frame(self) -> Shot:
        """Wait for the next frame, and read it."""


class LiveCamera:
    """The camera back end of a screen and a source of frames.

    lag : frames to skip between a change of picture or exposure and a shot; the pre-flight measures it.
    """

    def __init__(self, screen: Screen, device: CameraDevice, exposures: Exposures, lag: int = 0) -> None:
        self.screen, self.device, self._exposures, self.lag = screen, device, exposures, lag
        self._standing: Codes | None = None  # the picture that the camera sees at present
        self._exposed = 0.0

    @property
    def name(self) -> str:
        return self.device.name

    @property
    def exposures(self) -> Exposures:
        return self._exposures

    def prepare(self, first: int, patterns: Sequence[Picture], missing: Sequence[int]) -> None:
        """Does nothing: patterns are shown when they are captured."""

    def capture(self, number: int, picture: Picture) -> tuple[Shot, ...]:
        """Show a picture and take a bracket of it.

        Shots of one exposure follow each other without a wait. So do captures of one picture, unless another was shown
        in between.
        """
        codes = codes_of(picture)
        if self._standing is None or not np.array_equal(codes, self._standing):
            self.show(codes)
        self.device.begin(number)
        shots = list[Shot]()
        for time in self._exposures.times:
            if time != self._exposed:
                self.device.expose(time)
                self.wait(self.lag)
                self._exposed = time
            shots.append(self.device.frame())
        self._standing = codes
        return tuple(shots)

    def show(self, codes: Codes) -> None:
        """Show a picture without waiting for it."""
        self._standing, self._exposed = None, 0.0
        self.screen.show(codes)

    def wait(self, frames: int) -> None:
        for _ in range(frames):
            self.device.skip()
