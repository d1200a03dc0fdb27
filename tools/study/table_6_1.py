"""Table 6.1 of the thesis, row by row, beside what this program takes for the same scenes."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.study.measure import RoomFigures, study_room
from counterlight.tools.study.methods import CUT, PLAIN, Method, Solver
from counterlight.tools.study.pictures import find_pictures
from counterlight.tools.study.results import label
from counterlight.tools.study.rooms import simulated_room

CAMERA, PROJECTOR = (480, 640), (512, 512)  # the sizes that 4.2 and 5.2 name
FOCUS_CAMERA, FOCUS_PROJECTOR = (48, 48), (52, 52)  # 4.3.3 solves about 2304 equations for 2700 unknowns


@dataclass(frozen=True)
class ThesisRow:
    """A row of Table 6.1, in its words; scene : the shipped scene that stands for it."""

    scene: str
    words: str
    pictures: int
    acquisition: str
    nnls: str
    inverse: str
    frames_per_second: str


METHODS: tuple[Method, ...] = (Solver("nnls", "NNLS"), PLAIN, CUT)
HEADER = (
    "scene",
    "captured",
    "time for it",
    "NNLS picture",
    "T⁺",
    "frames/s",
    "ours: camera, projector",
    "simulated in",
    "NNLS picture",
    "T⁺ as the thesis: computed; frame; below optimum",
    f"T⁺ damped, {CUT.steps} steps: computed; frame; below optimum",
)
DIFFERENCES = (
    "The thesis' figures are from 2006: a Pentium 4 of 3 GHz with 2 to 4 GB, a GeForce 7900 GTX, wall-clock time.",
    "Ours are of simulated scenes that resemble the thesis', not of its captures; no acquisition took place, so its "
    "column is the simulation's time.",
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
class OurRow:
    """Ours for a scene. Times are processor time; None where a method is not for the room.

    simulation_s : in place of an acquisition.  nnls_s : a picture, T whole.  thesis_… : T⁺ as the thesis computes it,
    plain and cut.  ours_… : damped, cut, and refined in every frame.  …_s : computing it.  …_ms : a frame on the GPU.
    …_db : PSNR below the box optimum.
    """

    scene: str
    camera: str
    projector: str
    simulation_s: float
    nnls_s: float | None
    thesis_s: float | None
    thesis_ms: float | None
    thesis_db: float | None
    ours_s: float | None
    ours_ms: float | None
    ours_db: float | None


def table_row(figures: RoomFigures) -> OurRow:
    """A row from the first picture that was studied in a room."""
    first = {row.label: row for row in reversed(figures.rows)}
    nnls, thesis, ours = (first.get(label(m.family, m.knob, m.value)) for m in METHODS)
    return OurRow(
        figures.name,
        str(figures.facts["camera"]),
        str(figures.facts["projector"]),
        float(figures.facts["simulation_s"]),
        None if nnls is None else nnls.cpu_s,
        None if thesis is None else thesis.preparation_s,
        None if thesis is None else thesis.gl_ms,
        None if thesis is None else thesis.below_optimum_db,
        None if ours is None else ours.preparation_s,
        None if ours is None else ours.gl_ms,
        None if ours is None else ours.below_optimum_db,
    )


def scenes_of_the_table() -> list[str]:
    """Those that are shipped."""
    return [row.scene for row in THESIS_ROWS if row.scene in shipped_scenes()]


def measure_at_thesis_size(scene: str, picture: str) -> OurRow:
    """One of them.  picture : by name."""
    camera, projector = (FOCUS_CAMERA, FOCUS_PROJECTOR) if scene == "two_planes" else (CAMERA, PROJECTOR)
    resized = load_scene(shipped_scenes()[scene]).resized(camera, projector)
    with closing(simulated_room(resized, scene)) as room:
        return table_row(study_room(room, find_pictures([picture]), METHODS))


def to_markdown(ours: Sequence[OurRow]) -> str:
    """The table in Markdown."""
    by_scene = {row.scene: row for row in ours}
    lines = [f"| {' | '.join(HEADER)} |", "|---" * len(HEADER) + "|"]
    lines += [f"| {' | '.join(cells(row, by_scene.get(row.scene)))} |" for row in THESIS_ROWS]
    return "\n".join(lines) + "\n"


def cells(thesis: ThesisRow, ours: OurRow | None) -> list[str]:
    """Of one scene, in the order of HEADER."""
    words = [thesis.words, f"{thesis.pictures} HDR", thesis.acquisition, thesis.nnls, thesis.inverse]
    words.append(thesis.frames_per_second)
    if ours is None:
        return [*words, *["not studied"] * (len(HEADER) - len(words))]
    return [
        *words,
        f"{ours.camera}, {ours.projector}",
        _seconds(ours.simulation_s),
        _seconds(ours.nnls_s),
        f"{_seconds(ours.thesis_s)}; {_milliseconds(ours.thesis_ms)}; {_decibels(ours.thesis_db)}",
        f"{_seconds(ours.ours_s)}; {_milliseconds(ours.ours_ms)}; {_decibels(ours.ours_db)}",
    ]


def _seconds(value: float | None) -> str:
    return "n.a." if value is None else f"{value:.3g} s"


def _milliseconds(value: float | None) -> str:
    return "n.a." if value is None else f"{value:.3g} ms"


def _decibels(value: float | None) -> str:
    return "n.a." if value is None else f"{value:.2f} dB"
