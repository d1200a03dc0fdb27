"""Which figures of which page come from which command."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from tests.figures.cells import Cells, Reader, columns, labelled, markdown, pattern, renamed, without


@dataclass(frozen=True)
class Figures:
    """page : below the repository.  commands : as the page or a user says them, run one after the other.

    stated, found : read the page, and what the commands wrote: what they printed and `files`, below where they ran.
    minutes : on two cores, about.  times : whether a cell of a name is one.  units, share : see cells.py.
    """

    page: str
    commands: tuple[str, ...]
    minutes: float
    stated: Reader
    found: Reader
    files: tuple[str, ...] = ()
    times: Callable[[str], bool] = field(default=lambda name: False)
    units: float = 2.0
    share: float = 0.05

    @property
    def name(self) -> str:
        return f"{self.page}: {'; '.join(self.commands)}"


def table(
    page: str, command: str, minutes: float, beginning: str, times: tuple[str, ...] = (), **told: object
) -> Figures:
    """A table that a command prints, or writes into a file, as the page has it.  times : columns."""
    reader = markdown(beginning)
    is_time = _ending(*(f", {column}" for column in times))
    return Figures(page, (command,), minutes, reader, reader, times=is_time, **told)  # type: ignore[arg-type]


def _ending(*ends: str) -> Callable[[str], bool]:
    return lambda name: name.endswith(ends) if ends else False


SOLVED = {  # a row of docs/solvers.md -> the solver's name, and which of its rows
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
MEASURES = {  # a column there -> the command's
    "RMSE, % of white": "RMSE %",
    "PSNR, dB": "PSNR dB",
    "SSIM": "SSIM",
    "CIEDE2000": "CIEDE2000",
    "clipped, %": "clipped %",
    "seconds": "seconds",
}


def _solved(text: str) -> Cells:
    """Of the page, by its own labels without the other columns."""
    cells = markdown("solver | RMSE")(text)
    named = {f"1: {row}, ": row for row in SOLVED}
    return {
        f"{label}, {column}": cell
        for name, cell in cells.items()
        for start, label in named.items()
        for column in MEASURES
        if name.startswith(start) and name.endswith(f", {column}") and cell
    }


def _solved_again(text: str) -> Cells:
    return renamed(
        columns("solver ", SOLVED),
        {f"{row}, {theirs}": f"{row}, {ours}" for row in SOLVED for ours, theirs in MEASURES.items()},
    )(text)


CORNER, CLIP = "--camera 640x480 --projector 512x512", "calib_data/media/big_buck_bunny.mp4"


def built(room: str) -> Figures:
    """A row of the README's table of builds."""
    return Figures(
        "README.md",
        (f"counterlight simulate {room} {CORNER} -o {room}", f"counterlight build {room}"),
        3,
        pattern(
            build=rf"\| `{room}` \|[^|]*\| ([\d.]+) s \|",
            entries=rf"\| `{room}` \|(?:[^|]*\|){{3}} ([\d.]+) million \|",
            maps=rf"\| `{room}` \|(?:[^|]*\|){{4}} (\d+) MiB \|",
        ),
        lambda text: _in_millions(
            pattern(build=r"\n([\d.]+) s: ", entries=r"(\d+) entries, texture", maps=r"([\d.]+) MiB of maps;")(text)
        ),
        times=lambda name: name == "build",
    )


def built_by_default(room: str, size: str, minutes: float) -> Figures:
    """A row of docs/size.md's table of builds: what the last line of one says."""
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
            chosen=r"\n[\d.]+ s: ([^(\n]*) \(",
            why=r"\n[\d.]+ s: [^(\n]*\(([^)]*)\)",
            maps=r" (\d+ MiB) of maps; in",
            start=rf"in simulation {decibels} dB below the optimum without a step",
            played=rf", {decibels} after the (\d+) that play makes from ([^;]*);",
            build=rf"\n{decibels} s: ",
        ),
        times=lambda name: name == "build" or (name == "why" and room == "wall"),  # there it is minutes
    )


def at_size(room: str, size: str) -> tuple[str, str]:
    """Simulated, and built by default."""
    return f"counterlight simulate {room} --camera {size} --projector {size} -o {room}", f"counterlight build {room}"


def in_blocks(size: str, minutes: float) -> Figures:
    """What docs/size.md says of entries and blocks out of focus."""
    losses = {"photograph": r"([\d.]+) dB \(photograph\)", "letters": r"([\d.]+) \(letters\)"}
    return Figures(
        "docs/size.md",
        at_size("two_planes", size),
        minutes,
        _in_one_line(
            entries=r"([\d,]+) entries a channel become ([\d,]+) near and ([\d,]+) blurred ones",
            simulated=rf"--projector {size}`, (\d+) s of processor time",
            soft=r"\(letters\) and ([\d.]+) \(soft\)",
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
    """What docs/size.md says of a film that is divided within its shot."""
    play = f"counterlight play two_planes {CLIP} --segments 2"
    stated = {f"after {n}": rf"`--lead-in {n}` in (\d+) of (\d+) (?:codes )?by at most (\d+)" for n in (8, 48)}
    found = {f"after {n}": rf"(\d+) of (\d+) codes differ there, by at most (\d+)\nfilm{n}" for n in (8, 48)}
    return Figures(
        "docs/size.md",
        (
            "counterlight simulate two_planes --camera 128x96 --projector 96x72 -o two_planes",
            "counterlight build two_planes",
            *(f"{play} --lead-in {n} --output film{n}.mkv" for n in (8, 48)),
        ),
        2,
        _in_one_line(frames=r"one shot of (\d+) frames", **stated),
        pattern(frames=r"film8.mkv: (\d+) frames", **found),
        share=0.1,
    )


def explained(scene: str, sizes: str, minutes: float, beginning: str = "1") -> Figures:
    """What a scene's effects cost and give, and all of them together; beginning : the number of the page's table."""
    cells = without(labelled(markdown("scene | effect"), f"{beginning}: {scene} | "), "scene", "effect")

    def found(text: str) -> Cells:
        effects = re.findall(r"^(\w+) +on +([\d.]+) +([\d,]+) +(\S+ %)", text, re.MULTILINE)
        named = {f"{beginning}: {scene} | {name}": figures for name, *figures in effects}
        together = pattern(**{f"{beginning}: {scene} | **together**, CPU s": r"\ntogether +([\d.]+)"})(text)
        columns_ = ("CPU s", "entries", "energy")
        return together | {
            f"{name}, {column}": figure
            for name, figures in named.items()
            for column, figure in zip(columns_, figures, strict=True)
        }

    return Figures(
        "docs/simulation.md",
        (f"counterlight simulate {scene} --explain {sizes}",),
        minutes,
        lambda text: {name: cell for name, cell in cells(text).items() if "MB" not in cell},
        found,
        times=_ending(", CPU s"),
    )


def at_equal_milliseconds(text: str) -> Cells:
    """Tables of docs/refinement.md: what `previous` takes, and so the head, is the machine's; so are others' steps."""
    numbered = re.sub(r"^\| start \| \d+ ms .*", "| start, in equal time | a | b | c | d |", text, flags=re.MULTILINE)
    return markdown("start, in equal time")(numbered)


def rigged(options: str, minutes: float, beginning: str) -> Figures:
    """A table of docs/rig.md, which has other columns in another order."""
    command = " ".join(["python -m tests.rig", options])
    return Figures("docs/rig.md", (command,), minutes, markdown(beginning), markdown("room | fault | optimum"))


def _in_millions(cells: Cells) -> Cells:
    return cells | {"entries": f"{float(cells['entries']) / 1e6:.1f}"} if "entries" in cells else cells


def own_room() -> Figures:
    """What docs/accuracy.md says in prose of a room of one's own."""
    numbers = r"([\d.]+)"
    return Figures(
        "docs/accuracy.md",
        (
            "counterlight simulate corner --camera 64x40 --projector 56x40 -o room",
            "counterlight study room --pictures photograph text gradient",
        ),
        5,
        _in_one_line(
            best=rf"the best is {numbers} dB \(photograph\), {numbers} \(text\), {numbers} \(gradient\)",
            direct=rf"direct mapping is {numbers} below",
            step=rf"one step from T⁺ is within {numbers}",
            ms=rf"one step from T⁺ is within [\d.]+, {numbers} ms a frame",
            first=rf"{numbers} pictures first are within 1 dB",
            hierarchical=rf"{numbers} of `hierarchical` within 0.1",
            projector=rf"a projector of half the pixels a side costs {numbers}",
            camera=rf"a camera of half {numbers}",
            drift=rf"half a projector pixel of drift costs {numbers}",
            film=rf"dB after (\d+) steps \({numbers}\), frames each from the start after (\d+) \({numbers}\)",
            film_of_map=rf"no help \({numbers} dB; {numbers} from the start\)",
        ),
        _in_one_line(
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
            film_of_map=rf"from T⁺, film after 1 step \({numbers} dB\) and stills after 1 step \({numbers} dB\)",
        ),
        times=lambda name: name == "ms",
    )


def acquired(sizes: str, rooms: tuple[str, ...], minutes: float) -> Figures:
    """Rows of docs/acquisition.md's table of schemes.  sizes : of camera and projector, as the table has them."""
    camera, projector = sizes.split(", ")
    chosen = " ".join(f"--room {room}" for room in rooms)
    cells = markdown("room | camera, projector | scheme")
    return Figures(
        "docs/acquisition.md",
        (f"python -m tests.studies.acquisition --again --camera {camera} --projector {projector} {chosen}",),
        minutes,
        labelled(cells, f" | {sizes} | "),
        cells,
        times=_ending(", s"),
    )


def _in_one_line(**patterns: str) -> Reader:
    return lambda text: pattern(**patterns)(" ".join(text.split()))


FULL_SIZE = {"wall": 1, "corner": 1, "statuette": 1, "two_planes": 2, "folded_cards": 4}  # minutes
RIG = "room | fault | optimum, dB | captured, dB | below, dB"
ALONE = "quiet", "srgb", "believed", "response", "led", "segment", "lamp", "daylight"

ROWS = (
    table("docs/displays.md", "python -m tests.studies.second_projector", 2, "room: figure | first"),
    table("docs/ways.md", "python -m tests.studies.ways", 1, "room | way"),
    table("docs/decomposition.md", "python -m tests.studies.decomposition", 4, "room | allowed"),
    table("docs/decomposition.md", "python -m tests.studies.neighbourhoods", 4, "entries from"),
    table("docs/mathematics.md", "python -m tests.studies.factoring", 2, "corner | camera", ("CPU s",)),
    table(
        "docs/hard_cases.md", "python -m tests.studies.hard_cases", 3, "error, % / amplification", units=5, share=0.3
    ),
    table("docs/hard_cases.md", "python -m tests.studies.hard_cases", 3, "focus | allowed"),
    table("docs/hard_cases.md", "python -m tests.studies.hard_cases", 3, "far light and dark paint"),
    table("docs/hard_cases.md", "python -m tests.studies.colour", 2, "condition of the mixing"),
    *(built(room) for room in ("wall", "corner")),
    Figures(
        "docs/solvers.md",
        (
            f"counterlight simulate corner {CORNER} -o corner",
            "counterlight build corner",
            f"counterlight compensate corner {CLIP} --solver none,direct,triangulated,map,svd,nnls,box",
            f"counterlight compensate corner {CLIP} --solver qr,svd --max-cluster 200",
        ),
        4,
        _solved,
        _solved_again,
        times=_ending(", seconds"),
    ),
    table("docs/refinement.md", "python -m tests.studies.standing", 20, "room, picture | start, steps"),
    table(
        "docs/refinement.md",
        "python -m tests.studies.refinement",
        20,
        "start | 1 step",
        ("before a step, ms", "a step, ms"),
        share=0.1,
    ),
    table("docs/refinement.md", "python -m tests.studies.refinement", 20, "schedule | 1 step"),
    table("docs/refinement.md", "python -m tests.studies.refinement", 20, " | 1 step"),
    Figures(
        "docs/refinement.md",
        ("python -m tests.studies.refinement",),
        20,
        at_equal_milliseconds,
        at_equal_milliseconds,
        times=lambda name: ": previous, " not in name,
    ),
    table("docs/gpu.md", "python -m tests.studies.scaling", 6, "projector | 4 entries", ("entries",)),
    table("docs/viewpoints.md", "python -m tests.studies.viewpoints", 15, "views | nearest view"),
    table("docs/viewpoints.md", "python -m tests.studies.viewpoints", 15, "viewers at once"),
    table(
        "docs/viewpoints.md",
        "python -m tests.studies.viewpoints --price",
        2,
        "views | maps",
        ("frame at a view", "between two", "moving", "for all"),
    ),
    table(
        "docs/cameras.md",
        "python -m tests.studies.cameras",
        3,
        "projectors, cameras | camera pixels",
        ("build, processor",),
        share=0.1,
    ),
    table("docs/content.md", "python -m tests.studies.content", 4, "white | adapt"),
    table("docs/content.md", "python -m tests.studies.content", 4, "flicker | noise"),
    table(
        "docs/content.md",
        "python -m tests.studies.content",
        4,
        "a frame in the projector's view",
        ("processor ms, fastest of 7 in turns",),
    ),
    table("docs/gpu.md", "python -m tests.bench --only words", 3, "room | start | steps | MB"),
    table(
        "docs/hdr.md",
        "python -m tests.bench.hdr",
        4,
        "scene | method | shader",
        ("shader", "numpy", "OpenCV", "OpenCV / shader"),
    ),
    table("docs/hdr.md", "python -m tests.studies.recovery", 1, "exposures, stops apart | method"),
    table("docs/displays.md", "python -m tests.studies.two_projectors", 3, " | first | second | both"),
    led_in(),
    built_by_default("two_planes", "480x270", 3),
    built_by_default("two_planes", "960x540", 3),
    in_blocks("960x540", 3),
    built_by_default("wall", "1920x1080", 2),
    built_by_default("corner", "1920x1080", 4),
    table(
        "docs/colour.md",
        "python -m tests.rig --scale 0.5 --room wall corner --fault crosstalk led wheel"
        " --colour independent global pixel --steps 0",
        8,
        "room | fault | colour",
    ),
    table("docs/size.md", "python -m tests.studies.blurring", 5, "limit | near | blurred"),
    *(explained(scene, CORNER, minutes) for scene, minutes in FULL_SIZE.items()),
    explained("glass", "--camera 320x240 --projector 192x144", 3, "2"),
    explained("skull", "--camera 240x320 --projector 192x192", 2, "2"),
    table("docs/simulation.md", "python -m tests.studies.worth", 9, "scene | camera", ("CPU s whole, with these",)),
    rigged("--fault known crosstalk home wheel drift", 15, f"{RIG} | whole footprints, dB | blurred"),
    rigged(f"--room wall --fault {' '.join(ALONE)}", 8, f"{RIG} | whole footprints, dB | ΔE"),
    rigged("--quick --fault segment", 2, f"{RIG} | blurred"),
    table("docs/acquisition.md", "python -m tests.studies.pictures_first --fault known", 60, "room | fault"),
    acquired("96x72, 128x96", ("corner", "folded_cards", "glass", "skull", "statuette", "two_planes", "wall"), 10),
    acquired("256x192, 320x240", ("corner", "two_planes", "wall"), 15),
    table("docs/acquisition.md", "python -m tests.studies.noise", 30, "room | electrons"),
    table("docs/table_6_1.md", "python -m tests.studies.brickstone", 10, "wall | picture"),
    table("docs/table_6_1.md", "python -m tests.studies.table_6_1", 60, "scene | captured"),
    own_room(),
    table(
        "docs/accuracy.md",
        "counterlight study -o study",
        25,
        "method | dB below the best",
        ("ms a picture", "preparation, s"),
        files=("study/summary.md",),
    ),
)
