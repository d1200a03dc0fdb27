"""What blocks of pixels cost films, in `two_planes` at 1920x1080 where blur is widest: python -m tests.studies.blurring

Some lines of the far card are simulated whole, and their square of widest blur is put into blocks by one limit after
the other: entries a camera pixel, and dB lost by the pictures that judge `--tolerance` and by windows of a film at its
size. Two minutes of processor time.
"""

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.blurring import choice
from counterlight.tools.blurring.pruning import in_cells
from counterlight.tools.inverse.pictures import soft_picture, typical_pictures
from counterlight.tools.shipped import parse_scene
from counterlight.tools.simulation.needs import needs_of
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.simulation.simulate import _Simulation
from counterlight.tools.study.pictures import find_pictures

SIZE, LINES, BAND = (1080, 1920), range(152, 280), 8
WINDOWS = (100, 200), (460, 880), (800, 1500)  # of a film of that size: their upper left corners
LIMITS = choice.LIMITS[3:11]


def pictures(side: tuple[int, int]) -> dict[str, FloatArray]:
    """By name, (height, width)."""
    film = find_pictures(["film"])[0].at(SIZE).mean(axis=2)
    noise, letters, _ = typical_pictures(side)
    judging = {"photograph": noise, "letters": letters, "soft": soft_picture(side)}
    return judging | {f"film {top},{left}": film[top : top + side[0], left : left + side[1]] for top, left in WINDOWS}


def bands() -> list[SparseRows]:
    scene = load_scene(parse_scene("two_planes")).resized(SIZE, SIZE)
    simulation = _Simulation(scene, needs_of(scene))
    simulation.prepare()
    return [simulation.band(range(top, top + BAND)).near for top in range(LINES.start, LINES.stop, BAND)]


def main() -> None:
    shown = pictures((choice.SIDE, choice.SIDE))
    choice.NAMES = tuple(shown)
    choice.judging_pictures = lambda side: list(pictures(side).values())
    square = choice._Square.of(bands(), SIZE[1], SIZE)
    count = square._rows.shape[0]
    print(f"| limit | near | blurred | {' | '.join(shown)} |\n{'|---' * (3 + len(shown))}|")
    for limit in map(float, LIMITS):
        near, scatter = in_cells(square._rows, SIZE, limit)
        lost = " | ".join(f"{each:.2f}" for each in square.losses(limit))
        print(
            f"| {limit:.4f} | {near.indices.size / count:.1f} | {scatter.indices.size / count:.1f} | {lost} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
