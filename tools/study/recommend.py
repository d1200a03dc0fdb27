"""Advice from figures: three wishes, and the method that fulfils each, on average over the rooms of a study."""

from collections.abc import Sequence
from dataclasses import dataclass

from counterlight.tools.study.results import Mean, visible_db
from counterlight.tools.study.tables import number

CLOSE_DB = 1.0
FRAME_MS = 1000 / 60


@dataclass(frozen=True)
class Wish:
    """A user's wish and the method for it.

    words : the wish.
    method : the best method; None if no method of the player fulfils the wish.
    why : the figures.
    """

    words: str
    method: Mean | None
    why: str


def wishes(points: Sequence[Mean]) -> list[Wish]:
    """Returns three wishes: fastest within CLOSE_DB of the optimum, best at 60 frames per second, best at any price.

    points : methods that were used in every room.
    """
    playable = [point for point in points if point.played and point.picture_ms is not None]
    close = [point for point in playable if point.below_optimum_db <= CLOSE_DB]
    smooth = [point for point in playable if _ms(point) <= FRAME_MS]
    return [
        _wish(f"fastest within {CLOSE_DB:g} dB of the optimum", min(close, key=_ms, default=None)),
        _wish("best picture at 60 frames a second", min(smooth, key=_error, default=None)),
        _wish("best picture at any price", min(playable, key=_error, default=None)),
    ]


def _ms(point: Mean) -> float:
    return float("inf") if point.picture_ms is None else point.picture_ms


def _error(point: Mean) -> tuple[float, float]:
    return visible_db(point), _ms(point)


def _wish(words: str, found: Mean | None) -> Wish:
    if found is None:
        return Wish(words, None, "no method that plays reaches this here")
    why = (
        f"{found.below_optimum_db:.2f} dB below the optimum on average, {found.worst_db:.2f} in the worst room; "
        f"{number(_ms(found))} ms a frame, {number(found.preparation_s)} s of preparation"
    )
    return Wish(words, found, why)
