"""Live picture of the camera for aiming, focusing and exposing it; the user then begins the acquisition or quits.

The projector shows white, a focus card or black. White is briefly interrupted by black now and then, to find the
projector's picture in the view.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from counterlight.errors import InputError
from counterlight.gl.monitors import Monitor, find_monitor, list_monitors
from counterlight.gl.pattern_window import CLOSED, PreviewWindow
from counterlight.overlay.osd import Legend, Page
from counterlight.pipeline.test_cards import card
from counterlight.raster import side_by_side
from counterlight.tools.acquisition.aiming import Framing, brightest, framing, sharpness, shown
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.tools.acquisition.cameras.folder import AimedFolder
from counterlight.tools.acquisition.cameras.live import CameraDevice, LiveCamera, Screen
from counterlight.tools.acquisition.cameras.window import WindowScreen
from counterlight.tools.acquisition.rig import open_rig

STEPS = 3  # key presses that double the exposure
CARDS = ("white", "focus", "black")
FILLED = 0.75  # share of a monitor's sides that the window fills
BLINK_S, SELDOM = 3.0, 4  # least time between blinks: in seconds, and as a multiple of a blink's duration
SETTLED = 6  # frames until a picture has arrived
CLIPPED = (255, 0, 160)  # a colour that rarely occurs in rooms
GAP = 24  # pixels between windows
KEYS = "+ − exposure   c card   space begins   q ends"
QUIT, BEGIN = ("q", "escape", CLOSED), ("space", "enter")


def preview(options: argparse.Namespace) -> tuple[float, ...] | None:
    """Aim the camera that the options name; returns the exposures to begin with, or None if the user quits.

    Raises InputError like `open_rig`, and if there is no monitor besides the projector's.
    """
    with open_rig(options) as (camera, projectors):
        if isinstance(camera, LiveCamera):
            aim = _Aim(camera.screen, camera.device, camera.exposures, max(SETTLED, camera.lag))
        else:
            folder = AimedFolder(Path(options.camera[0].partition(":")[2]), side_by_side(projectors)[0])
            aim = _Aim(folder, folder, camera.exposures, None)
        begins = aim.run(options.monitor)
    return tuple(aim.factor * exposure for exposure in options.exposures or (1.0,)) if begins else None


class _Aim:
    """The preview loop; `settled` is the frames until a picture has arrived, or None if another program photographs."""

    def __init__(self, screen: Screen, device: CameraDevice, exposures: Exposures, settled: int | None) -> None:
        self._screen, self._device, self._exposures, self._settled = screen, device, exposures, settled
        self._steps, self._card, self._best = 0, 0, 0.0
        self._framing: Framing | None = None
        self._blinks_at = float("-inf")
        self._said = ""

    @property
    def factor(self) -> float:
        """The factor that the user has applied to the exposures."""
        return float(2 ** (self._steps / STEPS))

    def run(self, projectors: Sequence[str]) -> bool:
        """Show the preview; returns whether the acquisition should begin."""
        self._show_card()
        if self._settled is not None:
            self._device.expose(self._exposures.shortest)
        shot = self._device.frame()
        with _opened_window(shot, self._screen, projectors) as window:
            while True:
                light = self._exposures.one(shot, 1.0)
                clipped = self._exposures.saturated([shot] * len(self._exposures.times))
                page = self._page(shot, light, float(clipped.mean()))
                for key in window.show(shown(light, clipped, window.shape, CLIPPED), page):
                    if key in (*QUIT, *BEGIN):
                        return key in BEGIN
                    self._press(key)
                shot = self._next()

    def _next(self) -> Shot:
        """Returns the next frame, after an occasional blink to black."""
        if self._settled is not None and CARDS[self._card] == "white" and time.monotonic() > self._blinks_at:
            began = time.monotonic()
            self._framing = self._blink(self._settled)
            ended = time.monotonic()
            self._blinks_at = ended + max(BLINK_S, SELDOM * (ended - began))
        return self._device.frame()

    def _blink(self, settled: int) -> Framing | None:
        black, again = self._settled_frames(0, 2, settled)
        (white,) = self._settled_frames(255, 1, settled)
        return framing(*(self._exposures.one(shot, 1.0) for shot in (black, again, white)))

    def _settled_frames(self, level: int, count: int, settled: int) -> list[Shot]:
        self._screen.show(np.full((*self._screen.shape, 3), level, np.uint8))
        for _ in range(settled):
            self._device.skip()
        return [self._device.frame() for _ in range(count)]

    def _press(self, key: str) -> None:
        if key == "c":
            self._card = (self._card + 1) % len(CARDS)
            self._best, self._blinks_at = 0.0, float("-inf")
            self._show_card()
        elif key in ("+", "=", "-"):
            step, self._said = -1 if key == "-" else 1, ""
            self._steps += step
            try:
                self._device.expose(self._exposures.shortest * self.factor)
            except InputError as error:
                self._said = str(error)
                self._steps -= step
                with suppress(InputError):  # the camera cannot be set at all
                    self._device.expose(self._exposures.shortest * self.factor)

    def _show_card(self) -> None:
        drive = card(CARDS[self._card], self._screen.shape)
        self._screen.show(np.rint(255 * drive ** (1 / 2.2)).astype(np.uint8))

    def _page(self, shot: Shot, light: np.ndarray, clipped: float) -> Page:
        sharp = sharpness(light)
        self._best = max(self._best, sharp)
        exposed = f"{self._exposures.shortest * self.factor:.3g} s" if self._device.timed else f"×{self.factor:.2f}"
        lines = [
            f"{self._device.name.partition(',')[0]}   exposure {exposed}   projector {CARDS[self._card]}",
            f"brightest {100 * brightest(shot):.0f} % of the range   {100 * clipped:.2f} % clipped",
            f"sharpness {sharp:.3g}   best {self._best:.3g}",
        ]
        if self._settled is not None:
            lines.append(str(self._framing or "the projector's picture is not seen: switch it on, aim, expose longer"))
        return Page((*lines, *([self._said] if self._said else []), KEYS), legends=(Legend(CLIPPED, "clipped"),))


@contextmanager
def _opened_window(shot: Shot, screen: Screen, projectors: Sequence[str]) -> Iterator[PreviewWindow]:
    """Open a window for pictures like `shot`, on a monitor without a projector, next to the projectors' window."""
    monitor = preview_monitor(list_monitors(), projectors)
    height, width = shot.shape[:2]
    scale = FILLED * min(monitor.height / height, monitor.width / width)
    left = screen.place[2] + GAP if isinstance(screen, WindowScreen) and not projectors else GAP
    shape = max(1, round(scale * height)), max(1, round(scale * width))
    window = PreviewWindow(shape, monitor, (left, GAP))
    try:
        yield window
    finally:
        window.release()


def preview_monitor(monitors: list[Monitor], projectors: Sequence[str]) -> Monitor:
    """Returns the first monitor that is not a projector; InputError if there is none."""
    taken = {find_monitor(monitors, projector).name for projector in projectors}
    free = [monitor for monitor in monitors if monitor.name not in taken]
    if not free:
        raise InputError("--preview needs a monitor besides the projector's; connect one, or aim without --preview")
    return free[0]
