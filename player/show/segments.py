"""Where a film can be divided, so that its segments may be rendered in parallel.

A frame depends on the frame before: refinement uses its change and momentum, adaptation and damping use their own
state. At a cut (SceneCuts) this state is reset. A segment that begins at a cut therefore equals the same frames of the
whole film, bit for bit. A segment that begins within a shot differs, however early its drawing begins: the old state
fades, but float32 results stay different (docs/size.md).
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
    """The frames of a film.

    times_s : due time of each frame.
    cuts : numbers of the frames that begin a shot, 0 first.
    """

    times_s: tuple[float, ...]
    cuts: tuple[int, ...]


def look_through(reader: MediaReader, frames: int | None) -> Film:
    """Decode at most `frames` frames and find the cuts. Raises InputError for a film that breaks off."""
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
    """Divide the film into at most `count` stretches of similar length.

    carries : whether frames depend on the frames before. A stretch then begins at a cut, at most half a stretch away
        from the ideal place.
    lead_in : frames that are drawn before a stretch that does not begin at a cut; None allows only stretches at cuts.
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
    """Whether drawing starts at a cut, so that the stretch's frames equal the frames of the whole film."""
    return stretch.lead in film.cuts


def within_shots(stretches: Sequence[Stretch], film: Film) -> list[int]:
    """Return the numbers of the stretches that begin within a shot."""
    return [number for number, stretch in enumerate(stretches) if not begins_at_cut(stretch, film)]
