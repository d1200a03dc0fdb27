"""A whole study: every room in turn, then the report as a folder that appears whole."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from counterlight.errors import InputError
from counterlight.tools.study import page, summary
from counterlight.tools.study.frames import graphics, in_software
from counterlight.tools.study.measure import NNLS_LABEL, OURS_LABEL, THESIS_LABEL, RoomFigures, study_room
from counterlight.tools.study.methods import catalogue, uncut_knobs
from counterlight.tools.study.pictures import Picture
from counterlight.tools.study.questions.asked import Asked, ask
from counterlight.tools.study.recommend import wishes
from counterlight.tools.study.results import everywhere, write_csv, write_json
from counterlight.tools.study.rooms import open_room
from counterlight.tools.study.table_6_1 import OurRow, measure_at_thesis_size, table_row, to_markdown
from counterlight.writing.outputs import check_folder, is_vacant, refuse_strangers
from counterlight.writing.replacing import replacing_folder

CSV, JSON, PAGE, SUMMARY, TABLE = "results.csv", "results.json", "report.html", "summary.md", "table_6_1.md"
SOFTWARE_NOTE = "OpenGL runs on the processor here: milliseconds are of processor time, all cores together."
ASKED_PICTURES = 3  # of the study's, in the user's own room
HARDWARE_NOTE = "Milliseconds are wall-clock medians."


@dataclass(frozen=True)
class StudyOptions:
    """places : scenes and calibrations.  size : (height, width) that a scene's camera is fitted into.

    patience_s : see measure.study_room.  table_6_1 : also measure the thesis' scenes at its sizes.
    colour : of choices.COLOURS.
    """

    places: Sequence[Path]
    pictures: Sequence[Picture]
    size: tuple[int, int]
    patience_s: float
    table_6_1: bool = False
    colour: str = "auto"


def check_output(folder: Path) -> None:
    """InputError, before the long work, if something else than a study's report would be lost, or matplotlib lacks."""
    _refuse_other(folder)
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise InputError(
            "counterlight study draws with matplotlib, which is not installed; install it with: pip install "
            "'counterlight[study]'"
        ) from None


def _refuse_other(folder: Path) -> None:
    check_folder(folder)
    if is_vacant(folder):
        return
    if not (folder / JSON).is_file():
        raise InputError(f"{folder}: exists and is no study's report; choose another name for -o")
    refuse_strangers(folder, (CSV, JSON, PAGE, SUMMARY, TABLE, "*.png"), "a study's report")


def run_study(options: StudyOptions, folder: Path) -> Iterator[str]:
    """Study, write the report to `folder` and yield what to print, line by line."""
    check_output(folder)
    with replacing_folder(folder, _refuse_other) as stage:
        yield from _study(options, stage)
    yield f"report: {folder / PAGE}"


def _study(options: StudyOptions, stage: Path) -> Iterator[str]:
    yield f"OpenGL: {graphics()}"
    figures: list[RoomFigures] = []
    asked: list[Asked] = []
    for place in options.places:
        with closing(open_room(place, options.size, options.colour)) as room:
            found = study_room(room, options.pictures, catalogue(), uncut_knobs(), options.patience_s)
            if room.given is not None and len(room.tier.calibration.cameras) == 1:
                asked.append(ask(room, room.given, options.pictures[:ASKED_PICTURES], found.rows, options.colour))
        figures.append(found)
        yield f"{found.name}: {len(found.rows)} figures, {len(found.skipped)} methods not for it"
        if asked and asked[-1].room == found.name:
            yield asked[-1].verdict
            yield from (f"{question.title}: {question.verdict}" for question in asked[-1].questions)
    table = [table_row(found) for found in figures]
    if options.table_6_1:
        table = []
        for row in measure_at_thesis_size(options.pictures[0]):
            table.append(row)
            yield f"{row.scene} at {row.camera}, {row.projector}: measured for Table 6.1"
    yield from write_study(stage, figures, table, asked)


def write_study(
    stage: Path, figures: Sequence[RoomFigures], table: Sequence[OurRow], asked: Sequence[Asked] = ()
) -> list[str]:
    """Everything that a report holds, into an existing folder; returns the advice, a line per wish."""
    from counterlight.tools.study.plots import draw_all
    from counterlight.tools.study.questions.panels import draw

    rows = [row for found in figures for row in found.rows]
    skipped = [entry for found in figures for entry in found.skipped]
    averages = everywhere(rows)
    advice = wishes(averages)
    software = in_software()
    facts: dict[str, Any] = {
        "opengl": graphics(),
        "cores": os.cpu_count(),
        "time_note": SOFTWARE_NOTE if software else HARDWARE_NOTE,
        "rooms": {found.name: found.facts for found in figures},
        "asked": list(map(asdict, asked)),
        "recommended": [{"wish": wish.words, "method": wish.method and wish.method.label} for wish in advice],
    }
    write_csv(stage / CSV, rows)
    write_json(stage / JSON, facts, rows, skipped)
    files = draw_all(stage, rows, "processor time" if software else "wall clock") | _draw_pictures(stage, figures)
    files |= {f"asked {each.room}": draw(stage / f"asked_{each.room}.png", each) for each in asked}
    (stage / SUMMARY).write_text(summary.to_markdown(rows, averages, advice), encoding="utf-8")
    (stage / TABLE).write_text(to_markdown(table), encoding="utf-8")
    document = page.study_page(facts, rows, averages, skipped, files, advice, table, asked)
    (stage / PAGE).write_text(document, encoding="utf-8")
    return [f"{wish.words}: {wish.method.label if wish.method else 'none'} ({wish.why})" for wish in advice]


def _draw_pictures(stage: Path, figures: Sequence[RoomFigures]) -> dict[str, str]:
    from counterlight.tools.study import sheets

    files = {f"sheet {found.name}": sheets.sheet(stage / f"pictures_{found.name}.png", found) for found in figures}
    counterparts: dict[str, tuple[str, Callable[[Path, RoomFigures], str], set[str]]] = {
        "figure 5.2": ("statuette", sheets.figure_5_2, {NNLS_LABEL, THESIS_LABEL, OURS_LABEL}),
        "figure 6.1": ("wall", sheets.figure_6_1, {"direct", THESIS_LABEL, OURS_LABEL}),
    }
    for name, (wanted, draw, needed) in counterparts.items():
        able = [found for found in figures if needed <= next(iter(found.seen.values())).keys()]
        chosen = next((found for found in able if found.name == wanted), able[0] if able else None)
        if chosen is not None:
            files[name] = draw(stage / f"{name.replace(' ', '_').replace('.', '_')}.png", chosen)
    return files
