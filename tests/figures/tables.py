"""Tables of pages with their commands."""

from tests.figures.printed import (
    CORNER,
    acquired,
    advised,
    at_equal_milliseconds,
    built,
    built_by_default,
    explained,
    in_a_window,
    in_blocks,
    led_in,
    one_picture,
    own_room,
    rigged,
)
from tests.figures.row import Figures, table

FULL_SIZE = {"corner": 1, "two_planes": 2, "folded_cards": 4}  # minutes at full size, by scene
RIG = "room | fault | optimum, dB | captured, dB | below, dB"
ALONE = "quiet", "srgb", "believed", "response", "led", "segment", "lamp", "daylight"
REAL = "lateral", "halo", "wander", "processing", "real"

STUDY = table(
    "docs/accuracy.md",
    "counterlight study -o study",
    5,
    "method | dB below the best",
    ("ms a picture", "preparation, s"),
    files=("study/summary.md", "study/results.csv"),
)

TABLES = (
    table("docs/displays.md", "python -m tests.studies.second_projector", 2, "room: figure | first"),
    table("docs/ways.md", "python -m tests.studies.ways", 1, "room | way"),
    table("docs/decomposition.md", "python -m tests.studies.decomposition", 4, "room | allowed"),
    table("docs/tables/radii.md", "python -m tests.studies.neighbourhoods", 4, "entries from"),
    table("docs/mathematics.md", "python -m tests.studies.factoring", 2, "corner | camera", ("CPU s",)),
    table(
        "docs/hard_cases.md", "python -m tests.studies.hard_cases", 3, "error, % / amplification", units=5, share=0.3
    ),
    table("docs/hard_cases.md", "python -m tests.studies.hard_cases", 3, "focus | allowed"),
    table("docs/hard_cases.md", "python -m tests.studies.hard_cases", 3, "far light and dark paint"),
    table("docs/hard_cases.md", "python -m tests.studies.colour", 2, "condition of the mixing"),
    *(built(room) for room in ("wall", "corner")),
    one_picture(),
    table("docs/tables/standing.md", "python -m tests.studies.standing", 20, "room, picture | start, steps"),
    table(
        "docs/tables/refinement.md",
        "python -m tests.studies.refinement",
        20,
        "start | 1 step",
        ("before a step, ms", "a step, ms"),
        share=0.1,
    ),
    table("docs/tables/refinement.md", "python -m tests.studies.refinement", 20, "schedule | 1 step"),
    table("docs/tables/refinement.md", "python -m tests.studies.refinement", 20, " | 1 step"),
    Figures(
        "docs/tables/refinement.md",
        ("python -m tests.studies.refinement",),
        20,
        at_equal_milliseconds,
        at_equal_milliseconds,
        times=lambda name: ": previous, " not in name,
    ),
    table("docs/tables/scaling.md", "python -m tests.studies.scaling", 6, "projector | 4 entries", ("entries",)),
    table("docs/viewpoints.md", "python -m tests.studies.viewpoints", 15, "views | nearest view"),
    table("docs/viewpoints.md", "python -m tests.studies.viewpoints", 15, "viewers at once"),
    table(
        "docs/tables/viewpoints.md",
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
    table("docs/tables/words.md", "python -m tests.bench --only words", 3, "room | T⁺ | its entries"),
    table(
        "docs/gpu.md",
        "python -m tests.bench --only frames",
        1,
        "projector | drawn by",
        ("upload", "to codes", "read back", "whole frame", "processor, all cores"),
    ),
    table(
        "docs/refinement.md",
        "python -m tests.bench --only budget",
        4,
        "room | budget, ms",
        ("a frame, median, ms", "95 % below, ms", "steps at the end", "dB below the best"),
    ),
    table(
        "docs/tables/hdr.md",
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
    table("docs/tables/blurring.md", "python -m tests.studies.blurring", 5, "limit | near | blurred"),
    *(explained(scene, CORNER, minutes) for scene, minutes in FULL_SIZE.items()),
    table("docs/tables/faults.md", "python -m tests.studies.faults", 4, "fault | CPU s", ("CPU s",)),
    table("docs/simulation.md", "python -m tests.studies.worth", 9, "scene | camera", ("CPU s whole, with these",)),
    table("docs/tables/optimum.md", "python -m tests.studies.optimum", 25, "room | direct mapping | optimum"),
    rigged("docs/rig.md", "--fault known home drift", 10, f"{RIG} | inside (optimum), dB | ΔE2000 (optimum) | light"),
    rigged(
        *("docs/tables/rig.md", f"--room wall --fault {' '.join(ALONE)}", 8),
        f"{RIG} | inside (optimum), dB | ΔE2000 (optimum) | inside",
    ),
    rigged(
        *("docs/tables/rig.md", f"--room wall corner glass --fault {' '.join(REAL)} --steps 0", 22),
        f"{RIG} | inside (optimum), dB | blurred",
    ),
    rigged(
        *("docs/tables/rig.md", "--room wall defocus corner glass --fault webcam curve --steps 0", 12),
        f"{RIG} | inside (optimum), dB | ΔE2000 (optimum) | blurred",
    ),
    table("docs/tables/rig.md", "python -m tests.rig --coverage --fault known home", 21, "room | fault | inside, %"),
    table("docs/schemes.md", "python -m tests.studies.pictures_first --fault known", 60, "room | fault"),
    acquired("96x72, 128x96", ("corner", "folded_cards", "glass", "skull", "statuette", "two_planes", "wall"), 10),
    acquired("256x192, 320x240", ("corner", "two_planes", "wall"), 15),
    table("docs/schemes.md", "python -m tests.studies.noise", 30, "room | electrons"),
    table("docs/tables/linearity.md", "python -m tests.studies.linearity", 4, "camera | wall"),
    table("docs/tables/brickstone.md", "python -m tests.studies.brickstone", 10, "wall | picture"),
    table("docs/table_6_1.md", "python -m tests.studies.table_6_1", 60, "scene | captured"),
    own_room(),
    in_a_window(),
    STUDY,
    advised(STUDY),
)
