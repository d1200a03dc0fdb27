"""Text and lines over the picture: messages, pages of keys and statistics, and the outline during placing."""

from dataclasses import replace

from counterlight.overlay.osd import MESSAGE_SIZE, Legend, Page, pages
from counterlight.overlay.outline import Outline
from counterlight.pipeline.views import CLIPPING_LEGEND, LEGENDS, RIGHT
from counterlight.show.keys import Keys
from counterlight.show.session import Session
from counterlight.show.stats_page import stats_page

PAGE_INTERVAL_S = 0.2


class Overlay:
    """The page over a session's picture."""

    def __init__(self, session: Session, keys: Keys) -> None:
        self._session, self._keys = session, keys
        self._statistics: Page | None = None
        self._measured_at = float("-inf")
        self._outlined: tuple[object, Outline] | None = None

    def page(self) -> Page | None:
        """Return the page over the picture now. The page is the same object while nothing changes."""
        page, outline = self._text(), self._outline()
        return page if outline is None else replace(page or Page(()), outline=outline)

    def _outline(self) -> Outline | None:
        """Return the outline of the placed picture, reused until the corners, the view or the room change."""
        session = self._session
        placing, view = session.placing, session.view
        if placing is None:
            return None
        key = placing.corners, placing.corner, view == "projector", session.renderer
        if self._outlined is None or self._outlined[0] != key:
            self._outlined = key, session.room.outline(placing.corners, placing.corner, view)
        return self._outlined[1]

    def _text(self) -> Page | None:
        """Return the text over the picture. The statistics change at most once per PAGE_INTERVAL_S."""
        session = self._session
        text, opacity = session.message.text, session.message.opacity
        if session.help_page:
            help_pages = pages(tuple(self._keys.help_cells(placing=session.placing is not None)), session.display.size)
            if session.help_page <= len(help_pages):
                return help_pages[session.help_page - 1]
            session.help_page = 0
        if session.show_stats and session.playback is not None:
            if self._statistics is None or session.clock() - self._measured_at >= PAGE_INTERVAL_S:
                self._statistics, self._measured_at = stats_page(session, text), session.clock()
            return self._statistics
        legends = self._legends()
        if session.placing is not None:
            line = f"placing the {session.placing.selected}; ? lists the keys"
            return Page((line, *([text] if text else [])), legends=legends)
        if not session.writes:
            return None
        if legends:
            return Page((text,) if text else (), legends=legends)
        return Page((text,), opacity=opacity, size=MESSAGE_SIZE) if text else None

    def _legends(self) -> tuple[Legend, ...]:
        """Return the meaning of the view's colours."""
        session = self._session
        showing = session.adjustments.card is None and session.rendered and not session.blackout
        if not session.writes or not showing:
            return ()
        compensated = session.compensation or session.view != "projector"
        clipping = (
            CLIPPING_LEGEND if session.adjustments.clipping and compensated and session.view != "impossible" else ()
        )
        expected = ((RIGHT, session.room.expected),) if session.view == "error" and session.room.expected else ()
        return tuple(Legend(*row) for row in (*LEGENDS.get(session.view, ()), *expected, *clipping))
