"""Table 6.1 of the thesis, row by row, next to this program's figures for the same scenes."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.solve.box import Box
from counterlight.tools.study.measure import THESIS_LABEL, RoomFigures, study_room
from counterlight.tools.study.methods import CUT, PLAIN, TRIANGULATED, Map, Method, Solver
from counterlight.tools.study.pictures import Picture, find_pictures
from counterlight.tools.study.questions.acquiring import HIERARCHICAL, MULTIPLEXED, Way, acquire_again, tier_of_acquired
from counterlight.tools.study.results import Row, label
from counterlight.tools.study.rooms import StudyRoom, Task, processor_seconds, simulated_room
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.transport import CHANNELS

CAMERA, PROJECTOR = (480, 640), (512, 512)  # sizes of thesis 4.2 and 5.2
FOCUS_CAMERA, FOCUS_PROJECTOR = (48, 48), (52, 52)  # 4.3.3 solves about 2304 equations for 2700 unknowns


@dataclass(frozen=True)
class ThesisRow:
    """A row of Table 6.1, in the thesis' words.

    scene : the shipped scene that represents the scene of the row.
    """

    scene: str
    words: str
    pictures: int
    acquisition: str
    nnls: str
    inverse: str
    frames_per_second: str


FROM_DIRECT = Map("steps from direct mapping", "steps", 4, InverseOptions(inverse="none"), steps=4, start="direct")
METHODS: tuple[Method, ...] = (Solver("nnls", "NNLS"), TRIANGULATED, PLAIN, FROM_DIRECT, CUT)
HEADER = (
    "scene",
    "captured",
    "time for it",
    "NNLS picture",
    "T⁺",
    "frames/s",
    "ours: camera, projector",
    "simulated in",
    *(f"acquired ({way.words}, simulated): pictures; computed; below optimum" for way in (MULTIPLEXED, HIERARCHICAL)),
    "NNLS picture",
    "direct, triangulated: computed; frame; below optimum",
    "T⁺ as the thesis: computed; frame; below optimum",
    f"direct mapping, {FROM_DIRECT.steps} steps: computed; frame; below optimum",
    f"T⁺ damped, {CUT.steps} steps: computed; frame; below optimum",
)
DIFFERENCES = (
    "The thesis' figures are from 2006: a Pentium 4 of 3 GHz with 2 to 4 GB, a GeForce 7900 GTX, wall-clock time.",
    "Ours are of simulated scenes that resemble the thesis', not of its captures. Acquired: by a camera that "
    "is simulated in the scene (14 bits, 20 000 electrons, one shot), seconds are those of simulating its pictures and "
    "solving for T, not of showing them; below the optimum is what the best drive by that T is in the scene.",
    "Ours are processor seconds, all cores together, and processor milliseconds where OpenGL runs in software: what "
    "one core alone would take. On n cores it is up to n times less, on a graphics card far less.",
    "Below optimum: PSNR in the camera's eyes, through the undecomposed T, below the best picture that a projector can "
    "show (a photograph). The thesis states no errors.",
    "NNLS: the thesis cuts T into clusters (4.3.2 and 4.3.3: parts of the picture, uncut); ours is uncut and whole.",
)
THESIS_ROWS = (
    ThesisRow("skull", "dinosaur skull (3.4.2)", 205, "6 h", "n.a.", "n.a.", "n.a."),
    ThesisRow("wall", "simple wall (6.1)", 281, "4.5 h", "1 min", "8 min", "30"),
    ThesisRow("statuette", "David statuette and wall (4)", 813, "4 h", "3 min", "15 min", "7"),
    ThesisRow("glass", "glass and wallpaper (4.3.1)", 1129, "5 h", "3 min", "13 min", "25"),
    ThesisRow("folded_cards", "diffuse scattering, inter-reflections (4.3.2)", 2645, "9 h", "1 h", "n.a.", "n.a."),
    ThesisRow("two_planes", "focus compensation (4.3.3)", 257, "2 h", "25 min", "n.a.", "n.a."),
)


@dataclass(frozen=True)
class Spent:
    """Cost and quality of a method.

    computed_s : processor seconds.
    pictures : number of pictures that an acquisition shows.
    frame_ms : time per frame in the player; processor time without a GPU.
    below_db : decibels of PSNR below the box optimum.
    """

    computed_s: float
    below_db: float
    pictures: int | None = None
    frame_ms: float | None = None

    def __str__(self) -> str:
        between = [] if self.pictures is None else [f"{self.pictures}"]
        after = [] if self.frame_ms is None else [f"{self.frame_ms:.3g} ms"]
        return "; ".join([*between, _seconds(self.computed_s), *after, f"{self.below_db:.2f} dB"])


@dataclass(frozen=True)
class OurRow:
    """This program's figures for a scene, in processor time; None, or a reason, where a method does not suit the room.

    acquired, by_hierarchy : T acquired by a simulated camera, by the multiplexed and by the thesis' scheme.
    nnls_s : time for one picture, with the whole T.
    direct : triangulated direct mapping.
    thesis : T⁺ as the thesis computes it, plain and cut.
    stepped : refined in every frame, from direct mapping.
    ours : refined in every frame, from T⁺ damped and cut.
    """

    scene: str
    camera: str
    projector: str
    simulation_s: float
    acquired: Spent | None
    by_hierarchy: Spent | None
    nnls_s: float | None
    direct: Spent | None
    thesis: Spent | str | None
    stepped: Spent | None
    ours: Spent | None


def table_row(figures: RoomFigures, multiplexed: Spent | None = None, hierarchical: Spent | None = None) -> OurRow:
    """Returns a row from the first picture that was studied in a room."""
    first = {row.label: row for row in reversed(figures.rows)}
    nnls, direct, thesis, *others = (first.get(label(m.family, m.knob, m.value)) for m in METHODS)
    refused = next((entry.reason for entry in figures.skipped if entry.method == THESIS_LABEL), None)
    return OurRow(
        figures.name,
        str(figures.facts["camera"]),
        str(figures.facts["projector"]),
        float(figures.facts["simulation_s"]),
        multiplexed,
        hierarchical,
        None if nnls is None else nnls.cpu_s,
        _played(direct),
        _played(thesis) or refused,
        *map(_played, others),
    )


def _played(row: Row | None) -> Spent | None:
    return None if row is None else Spent(row.preparation_s, row.below_optimum_db, frame_ms=row.frame_ms)


def acquired(room: StudyRoom, picture: Picture, way: Way) -> Spent:
    """Acquire the room with a simulated camera; returns the cost, and the quality of the resulting best drive."""
    again, seconds = processor_seconds(lambda: acquire_again(room.calibration, room.transport, way))
    tier, task = tier_of_acquired(room.calibration, again), Task(room, picture)
    box = Box(objective_of(tier.transport, tier.calibration, DEFAULT_AIMS))
    drive = box.solve(tier.target(task.desired).reshape(-1, len(CHANNELS))).drive
    return Spent(seconds, task.judge(drive).below_optimum, again.pictures)


def scenes_of_the_table() -> list[str]:
    """Returns the scenes of the table that are shipped."""
    return [row.scene for row in THESIS_ROWS if row.scene in shipped_scenes()]


def measure_at_thesis_size(scene: str, picture: str) -> OurRow:
    """Measure one scene of the table.

    picture : name of the picture.
    """
    camera, projector = (FOCUS_CAMERA, FOCUS_PROJECTOR) if scene == "two_planes" else (CAMERA, PROJECTOR)
    resized = load_scene(shipped_scenes()[scene]).resized(camera, projector)
    with closing(simulated_room(resized, scene)) as room:
        (shown,) = find_pictures([picture])
        figures = study_room(room, [shown], METHODS)
        return table_row(figures, *(acquired(room, shown, way) for way in (MULTIPLEXED, HIERARCHICAL)))


def to_markdown(ours: Sequence[OurRow]) -> str:
    """Returns the table in Markdown."""
    by_scene = {row.scene: row for row in ours}
    lines = [f"| {' | '.join(HEADER)} |", "|---" * len(HEADER) + "|"]
    lines += [f"| {' | '.join(cells(row, by_scene.get(row.scene)))} |" for row in THESIS_ROWS]
    return "\n".join(lines) + "\n"


def cells(thesis: ThesisRow, ours: OurRow | None) -> list[str]:
    """Returns the cells of one scene, in the order of HEADER."""
    words = [thesis.words, f"{thesis.pictures} HDR", thesis.acquisition, thesis.nnls, thesis.inverse]
    words.append(thesis.frames_per_second)
    if ours is None:
        return [*words, *["not studied"] * (len(HEADER) - len(words))]
    return [
        *words,
        f"{ours.camera}, {ours.projector}",
        _seconds(ours.simulation_s),
        _spent(ours.acquired),
        _spent(ours.by_hierarchy),
        _seconds(ours.nnls_s),
        *map(_spent, (ours.direct, ours.thesis, ours.stepped, ours.ours)),
    ]


def _seconds(value: float | None) -> str:
    return "n.a." if value is None else f"{value:.3g} s"


def _spent(way: Spent | str | None) -> str:
    if way is None:
        return "n.a."
    return str(way) if isinstance(way, Spent) else f"n.a.: {way.split(';')[0]}"
