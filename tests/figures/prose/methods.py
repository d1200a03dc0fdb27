"""Sentences on the study of all methods, Table 6.1 and hard cases."""

from statistics import mean

from tests.figures.claims import Table, counted, ends, said, tabled, told
from tests.figures.printed import at_size, studied

ACCURACY = tabled("docs/accuracy.md", "method | dB below the best")
SOLVERS = tabled("docs/solvers.md", "solver | RMSE")
SCENES = tabled("docs/table_6_1.md", "scene | captured")
BRICKS = tabled("docs/tables/brickstone.md", "wall | picture")
SYSTEMS = tabled("docs/hard_cases.md", "error, % / amplification")
CUTS = tabled("docs/hard_cases.md", "focus | allowed")
CAPTURED = "skull", "statuette", "glass", "folded_cards"  # scenes that the thesis captured
FOUR = "wall", "two_planes", "glass", "skull"
BELOW, WORST, MIB = "dB below the best", "worst room", "MiB of maps"
DAMPED, MAPPED = (f"{way}, 4 steps: computed; frame; below optimum" for way in ("T⁺ damped", "direct mapping"))
MULTIPLEXED = "acquired (multiplexed, simulated): pictures; computed; below optimum"
TRIANGLES, THESIS = "direct, triangulated", "T⁺ of the thesis, max-cluster 200"


def of_room(t: Table, room: str, method: str, picture: str = ".*") -> list[float]:
    """Returns decibels below the best, per picture."""
    return t(rf"^{room} \| {picture} \| {method}$", "below_optimum_db")


def worse(t: Table, method: str, than: str) -> list[float]:
    """Returns the loss in dB in each room where both methods were tried."""
    rooms = sorted({name.split(" | ")[0] for name in t.cells if f"| {method}, " in name})
    return [mean(of_room(t, room, method)) - mean(of_room(t, room, than)) for room in rooms]


def left_out(t: Table) -> tuple[float, float]:
    """Returns how much smaller, in per cent, a map at two code values is than at a half, in the rooms with both."""
    end = " | photograph | T⁺, max-error 2, map_mib"
    rooms = [name.removesuffix(end) for name in t.cells if name.endswith(end)]
    half, two = ([t.one(rf"^{r} .*photo.*max-error {codes}$", "map_mib") for r in rooms] for codes in ("0.5", "2"))
    return ends([100 - 100 * less / more for less, more in zip(two, half, strict=True)])


def near(t: Table, *rows: str, column: str = BELOW) -> list[float]:
    """Returns one cell per method, by the beginnings of their names."""
    return [t.one(rf": {row}$", column) for row in rows]


def further(t: Table, method: str) -> float:
    """Returns the largest excess error over the box optimum, in per cent, among unweighted systems within reach."""
    within = ": (wall|T|target|half|rank|two|as much|ten)"
    return max(error - best for error, best in zip(t(within, method), t(within, "`box`"), strict=True))


PROSE = (
    told(
        "README.md",
        ("counterlight example --folder example",),
        2,
        (
            "The simulated PSNR is {} dB before compensation ({} dB at the camera's best exposure)",
            "PSNR {} dB before, ...match...best: {} dB",
        ),
        ("best exposure) and {} dB after compensation", "dB before, {} dB after"),
    ),
    said(
        "docs/accuracy.md",
        ACCURACY,
        ("**Uncompensated** pictures are on average {} dB below the best", lambda t: near(t, "uncompensated")),
        (
            "pictures by direct mapping are {} dB below the best, or {} dB with interpolation",
            lambda t: near(t, "direct", "direct, triangulated"),
        ),
        ("In `corner`, direct mapping is {} dB below the best", lambda t: near(t, "direct", column=WORST)),
        ("in `statuette` and {} dB in `folded_cards`", lambda t: near(t, THESIS, column=WORST)),
        (
            "clusters of at most 200 pixels, pictures are {} dB below the best on average",
            lambda t: near(t, "T⁺, cut, max-cluster 200"),
        ),
        (
            "In the worst room, pictures with damping are {} dB below the best.",
            lambda t: near(t, "T⁺, cut, max-cluster 200", column=WORST),
        ),
        (
            "pictures after four steps are {} to {} dB below the best. Pictures after sixteen steps are {} dB below",
            lambda t: near(
                t, *(f"refined from {way}" for way in ("T⁺, cut, steps 4", "direct, steps 4", "T⁺, steps 16"))
            ),
        ),
        ("64 steps from T⁺, pictures stay {} dB below the best", lambda t: near(t, "refined from T⁺, steps 64")),
    ),
    counted(
        "docs/accuracy.md",
        ACCURACY,
        studied,
        (
            "is within {} dB of the best in four rooms",
            lambda t: (max(mean(of_room(t, room, THESIS)) for room in FOUR),),
        ),
        (
            "In `corner`, the thesis' method is {} dB below the best, because its cut",
            lambda t: (mean(of_room(t, "corner", THESIS)),),
        ),
        (
            "Pictures by the thesis' method are {} dB below the best in `statuette`",
            lambda t: (mean(of_room(t, "statuette", THESIS)),),
        ),
        ("instead of the default 0.5, the map is {} to {} % smaller", left_out),
        (
            "With `--max-error 2`, pictures are at most {} dB worse",
            lambda t: (max(worse(t, "T⁺, max-error 2", than="T⁺, max-error 0.5")),),
        ),
    ),
    counted(
        "docs/table_6_1.md",
        ACCURACY,
        studied,
        (
            "pictures by *T⁺ as the thesis* are {} dB (skull) to {} dB (cards) below the optimum.",
            lambda t: ends([n for room in CAPTURED for n in of_room(t, room, THESIS, "photograph")]),
        ),
    ),
    said(
        "docs/size.md",
        ACCURACY,
        ("and pictures are {} dB below the best. The whole", lambda t: near(t, "refined from direct, steps 4")),
        (
            "four steps of refinement from direct mapping need {} MiB of maps",
            lambda t: near(t, "refined from direct, steps 4", column=MIB),
        ),
        (
            "The whole `T⁺` without refinement needs {} MiB of maps, and pictures are {} dB below the best.",
            lambda t: [t.one(r": T⁺, max-error 0.5$", column) for column in (MIB, BELOW)],
        ),
    ),
    told(
        "docs/size.md",
        at_size("wall", "1920x1080"),
        2,
        (
            "(it would take 3 min), {} MiB of maps; in simulation {} dB below the optimum without a step, {} after "
            "the {} that play makes from direct mapping wall: ready",
            "T⁺ cut into clusters ...{} MiB of maps; in simulation {} dB below the optimum without a step, {} after "
            "the {} that play makes from direct mapping",
        ),
    ),
    told(
        "docs/solvers.md",
        SOLVERS.commands,
        SOLVERS.minutes,
        ("{} near entries per channel", "{} near entries a channel"),
    ),
    said(
        "docs/table_6_1.md",
        SCENES,
        (
            "and improves the picture by {} dB. For the cards",
            lambda t: (t.one("skull", MAPPED, 2) - t.one("skull", DAMPED, 2),),
        ),
        (
            "43 times as long as direct mapping, and improves the picture by {} dB.",
            lambda t: (t.one("diffuse", MAPPED, 2) - t.one("diffuse", DAMPED, 2),),
        ),
        (
            "In the glass, direct mapping followed by four steps is {} dB better",
            lambda t: (
                t.one("glass", "direct, triangulated: computed; frame; below optimum", 2) - t.one("glass", MAPPED, 2),
            ),
        ),
        (
            "pictures of the statuette, glass, cards and skull are {} to {} dB below the optimum",
            lambda t: ends(t("skull|David|glass|diffuse", MULTIPLEXED, 2)),
        ),
    ),
    said(
        "docs/table_6_1.md",
        BRICKS,
        (
            "direct mapping and the thesis' T⁺ are {} to {} dB below the best",
            lambda t: ends([n for column in ("direct", TRIANGLES, THESIS) for n in t("scatters", column)]),
        ),
        (
            "the thesis' T⁺ is only {} dB better than triangulated direct mapping",
            lambda t: (t.one("scatters.*photo", TRIANGLES) - t.one("scatters.*photo", THESIS),),
        ),
        (
            "On the relief, the thesis' T⁺ is {} dB better than triangulated direct mapping. On the flat wall, the "
            "thesis' T⁺ is {} dB better than triangulated direct mapping.",
            lambda t: [
                t.one(rf"{wall} \| photo", TRIANGLES) - t.one(rf"{wall} \| photo", THESIS)
                for wall in ("relief", "flat")
            ],
        ),
        (
            "pictures after four steps of refinement are {} to {} dB below the best",
            lambda t: ends(t("scatters", "refined from T⁺, cut, steps 4")),
        ),
    ),
    said(
        "docs/hard_cases.md",
        SYSTEMS,
        (
            "noise of 1 % in b becomes an error of {} to {} %",
            lambda t: ends(
                [n for column in ("plain map, `svd`", "`qr`") for n in t("wall, condition 1e(4|8|14)", column)]
            ),
        ),
        (
            "by at most {} percentage points. After 4 steps of refinement, the error exceeds the box optimum's error "
            "by at most {} percentage points.",
            lambda t: [further(t, f"{steps} steps") for steps in (64, 4)],
        ),
        ("`qr` amplifies noise by {} without a warning.", lambda t: (t.one("condition 1e8", "`qr`", 1),)),
        ("Noise is amplified at most {} times by 64 steps", lambda t: (max(t(": (?!weights)", "64 steps", 1)),)),
    ),
    said(
        "docs/hard_cases.md",
        CUTS,
        (
            "no cluster of a cut wall has a condition number above {},",
            lambda t: (max(t(r"\| (40|10)$", "worst condition")),),
        ),
        (
            "cut walls have an error of up to {} %.",
            lambda t: (max(t(r"\| (40|10)$", "plain inverse")),),
        ),
        (
            "also limits the amplification, and has an error of only {} %",
            lambda t: (max(t(r"\| any$", "λ = 0.1 σ₁")),),
        ),
    ),
)
