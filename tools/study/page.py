"""The study's report: the order of figures, their captions, and the recommendations."""

from collections.abc import Sequence
from html import escape
from typing import Any

from counterlight.tools.report.page import Figure, Section, page
from counterlight.tools.study.questions import page as questions_page
from counterlight.tools.study.questions.room_answers import RoomAnswers
from counterlight.tools.study.recommend import Wish
from counterlight.tools.study.results import Mean, Row, Skipped, pareto
from counterlight.tools.study.table_6_1 import DIFFERENCES, HEADER, THESIS_ROWS, OurRow, cells
from counterlight.tools.study.tables import html_table, number

FORMULAS = (
    "All compare what the camera sees, c = T p + e through the whole, undecomposed T with its far light, with the "
    "desired radiance, over the lit camera pixels. RMSE and PSNR are of linear radiance relative to white. SSIM "
    "(Wang et al. 2004, Gaussian window, σ = 1.5) is of sRGB code values; CIEDE2000 (Sharma et al. 2005) in CIE Lab "
    "under D65. “Below the optimum” is PSNR below that of the best picture that a projector can show (box optimum, "
    "relative gap 1e-4); “certified” is the most that this can be, from the gradient at the drive, without the optimum."
)


def study_page(
    facts: dict[str, Any],
    rows: Sequence[Row],
    averages: Sequence[Mean],
    skipped: Sequence[Skipped],
    files: dict[str, str],
    advice: Sequence[Wish],
    table: Sequence[OurRow],
    asked: Sequence[RoomAnswers] = (),
) -> str:
    """Returns the whole document; answers about the user's own rooms come first.

    averages : means of the methods used in every room.
    files : file names of pictures by content.
    """
    rooms = list(dict.fromkeys(row.room for row in rows))
    pictures = list(dict.fromkeys(row.picture for row in rows))
    intro = (
        f"<p>{_counted(averages, 'method')} in {_counted(rooms, 'room')} ({escape(', '.join(rooms))}) "
        f"on {_counted(pictures, 'picture')} ({escape(', '.join(pictures))}). "
        f"OpenGL: {escape(facts['opengl'])}; {facts['cores']} cores. "
        f"{escape(facts['time_note'])}</p>"
    )
    sections = [
        *questions_page.headed(asked, files),
        _overview(files, averages),
        _knobs(files),
        _pictures(rooms, files),
    ]
    sections += [_thesis(files), _table_6_1(table), _tables(rooms, rows, facts), *_skipped(skipped), _advice(advice)]
    return page("What accuracy costs in time", intro, sections)


def _counted(things: Sequence[object], what: str) -> str:
    return f"{len(things)} {what}{'' if len(things) == 1 else 's'}"


def _overview(files: dict[str, str], averages: Sequence[Mean]) -> Section:
    wide = "Each mark is a method: decibels averaged over pictures and rooms, costs as their geometric mean. "
    figures = [
        Figure(
            "Error against time",
            wide + "Lower left is better; on the black line nothing is both faster and better. Hollow marks solve one "
            "picture at a time on the CPU.",
            file=files["time"],
        ),
        Figure(
            "Error against map size",
            wide + "What a frame reads is what a graphics card has to hold.",
            file=files["size"],
        ),
        Figure("Error against preparation", wide + "Once per room.", file=files["preparation"]),
    ]
    if "rooms" in files:
        figures.append(
            Figure(
                "Error against time, room by room", "Methods that a room is not for are missing.", file=files["rooms"]
            )
        )
    front = {
        point.label for point in pareto([point for point in averages if point.played], lambda point: point.picture_ms)
    }
    table = _mean_table(averages, front)
    return Section("What accuracy costs", figures, f"<p class='note'>{FORMULAS}</p>{table}", wide=True)


def _knobs(files: dict[str, str]) -> Section:
    caption = (
        "Thin lines are rooms, thick ones the mean of the rooms in which every value was tried. Truncation and cutting "
        "make maps small, damping protects from the clamp, refinement pays with time in every frame."
    )
    return Section("Knobs", [Figure("Error against each knob", caption, file=files["knobs"])], wide=True)


def _pictures(rooms: Sequence[str], files: dict[str, str]) -> Section:
    caption = (
        "In the camera's view, and the error below: black is none, bright yellow a quarter of white or more. White is "
        "what nine in ten pixels can reach, so the uncompensated picture is brighter: the exposure is the same."
    )
    shown = [Figure(room, caption, file=files[f"sheet {room}"]) for room in rooms]
    return Section("What a decibel looks like", shown, wide=True)


def _thesis(files: dict[str, str]) -> Section:
    figures = []
    if "figure 5.2" in files:
        figures.append(
            Figure(
                "Counterpart of Figure 5.2, GPU against CPU",
                "The same picture solved by NNLS and multiplied by T⁺, then in grey, and the lowest quarter of their "
                "difference stretched, as the thesis shows it.",
                file=files["figure 5.2"],
            )
        )
    if "figure 6.1" in files:
        figures.append(
            Figure(
                "Counterpart of Figure 6.1, direct against global",
                "On a matt wall the two are comparable, as the thesis finds; below, a detail.",
                file=files["figure 6.1"],
            )
        )
    return Section("The thesis' figures", figures, wide=True)


def _table_6_1(ours: Sequence[OurRow]) -> Section:
    by_scene = {row.scene: row for row in ours}
    body = [cells(row, by_scene.get(row.scene)) for row in THESIS_ROWS]
    notes = "".join(f"<li>{escape(words)}</li>" for words in DIFFERENCES)
    return Section("Table 6.1, row by row", [], html_table(HEADER, body) + f"<ul class='note'>{notes}</ul>")


def _tables(rooms: Sequence[str], rows: Sequence[Row], facts: dict[str, Any]) -> Section:
    """Returns every figure of the first picture; results.csv holds the figures of all pictures."""
    parts = []
    for room in rooms:
        here = [row for row in rows if row.room == room]
        first = [row for row in here if row.picture == here[0].picture]
        about = ", ".join(f"{key.replace('_', ' ')} {number(value)}" for key, value in facts["rooms"][room].items())
        head = f"<summary>{escape(room)}: {escape(here[0].picture)}</summary><p class='note'>{escape(about)}</p>"
        parts.append(f"<details>{head}{html_table(ROW_HEADER, [_row(row) for row in first])}</details>")
    return Section("Every figure", [], "".join(parts) + "<p class='note'>All pictures: results.csv, results.json.</p>")


def _skipped(skipped: Sequence[Skipped]) -> list[Section]:
    if not skipped:
        return []
    body = [[entry.room, entry.method, entry.reason] for entry in skipped]
    return [Section("Not tried", [], html_table(("room", "method", "why"), body))]


def _advice(advice: Sequence[Wish]) -> Section:
    body = [
        [wish.words, wish.method.label if wish.method else "none", wish.method.command if wish.method else "", wish.why]
        for wish in advice
    ]
    note = "<p class='note'>Measured at the sizes above: a frame's milliseconds grow with the number of pixels.</p>"
    return Section("Recommended", [], html_table(("wish", "method", "commands", "here"), body) + note)


def _mean_table(averages: Sequence[Mean], front: set[str]) -> str:
    header = (
        "method",
        "dB below optimum",
        "worst room",
        "CIEDE2000",
        "ms a picture",
        "by",
        "MiB of maps",
        "preparation, s",
        "",
    )
    body = [
        [
            point.label,
            f"{point.below_optimum_db:.2f}",
            f"{point.worst_db:.2f}",
            f"{point.ciede2000:.2f}",
            number(point.picture_ms),
            "player" if point.played else "solver",
            number(point.map_mib),
            number(point.preparation_s or None),
            "Pareto" if point.label in front else "",
        ]
        for point in sorted(averages, key=lambda point: point.below_optimum_db)
    ]
    return html_table(header, body)


ROW_HEADER = (
    "method",
    "RMSE, % of white",
    "PSNR, dB",
    "SSIM",
    "CIEDE2000",
    "clipped, %",
    "below optimum, dB",
    "certified, dB",
    "bound, codes",
    "preparation, s",
    "solver, s",
    "player, ms",
    "MiB",
)


def _row(row: Row) -> list[str]:
    return [
        row.label,
        f"{100 * row.rmse:.3f}",
        f"{row.psnr_db:.2f}",
        f"{row.ssim:.4f}",
        f"{row.ciede2000:.2f}",
        f"{100 * row.clipped:.1f}",
        f"{row.below_optimum_db:.3f}",
        number(row.certified_db),
        number(row.bound_codes),
        number(row.preparation_s or None),
        number(row.cpu_s),
        number(row.frame_ms),
        number(row.map_mib),
    ]
