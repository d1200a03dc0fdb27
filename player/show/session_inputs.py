"""What a session is given: a display, remotes, what it begins with, and what it reaches of the room's folder."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, TypeAlias

from counterlight.frames import PixelFormat
from counterlight.medium import Medium
from counterlight.picture import Picture
from counterlight.placement import Corners
from counterlight.refinement import Certificate
from counterlight.renderer import Renderer
from counterlight.show.commands import Commands
from counterlight.show.osd import Page
from counterlight.show.outline import Points
from counterlight.show.playback import Sound

Steps: TypeAlias = int | Literal["auto"]


class Display(Protocol):
    """A window that shows what the renderer has rendered."""

    @property
    def closed(self) -> bool: ...

    @property
    def fullscreen(self) -> bool: ...

    @property
    def monitor(self) -> str:
        """Name of the monitor that the window is on."""

    def poll(self, timeout_s: float) -> list[str]:
        """Names of the keys pressed since the last call, waiting at most `timeout_s` for one."""

    def notices(self) -> list[str]:
        """What happened to the monitors since the last call."""

    def present(self, page: Page | None, *, black: bool) -> None:
        """Show the rendered view with a page over it, or black."""

    def set_fullscreen(self, on: bool) -> None: ...

    def set_title(self, title: str) -> None: ...

    def move_to(self, monitor: str) -> None:
        """Go to the monitor of a name or number."""

    def identify(self) -> None:
        """Write its name on every monitor for a while."""


class Remote(Protocol):
    """Something else than keys that commands the player (a control socket)."""

    def poll(self, commands: Commands) -> None:
        """Run what has arrived; never wait."""


class Heartbeat(Protocol):
    """Told how the show goes, whenever it is due; asked once a loop."""

    @property
    def due(self) -> bool: ...

    def beat(self, facts: Mapping[str, object]) -> None: ...


class Audio(Protocol):
    """An audio output."""

    volume: float
    mute: bool

    def open(self, medium: Medium) -> Sound:
        """The sound of a medium."""


@dataclass(frozen=True)
class Setup:
    """What a session begins with.

    lasting : whether the show goes on whatever becomes of its media.
    image_display_duration : seconds that a still is shown; None for ever.
    silence : why there is no audio output, told when a medium has sound; None: nobody wants any.
    """

    view: str = "projector"
    compensation: bool = True
    refine: Steps = 0
    picture: Picture = field(default_factory=Picture)
    lasting: bool = False
    loop_file: bool = False
    speed: float = 1.0
    start_s: float = 0.0
    image_display_duration: float | None = None
    blackout: bool = False
    silence: str | None = None
    osd: bool = True
    screenshots: Path = Path()


@dataclass(frozen=True)
class Site:
    """What a session reaches of the room's folder.

    reload : read the maps, make a renderer of them.  fit : the corners of a picture that nobody placed.
    save : keep corners for the next time.  psnr : dB of the camera's picture, by its certificate.
    refinable : whether the maps are there that refinement needs.
    camera : (height, width) of the view.  on_projector : where the projector's picture lights points of the view most.
    """

    reload: Callable[[], Renderer]
    fit: Callable[[PixelFormat], Corners]
    save: Callable[[Corners | None], object]
    psnr: Callable[[Certificate], float]
    refinable: Callable[[], bool]
    camera: Callable[[], tuple[int, int]]
    on_projector: Callable[[Points], Points]
