"""Renders a film in segments on several workers, and joins them into the same file that a single process would write.

    film.mkv.segments/plan.json            what is rendered, from what, and where it is divided
    film.mkv.segments/003.mkv              a lossless segment; numbered pictures: 003-%05d.png
    film.mkv.segments/003.before.png       the frame before a segment that begins within a shot, for comparison
    film.mkv.segments/003.json             written last: the segment is complete

The folder stays until the film is complete, so that the same command resumes an interrupted rendering.

A frame depends on the frame before: refinement uses its change and momentum, adaptation and damping use their own
state. At a cut (SceneCuts) this state is reset. A segment that begins at a cut therefore equals the same frames of the
whole film, bit for bit. A segment that begins within a shot differs, however early its drawing begins: the old state
fades, but float32 results stay different (docs/size.md).
"""

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from counterlight.command import tell, track
from counterlight.errors import InputError
from counterlight.jobs.workers import Workers
from counterlight.media.video import MediaReader
from counterlight.pipeline.content import SceneCuts
from counterlight.show.compiling import compile_passes
from counterlight.show.governor import Governor
from counterlight.show.headless import FRAME_TIMEOUT_S, headless_renderer, render_to_file
from counterlight.show.output import USUAL, Coding, FilmOutput, open_output, read_written
from counterlight.show.rendering import Rendering, Stretch
from counterlight.show.stats import Stats
from counterlight.viewpoints import calibrations_in
from counterlight.writing.numbered import is_numbered, number_of
from counterlight.writing.outputs import is_vacant, refuse_strangers
from counterlight.writing.replacing import replacing_file
from counterlight.writing.stage import clean_up

FORMAT = 1
PLAN = "plan.json"
PARTS = PLAN, "[0-9]*.json", "[0-9]*.mkv", "[0-9]*.png", "[0-9]*.exr"


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


@dataclass(frozen=True)
class Segment:
    """A stretch of the film, and its files.

    output : path of the whole film.
    """

    number: int
    stretch: Stretch
    folder: Path
    output: Path

    @property
    def part(self) -> Path:
        suffix = self.output.suffix.lower()
        return self.folder / f"{self.number:03}{f'-%05d{suffix}' if is_numbered(self.output) else '.mkv'}"

    @property
    def before(self) -> Path:
        suffix = self.output.suffix.lower()
        return self.folder / f"{self.number:03}.before{suffix if is_numbered(self.output) else '.png'}"

    @property
    def record(self) -> Path:
        return self.folder / f"{self.number:03}.json"

    @property
    def facts(self) -> dict[str, Any] | None:
        """Results of rendering the segment. None if it has not been rendered."""
        return _read(self.record)


def render_segment(rendering: Rendering, segment: Segment) -> Stats:
    """Render a segment into its files, in a worker."""
    room, stretch = rendering.room(), segment.stretch
    with rendering.opened() as reader, headless_renderer(rendering.backend, room, rendering.path) as renderer:
        renderer.open(reader.info.format)
        renderer.adjust(rendering.adjustments)
        stats = render_to_file(
            reader,
            renderer,
            room.seen_from(rendering.adjustments.viewpoint),
            segment.part,
            rendering.view,
            compensate=rendering.compensate,
            governor=Governor(rendering.steps, start=room.start),
            stretch=stretch,
            before=segment.before,
            quiet=True,
        )
    expected = (stretch.end or 0) - stretch.begin
    if stats.frames != expected:
        raise InputError(f"{rendering.medium}: had {expected} frames more, now {stats.frames}; leave it as it is")
    with replacing_file(segment.record) as temporary:
        temporary.write_text(json.dumps({"frames": stats.frames, **stats.facts}), encoding="utf-8")
    return stats


def render_in_segments(
    rendering: Rendering,
    reader: MediaReader,
    output: Path,
    workers: Workers,
    count: int,
    lead_in: int | None,
    sound: Path | None = None,
    coding: Coding = USUAL,
) -> Stats:
    """Render a film in at most `count` segments. Returns all counts, and the times of the segments rendered now.

    reader : at the film's first frame.
    workers : are shut down before the function returns.
    lead_in : frames that are drawn before a segment that begins within a shot; None allows only segments at cuts.
    sound : see open_output.
    coding : see open_output.
    """
    film = look_through(reader, rendering.frames)
    stretches = divide(film, count, carries=rendering.carries, lead_in=lead_in)
    if len(stretches) < count:
        tell(_of_fewer(len(stretches), count, film, lead_in))
    folder = output.absolute().with_name(f"{output.name}.segments")
    segments = [Segment(number, stretch, folder, output) for number, stretch in enumerate(stretches)]
    within = within_shots(stretches, film) if rendering.carries else []
    with open_output(output, reader.info.frames_per_second, sound, coding) as sink:
        assert isinstance(sink, FilmOutput)
        with _kept(folder, _plan(rendering, film, stretches)), workers:
            stats = _rendered(rendering, segments, workers)
            joints = _join(sink, segments, film, within)
        stats.facts["segments"] = {"count": len(segments), "within_shots": joints}
    shutil.rmtree(folder, ignore_errors=True)
    return stats


def _of_fewer(found: int, count: int, film: Film, lead_in: int | None) -> str:
    cuts = f"{len(film.cuts) - 1} in {len(film.times_s)} frames"
    hint = "" if lead_in is not None else "; --lead-in 100 divides shots, too, where some codes may then differ"
    return f"--segments {count}: only {found}, for want of cuts ({cuts}){hint}"


def _rendered(rendering: Rendering, segments: Sequence[Segment], workers: Workers) -> Stats:
    """Render the missing segments. Returns the counts of all segments."""
    if rendering.backend == "cpu":
        compile_passes()  # once here, instead of in each worker
    stats = Stats()
    left = [segment for segment in segments if segment.facts is None]
    if len(left) < len(segments):
        tell(f"{len(segments) - len(left)} of {len(segments)} segments are there already")
    jobs = [partial(render_segment, rendering, segment) for segment in left]
    for _, part in track(workers.completed(jobs), "rendering segments", len(jobs)):
        stats.take_times(part)
    found = [segment.facts or {} for segment in segments]
    stats.frames = sum(facts["frames"] for facts in found)
    stats.facts = {name: value for name, value in found[-1].items() if name != "frames"}
    if "camera_psnr_db" in stats.facts:
        weights = [facts["frames"] for facts in found]
        stats.facts["camera_psnr_db"] = float(np.average([facts["camera_psnr_db"] for facts in found], weights=weights))
    return stats


def _join(sink: FilmOutput, segments: Sequence[Segment], film: Film, within: Sequence[int]) -> list[dict[str, Any]]:
    """Write the film. Returns where shots were divided, and how much the segments on either side differ there."""
    joints, last = list[dict[str, Any]](), None
    for segment in track(segments, "joining segments"):
        begin, end = segment.stretch.begin, segment.stretch.end
        if segment.number in within:
            joints.append({"frame": begin, **_apart(last, read_written(segment.before))})
        last = sink.append(segment.part, film.times_s[begin:end])
    return joints


def _apart(one: Any, other: Any) -> dict[str, Any]:
    difference = np.abs(np.asarray(one, np.float64) - other)
    return {"differing": int(np.count_nonzero(difference)), "of": difference.size, "most": float(difference.max())}


def _plan(rendering: Rendering, film: Film, stretches: Sequence[Stretch]) -> dict[str, Any]:
    """Return everything that determines the segments' content, for JSON."""
    made = asdict(rendering) | {"medium": _identity(rendering.medium.name)}
    folder = rendering.calibration
    room = {f"{path.relative_to(folder)}": hashlib.sha256(path.read_bytes()).hexdigest() for path in tables_of(folder)}
    text = json.dumps([made, room, asdict(film)], sort_keys=True, default=_as_text)
    digest = hashlib.sha256(text.encode()).hexdigest()
    return {"format": FORMAT, "of": digest, "stretches": [[each.lead, each.begin, each.end] for each in stretches]}


def tables_of(calibration: Path) -> list[Path]:
    """Return the .toml files of a calibration folder or of a set of views. They hold the digests of all other files."""
    rooms = dict.fromkeys([calibration, *calibrations_in(calibration)])
    folders = [folder for room in rooms for folder in (room, room / "correction", room / "drift")]
    return [path for folder in folders for path in sorted(folder.glob("*.toml"))]


def _identity(medium: str) -> list[Any]:
    """Return the path, sizes and times of a medium, which change when its content changes."""
    path = Path(medium)
    files = sorted(each for each in path.parent.iterdir() if number_of(path.name, each.name) is not None)
    states = [each.stat() for each in ([path] if path.exists() else files)]
    return [str(path.absolute()), [(state.st_size, state.st_mtime_ns) for state in states]]


def _as_text(value: Any) -> Any:
    return hashlib.sha256(value.tobytes()).hexdigest() if isinstance(value, np.ndarray) else str(value)


def _read(record: Path) -> dict[str, Any] | None:
    try:
        values = json.loads(record.read_bytes())
    except (OSError, ValueError):
        return None
    return values if isinstance(values, dict) else None


@contextmanager
def _kept(folder: Path, plan: Mapping[str, Any]) -> Iterator[None]:
    """Create the folder of the segments. If the block fails, only complete segments of this plan stay in the folder."""
    record = folder / PLAN
    there = _read(record)
    if not (is_vacant(folder) or (there and there.keys() == plan.keys())):
        raise InputError(f"{folder}: is in the way of the segments; move it away")
    if there is not None and there != plan:
        refuse_strangers(folder, PARTS, "segments")
        tell(f"{folder.name}: segments of another rendering; begun anew")
        shutil.rmtree(folder)
    folder.mkdir(exist_ok=True)
    with replacing_file(record) as temporary:
        temporary.write_text(json.dumps(plan), encoding="utf-8")
    try:
        yield
    except BaseException:
        clean_up(folder)
        whole = len(list(folder.glob("[0-9]*.json")))
        if whole:
            tell(f"{folder.name}: keeps {whole} whole segments; the same command goes on with them")
        else:
            shutil.rmtree(folder, ignore_errors=True)
        raise
