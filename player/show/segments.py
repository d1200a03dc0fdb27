"""Where a film can be divided, so that its segments may be rendered side by side.

A frame of compensation goes on from the one before: refinement from its change and momentum, adaptation and damping
from their own. At a cut (SceneCuts) all of it begins anew, so that a segment which begins there is what it is in the
whole, bit for bit. Within a shot it is not, however early the drawing begins: what is forgotten fades, but float32
never becomes the same again (docs/size.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from counterlight.command import track
from counterlight.errors import InputError
from counterlight.media.video import MediaReader
from counterlight.pipeline.content import SceneCuts
from counterlight.show.headless import FRAME_TIMEOUT_S
from counterlight.show.rendering import Stretch


@dataclass(frozen=True)
class Film:
    """times_s : when each frame is due.  cuts : numbers of the frames that begin anew, 0 first."""

    times_s: tuple[float, ...]
    cuts: tuple[int, ...]


def look_through(reader: MediaReader, frames: int | None) -> Film:
    """Decode up to so many frames; InputError for a film that breaks off."""
    times_s, cuts, finder = list[float](), list[int](), SceneCuts()
    for number in track(range(1 << 62 if frames is None else frames), "looking for cuts", frames):
        frame = reader.next_frame(FRAME_TIMEOUT_S)
        if frame is None:
            break
        if finder.starts_with(frame):
            cuts.append(number)
        times_s.append(frame.time_s)
        reader.release(frame)
    if not times_s:
        raise InputError(f"{reader.info.path}: no frame to render; check --start and --frames")
    return Film(tuple(times_s), tuple(cuts))


def divide(film: Film, count: int, *, carries: bool, lead_in: int | None) -> list[Stretch]:
    """At most `count` stretches of about the same length, which together are the film.

    carries : frames go on from those before, so that a stretch begins at a cut, at most half a stretch away from where
    it would be best.  lead_in : frames that are drawn before a stretch that has no such cut; None for none of these.
    """
    length, leads = len(film.times_s), {0: 0}
    for number in range(1, count):
        ideal = number * length // count
        cut = min(film.cuts, key=lambda cut: abs(cut - ideal))
        if not carries:
            leads[ideal] = ideal
        elif abs(cut - ideal) <= length // (2 * count):
            leads[cut] = cut
        elif lead_in is not None and ideal > 0:
            leads[ideal] = max(ideal - lead_in, max(cut for cut in film.cuts if cut <= ideal))
    begins = sorted(leads)
    return [Stretch(leads[begin], begin, end) for begin, end in zip(begins, [*begins[1:], length], strict=True)]


def begins_at_cut(stretch: Stretch, film: Film) -> bool:
    """Whether the stretch is what it is in the whole: everything since a cut is drawn."""
    return stretch.lead in film.cuts


def within_shots(stretches: Sequence[Stretch], film: Film) -> list[int]:
    """Numbers of those that begin elsewhere."""
    return [number for number, stretch in enumerate(stretches) if not begins_at_cut(stretch, film)]
