"""A projector and a camera that are both in our hands: show a picture, wait until it is seen, photograph it."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.tools.acquisition.plan import Codes, Picture, codes_of


class Screen(Protocol):
    """What the projector shows.

    shape : (height, width).  refresh_hz : of its pictures, None if nobody knows.
    """

    @property
    def shape(self) -> tuple[int, int]: ...
    @property
    def refresh_hz(self) -> float | None: ...
    def show(self, codes: Codes) -> None:
        """Put a picture on the glass; it may reach the camera some frames later."""


class Eye(Protocol):
    """What photographs, frame by frame.

    name : what it is.  timed : the times of `expose` are seconds (of a simulated sensor they are mere factors).
    """

    @property
    def name(self) -> str: ...
    @property
    def timed(self) -> bool: ...
    def begin(self, number: int) -> None:
        """A capture begins; what a simulated sensor draws by chance depends on its number alone."""

    def expose(self, time: float) -> None:
        """From now on expose so long; InputError if the camera does not obey."""

    def skip(self) -> None:
        """Let one frame pass."""

    def frame(self) -> Shot:
        """The next frame."""


class LiveCamera:
    """The camera back end of a screen and an eye.

    lag : frames to let pass between a change, of picture or exposure, and a shot; the pre-flight measures it.
    """

    def __init__(self, screen: Screen, eye: Eye, exposures: Exposures, lag: int = 0) -> None:
        self.screen, self.eye, self._exposures, self.lag = screen, eye, exposures, lag
        self._standing: Codes | None = None  # what the camera sees already, and how it is exposed
        self._exposed = 0.0

    @property
    def name(self) -> str:
        return self.eye.name

    @property
    def exposures(self) -> Exposures:
        return self._exposures

    def prepare(self, first: int, patterns: Sequence[Picture], missing: Sequence[int]) -> None:
        """Nothing to do: patterns are shown when they are captured."""

    def capture(self, number: int, picture: Picture) -> tuple[Shot, ...]:
        """Show a picture and take a bracket of it; shots of one exposure follow each other without a wait.

        So do captures of one picture, unless something else was shown in between.
        """
        codes = codes_of(picture)
        if self._standing is None or not np.array_equal(codes, self._standing):
            self.show(codes)
        self.eye.begin(number)
        shots = list[Shot]()
        for time in self._exposures.times:
            if time != self._exposed:
                self.eye.expose(time)
                self.wait(self.lag)
                self._exposed = time
            shots.append(self.eye.frame())
        self._standing = codes
        return tuple(shots)

    def show(self, codes: Codes) -> None:
        """Show a picture without waiting for it."""
        self._standing, self._exposed = None, 0.0
        self.screen.show(codes)

    def wait(self, frames: int) -> None:
        for _ in range(frames):
            self.eye.skip()
