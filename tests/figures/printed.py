"""Rows whose commands print their figures in another form than the page."""

import csv
import re

from counterlight.tools.study.results import label
from tests.figures.cells import Cells, Reader, columns, labelled, markdown, pattern, renamed, without
from tests.figures.row import Figures, ending

SOLVED = {  # row of docs/solvers.md -> the solver's name, and its index among rows of that name
    "`none`": ("none", 1),
    "`direct`": ("direct", 1),
    "`triangulated`": ("triangulated", 1),
    "`map`": ("map", 1),
    "`svd`, undecomposed (LSMR, 1000 steps)": ("svd", 1),
    "`nnls`, undecomposed": ("nnls", 1),
    "`box`": ("box", 1),
    "`qr`, clusters of up to 200": ("qr", 1),
    "`svd`, clusters of up to 200": ("svd", 2),
}
MEASURES = {  # column of the page -> column of the command
    "RMSE, % of white": "RMSE %",
    "PSNR, dB": "PSNR dB",
    "SSIM": "SSIM",
    "CIEDE2000": "CIEDE2000",
    "clipped, %": "clipped %",
    "seconds": "seconds",
}


def solved(text: str) -> Cells:
    """Returns the page's cells by its own labels, without the other columns."""
    cells = markdown("solver | RMSE")(text)
    named = {f"1: {row}, ": row for row in SOLVED}
    return {
        f"{label}, {column}": cell
        for name, cell in cells.items()
        for start, label in named.items()
        for column in MEASURES
        if name.startswith(start) and name.endswith(f", {column}") and cell
    }


def solved_again(text: str) -> Cells:
    return renamed(
        columns("solver ", SOLVED),
        {f"{row}, {theirs}": f"{row}, {ours}" for row in SOLVED for ours, theirs in MEASURES.items()},
    )(text)


CORNER, CLIP = "--camera 640x480 --projector 512x512", "calib_data/media/big_buck_bunny.mp4"


def one_picture() -> Figures:
    """Returns the row for the table of docs/solvers.md."""
    return Figures(
        "docs/solvers.md",
        (
            f"counterlight simulate corner {CORNER} -o corner",
            "counterlight build corner",
            f"counterlight compensate corner {CLIP} --solver none,direct,triangulated,map,svd,nnls,box",
            f"counterlight compensate corner {CLIP} --solver qr,svd --max-cluster 200",
        ),
        4,
        solved,
        solved_again,
        times=ending(", seconds"),
        head="solver | RMSE",
    )


def built(room: str) -> Figures:
    """Returns the row for one room in docs/costs.md's table of builds."""
    return Figures(
        "docs/costs.md",
        (f"counterlight simulate {room} {CORNER} -o {room}", f"counterlight build {room} --verbose"),
        3,
        pattern(
            build=rf"\| `{room}` \|[^|]*\| ([\d.]+) s \|",
            entries=rf"\| `{room}` \|(?:[^|]*\|){{3}} ([\d.]+) million \|",
            maps=rf"\| `{room}` \|(?:[^|]*\|){{4}} (\d+) MiB \|",
        ),
        lambda text: _in_millions(
            pattern(build=r"built in ([\d.]+) s;", entries=r"(\d+) entries, texture", maps=r"([\d.]+) MiB of maps;")(
                text
            )
        ),
        times=lambda name: name == "build",
    )


def built_by_default(room: str, size: str, minutes: float) -> Figures:
    """Returns the row for one room in docs/size.md's table of builds, from the last lines of a build."""
    row, decibels = rf"\| `{room}` {size} \| ", r"([\d.]+)"
    return Figures(
        "docs/size.md",
        at_size(room, size),
        minutes,
        pattern(
            chosen=rf"{row}([^(|]*) \(",
            why=rf"{row}[^(|]*\(([^)]*)\)",
            maps=rf"{row}[^|]*\| (\d+ MiB)",
            start=rf"{row}(?:[^|]*\|){{2}} {decibels} \|",
            played=rf"{row}(?:[^|]*\|){{3}} {decibels} \((\d+) from ([^)]*)\)",
            build=rf"{row}(?:[^|]*\|){{4}} {decibels} \|",
        ),
        pattern(
            chosen=r"\nmaps: ([^(\n]*) \(",
            why=r"\nmaps: [^(\n]*\(([^)]*)\)",
            maps=r" (\d+ MiB) of maps; in",
            start=rf"in simulation {decibels} dB below the optimum without a step",
            played=rf", {decibels} after the (\d+) that play makes from ([^;]*);",
            build=rf"built in {decibels} s;",
        ),
        # the reason in the room `wall` is a time in minutes
        times=lambda name: name == "build" or (name == "why" and room == "wall"),
    )


def at_size(room: str, size: str) -> tuple[str, str]:
    """Returns the commands that simulate a room at a size and build it by default."""
    return f"counterlight simulate {room} --camera {size} --projector {size} -o {room}", f"counterlight build {room}"


def in_blocks(size: str, minutes: float) -> Figures:
    """Returns the row for docs/size.md's sentences on entries and blocks out of focus."""
    losses = {"photograph": r"([\d.]+) dB \(photograph\)", "letters": r"([\d.]+) dB \(letters\)"}
    return Figures(
        "docs/size.md",
        at_size("two_planes", size),
        minutes,
        in_one_line(
            entries=r"([\d,]+) entries per channel by ([\d,]+) near and ([\d,]+) blurred entries",
            simulated=rf"--projector {size}` takes (\d+) s of processor time",
            soft=r"\(letters\) and ([\d.]+) dB \(soft\)",
            **losses,
        ),
        pattern(
            entries=r"(\d+) entries a channel are (\d+) near and (\d+) blurred ones",
            simulated=r"together +([\d.]+)",
            **{name: rf"in dB: .*{name} ([\d.]+)" for name in ("soft", *losses)},
        ),
        times=lambda name: name == "simulated",
    )


def led_in() -> Figures:
    """Returns the row for docs/size.md's sentences on a film that is divided within its shot."""
    play = f"counterlight play two_planes {CLIP} --segments 2"
    differ = r"the frames differ in (\d+) of (\d+) code values, by at most (\d+)"
    stated = {f"after {n}": rf"`--lead-in {n}`, {differ}" for n in (8, 48)}
    found = {f"after {n}": rf"(\d+) of (\d+) codes differ there, by at most (\d+)\nfilm{n}" for n in (8, 48)}
    return Figures(
        "docs/size.md",
        (
            "counterlight simulate two_planes --camera 128x96 --projector 96x72 -o two_planes",
            "counterlight build two_planes",
            *(f"{play} --lead-in {n} --output film{n}.mkv" for n in (8, 48)),
        ),
        2,
        in_one_line(frames=r"shipped clip \((\d+) frames", **stated),
        pattern(frames=r"film8.mkv: (\d+) frames", **found),
        share=0.1,
    )


def explained(scene: str, sizes: str, minutes: float) -> Figures:
    """Returns the row for the costs and energies of a scene's effects, and their total."""
    cells = without(labelled(markdown("scene | effect"), f"1: {scene} | "), "scene", "effect")

    def found(text: str) -> Cells:
        effects = re.findall(r"^(\w+) +on +([\d.]+) +([\d,]+) +(\S+ %)", text, re.MULTILINE)
        named = {f"1: {scene} | {name}": figures for name, *figures in effects}
        together = pattern(**{f"1: {scene} | **together**, CPU s": r"\ntogether +([\d.]+)"})(text)
        columns_ = ("CPU s", "entries", "energy")
        return together | {
            f"{name}, {column}": figure
            for name, figures in named.items()
            for column, figure in zip(columns_, figures, strict=True)
        }

    return Figures(
        "docs/tables/simulation.md",
        (f"counterlight simulate {scene} --explain {sizes}",),
        minutes,
        lambda text: {name: cell for name, cell in cells(text).items() if "MB" not in cell},
        found,
        times=ending(", CPU s"),
        head="scene | effect",
    )


def at_equal_milliseconds(text: str) -> Cells:
    """Read tables of docs/tables/refinement.md whose head and step counts depend on the machine's times."""
    numbered = re.sub(r"^\| start \| \d+ ms .*", "| start, in equal time | a | b | c | d |", text, flags=re.MULTILINE)
    return markdown("start, in equal time")(numbered)


def rigged(page: str, options: str, minutes: float, beginning: str) -> Figures:
    """Returns the row for a table of the rig, whose columns have another order in the command's output."""
    command = " ".join(["python -m tests.rig", options])
    found = markdown("room | fault | optimum")
    return Figures(page, (command,), minutes, markdown(beginning), found, head=beginning)


def _in_millions(cells: Cells) -> Cells:
    return cells | {"entries": f"{float(cells['entries']) / 1e6:.1f}"} if "entries" in cells else cells


def own_room() -> Figures:
    """Returns the row for docs/accuracy.md's sentences on a user's own room."""
    numbers = r"([\d.]+)"
    return Figures(
        "docs/accuracy.md",
        (
            "counterlight simulate corner --camera 64x40 --projector 56x40 -o room",
            "counterlight study room --pictures photograph text gradient",
        ),
        5,
        in_one_line(
            best=rf"possible pictures have {numbers} dB PSNR \(photograph\), {numbers} dB \(text\) and "
            rf"{numbers} dB \(gradient\)",
            direct=rf"Pictures by direct mapping are {numbers} dB below",
            step=rf"one step from T⁺ are {numbers} dB below",
            ms=rf"one step from T⁺ are [\d.]+ dB below the best, and take {numbers} ms per frame",
            first=rf"the first {numbers} patterns of an acquisition, T makes pictures at most 1 dB worse",
            hierarchical=rf"{numbers} patterns of `hierarchical`, T makes pictures at most 0.1",
            projector=rf"Half as many projector pixels per side make pictures {numbers} dB worse",
            camera=rf"Half as many camera pixels per side make pictures {numbers} dB worse",
            drift=rf"A drift of half a projector pixel lowers PSNR by {numbers}",
            film=rf"film after (\d+) steps is {numbers} dB below the best. Stills after (\d+) steps are {numbers}",
        ),
        in_one_line(
            best=rf"can show is {numbers} dB \(photograph\), {numbers} dB \(text\), {numbers} dB \(gradient\)",
            direct=rf"direct mapping is {numbers} dB below",
            step=rf"refined from T⁺, steps 1, [\d.]+ ms a frame, {numbers} dB",
            ms=rf"refined from T⁺, steps 1, {numbers} ms a frame",
            first=rf"{numbers} exposures \(pictures first, \d+\) are within 1 dB",
            hierarchical=rf"{numbers} exposures \(hierarchical, τ = 4 σ\) are within 0.1 dB",
            projector=rf"A projector of half the pixels a side costs {numbers}",
            camera=rf"a camera of half the pixels a side costs {numbers}",
            drift=rf"moved by half a projector pixel costs {numbers}",
            film=rf"direct mapping, film after (\d+) steps \({numbers} dB\) and stills after (\d+) steps \({numbers}",
        ),
        times=lambda name: name == "ms",
    )


def acquired(sizes: str, rooms: tuple[str, ...], minutes: float) -> Figures:
    """Returns rows of docs/tables/schemes.md.

    sizes : sizes of camera and projector, as in the table.
    """
    camera, projector = sizes.split(", ")
    chosen = " ".join(f"--room {room}" for room in rooms)
    cells = markdown("room | camera, projector | scheme")
    return Figures(
        "docs/tables/schemes.md",
        (f"python -m tests.studies.acquisition --again --camera {camera} --projector {projector} {chosen}",),
        minutes,
        labelled(cells, f" | {sizes} | "),
        labelled(cells, f" | {sizes} | "),
        times=ending(", s"),
        head="room | camera, projector | scheme",
    )


def in_one_line(**patterns: str) -> Reader:
    return lambda text: pattern(**patterns)(" ".join(text.split()))


def advised(study: Figures) -> Figures:
    """Returns the row for docs/accuracy.md's table of recommendations, whose options take two columns on the page."""
    stated, found = (labelled(markdown(f"you want | {options}"), ", here") for options in ("build", "options"))
    return Figures(study.page, study.commands, study.minutes, stated, found, study.files)


def in_a_window() -> Figures:
    """Returns the row for the table of docs/player.md: milliseconds per frame, by stages."""
    stated, found = {}, {}
    for captures in ("rendered", "real"):
        for column, stage in enumerate(("decode", "upload", "draw", "present")):
            name = f"{captures}, {stage}"
            stated[name] = rf"\n\| {captures}(?: [^|]*)?" + r"\|[^|]*" * column + r"\| ([\d.]+) ms \|"
            found[name] = rf"{captures} captures, (?:.*\n)*?.*--refine 0 .*\b{stage} ([\d.]+)"
    command = "python -m tests.bench --only show"
    return Figures("docs/player.md", (command,), 3, pattern(**stated), pattern(**found), times=lambda name: True)


def studied(text: str) -> Cells:
    """Read a study's results.csv at the end of the text: `wall | text | direct, below_optimum_db` and so on."""
    lines = csv.DictReader(text[text.rfind("room,picture,") :].splitlines())
    return {
        f"{line['room']} | {line['picture']} | {_method(line)}, {column}": cell
        for line in lines
        for column, cell in line.items()
        if cell
    }


def _method(line: dict[str, str]) -> str:
    return label(line["family"], line["knob"], float(line["value"]) if line["value"] else None)
