"""The display that a session needs. The windows in gl/ implement it."""

from typing import Protocol

from counterlight.overlay.osd import Page, Pointer


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
        """Bits per code value that the window shows."""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the area that text may cover."""

    def poll(self, timeout_s: float) -> list[str]:
        """Return the keys pressed since the last call. Waits at most `timeout_s` for a key."""

    def pointers(self) -> list[Pointer]:
        """Return the events of the left mouse button since the last call."""

    def notices(self) -> list[str]:
        """Return one line for each change of the monitors since the last call."""

    def present(self, page: Page | None, *, black: bool) -> None:
        """Show the rendered view with `page` over it, or a black picture."""

    def set_fullscreen(self, on: bool) -> None: ...

    def set_title(self, title: str) -> None: ...

    def move_to(self, monitor: str) -> None:
        """Move the window to a monitor, given by name or number."""

    def identify(self) -> None:
        """Show each monitor's name on that monitor for a while."""
