"""The renderer of a session, and a reloaded renderer that replaces it once it has drawn a frame."""

from collections.abc import Callable, Iterator
from contextlib import suppress

from counterlight.errors import InputError
from counterlight.media.frames import PixelFormat
from counterlight.memory import give_back
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.renderer import AnyRenderer


class Renderers:
    """Owns the renderer that draws frames, and the renderer that will replace it.

    current : the renderer that draws frames.
    notice : takes a line for the user.
    """

    def __init__(self, current: AnyRenderer, notice: Callable[[str], None]) -> None:
        self.current, self._notice = current, notice
        self._incoming: AnyRenderer | None = None
        self._pixels: PixelFormat | None = None  # pixel format that the renderers are open for

    def _each(self) -> Iterator[AnyRenderer]:
        return filter(None, (self.current, self._incoming))

    def prepare(self, pixels: PixelFormat, *, crossfade: bool) -> None:
        """Build the resources of `open` while the previous medium still plays."""
        with suppress(InputError):  # `open` raises the same error again
            self.current.prepare(pixels, crossfade=crossfade)

    def open(self, pixels: PixelFormat, adjustments: Adjustments, *, crossfade: bool = False) -> None:
        """Accept frames of a format from now on. The picture on the screen stays until a frame comes."""
        self._pixels = None
        for renderer in self._each():
            renderer.open(pixels, crossfade=crossfade and renderer is self.current)
            renderer.adjust(adjustments)
        self._pixels = pixels

    def are_open_for(self, pixels: PixelFormat) -> bool:
        return self._pixels == pixels

    def adjust(self, adjustments: Adjustments) -> None:
        """Apply the viewer's settings from the next picture on."""
        for renderer in self._each():
            renderer.adjust(adjustments)

    def replace(self, renderer: AnyRenderer, adjustments: Adjustments) -> None:
        """Switch to another renderer once it has drawn a frame (`took_over`)."""
        try:
            if self._pixels is not None:
                renderer.open(self._pixels)
            renderer.adjust(adjustments)
        except BaseException:
            renderer.release()
            raise
        if self._incoming is not None:
            self._incoming.release()
        self._incoming = renderer

    def took_over(self, draw: Callable[[AnyRenderer], None]) -> bool:
        """Draw a frame with the reloaded renderer, if any. Return whether it has replaced the old renderer."""
        incoming, self._incoming = self._incoming, None
        if incoming is None:
            return False
        try:
            draw(incoming)
        except Exception as error:  # an edited shader can fail in any way
            incoming.release()
            self._notice(not_reloaded(error))
            return False
        self.current.release()
        self.current = incoming
        give_back()
        return True

    def release(self) -> None:
        for renderer in self._each():
            renderer.release()
        self._incoming = None


def not_reloaded(error: Exception) -> str:
    """Return a line with the reason why the old maps and shaders stay."""
    known = isinstance(error, InputError | OSError | RuntimeError)
    return f"not reloaded: {' '.join((str(error) if known else repr(error)).split())}"
