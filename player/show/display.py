"""What a session shows its pictures in; gl/ has the windows that do."""

from typing import Protocol

from counterlight.overlay.osd import Page
from counterlight.overlay.pointer import Pointer


class Display(Protocol):
    """A window that shows what the renderer has rendered."""

    @property
    def closed(self) -> bool: ...

    @property
    def fullscreen(self) -> bool: ...

    @property
    def monitor(self) -> str:
        """Name of the monitor that the window is on."""

    @property
    def bits(self) -> int:
        """Of a code value that it shows."""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of what text may cover."""

    def poll(self, timeout_s: float) -> list[str]:
        """Names of the keys pressed since the last call, waiting at most `timeout_s` for one."""

    def pointers(self) -> list[Pointer]:
        """What the left mouse button has done since the last call."""

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
