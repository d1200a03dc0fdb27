"""A whole study: every room in turn, then the report, written as a folder that appears complete."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from counterlight.errors import InputError
from counterlight.jobs.workers import Here, Workers
from counterlight.tools.study import page
from counterlight.tools.study.frames import graphics, in_software
from counterlight.tools.study.jobs import RoomSource, study_rooms, thesis_rows
from counterlight.tools.study.measure import NNLS_LABEL, OURS_LABEL, THESIS_LABEL, RoomFigures
from counterlight.tools.study.pictures import anywhere
from counterlight.tools.study.questions.room_answers import RoomAnswers, answered
from counterlight.tools.study.recommend import Wish, wishes
from counterlight.tools.study.results import Mean, Row, everywhere, write_csv, write_json
from counterlight.tools.study.table_6_1 import OurRow, table_row, to_markdown
from counterlight.writing.outputs import check_folder, is_vacant, refuse_strangers
from counterlight.writing.replacing import replacing_folder

CSV, JSON, PAGE, SUMMARY, TABLE = "results.csv", "results.json", "report.html", "summary.md", "table_6_1.md"
SOFTWARE_NOTE = "OpenGL runs on the processor here: milliseconds are of processor time, all cores together."
HARDWARE_NOTE = "Milliseconds are wall-clock medians."
HEADER = (
    "| method | dB below the best | worst room | RMSE, % of white | SSIM | CIEDE2000 | clipped, % | ms a picture "
    "| MiB of maps | preparation, s |\n|---|---|---|---|---|---|---|---|---|---|\n"
)


@dataclass(frozen=True)
class StudyOptions:
    """Options of a study.

    places : scenes and calibrations.
    pictures : names.
    size : (height, width) into which a scene's camera is fitted.
    patience_s : see jobs.study_rooms.
    table_6_1 : also measure the thesis' scenes at the sizes of the thesis.
    colour : one of choices.COLOURS.
    """

    places: Sequence[Path]
    pictures: Sequence[str]
    size: tuple[int, int]
    patience_s: float
    table_6_1: bool = False
    colour: str = "auto"


def check_output(folder: Path) -> None:
    """Check the output folder and matplotlib before the long work.

    Raises InputError if the folder holds anything but a study's report, or if matplotlib is missing.
    """
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


def run_study(options: StudyOptions, folder: Path, workers: Workers | None = None) -> Iterator[str]:
    """Run a study, write the report to `folder` and yield the lines to print.

    workers : processes that open rooms and try methods; None for this process.
    """
    check_output(folder)
    with replacing_folder(folder, _refuse_other) as stage:
        yield from _study(options, stage, workers)
    yield f"report: {folder / PAGE}"


def _study(options: StudyOptions, stage: Path, workers: Workers | None) -> Iterator[str]:
    yield f"OpenGL: {graphics()}"
    figures: list[RoomFigures] = []
    asked: list[RoomAnswers] = []
    settings = options.size, options.colour, anywhere(options.pictures), graphics()
    sources = [RoomSource(place.absolute(), *settings) for place in options.places]
    # Without workers, rooms follow each other, so that each is opened once; with workers, all at the same time.
    for some in [sources] if workers else [[source] for source in sources]:
        for found in study_rooms(some, options.patience_s, workers or Here()):
            figures.append(found)
            count = len(found.skipped)
            left_out = f", {count} method{'' if count == 1 else 's'} not for it" if count else ""
            yield f"{found.name}: {len(found.rows)} figures{left_out}"
            if found.tried is not None:
                asked.append(answered(found.name, found.tried, found.rows))
                yield asked[-1].verdict
                yield from (f"{question.title}: {question.verdict}" for question in asked[-1].questions)
    table = [table_row(found) for found in figures]
    if options.table_6_1:
        table = thesis_rows(anywhere(options.pictures)[0], workers or Here())
        yield from (f"{row.scene} at {row.camera}, {row.projector}: measured for Table 6.1" for row in table)
    yield from write_study(stage, figures, table, asked)


def write_study(
    stage: Path, figures: Sequence[RoomFigures], table: Sequence[OurRow], asked: Sequence[RoomAnswers] = ()
) -> list[str]:
    """Write all files of a report into an existing folder; returns the advice, one line per wish."""
    from counterlight.tools.study.plots import draw_all
    from counterlight.tools.study.questions.page import draw

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
    (stage / SUMMARY).write_text(mean_tables(rows, averages, advice), encoding="utf-8")
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


def mean_tables(rows: Sequence[Row], averages: Sequence[Mean], advice: Sequence[Wish]) -> str:
    """Returns a line per method that was used in every room, and a line per wish.

    averages : means of those methods.
    """
    methods = "".join(_line(point, [row for row in rows if row.label == point.label]) for point in averages)
    wishes = "".join(
        f"| {wish.words} | `{wish.method.command if wish.method else 'none'}` | {wish.why} |\n" for wish in advice
    )
    return f"{HEADER}{methods}\n| you want | options | here |\n|---|---|---|\n{wishes}"


def _line(point: Mean, rows: Sequence[Row]) -> str:
    rmse, ssim, clipped = (np.mean([getattr(row, name) for row in rows]) for name in ("rmse", "ssim", "clipped"))
    costs = " | ".join(_short(value) for value in (point.picture_ms, point.map_mib, point.preparation_s))
    return (
        f"| {point.label}{'' if point.played else ' (solver)'} | {point.below_optimum_db:.2f} | {point.worst_db:.2f} "
        f"| {100 * rmse:.2f} | {ssim:.3f} | {point.ciede2000:.2f} | {100 * clipped:.1f} | {costs} |\n"
    )


def _short(value: float | None) -> str:
    return "–" if not value else f"{value:.2g}" if value < 100 else f"{value:.0f}"
