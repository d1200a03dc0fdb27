"""The default in random rooms, judged by scipy: near the unweighted optimum, never below direct mapping.

Rooms and judge share no code with the product (random_rooms.py, unweighted.py). tests/studies/optimum.py judges more
rooms.
"""

import numpy as np
import pytest

import counterlight as cl
from counterlight.pipeline.refinement import STEPS_OF_A_STILL
from tests.grey_rooms import GreyRoom, shipped_in_green
from tests.random_rooms import random_room
from tests.unweighted import Judge

NEAR_DB = 0.3  # the promise: inside the border, below the optimum
TIE_DB = 0.01  # float32 light
ROWS = 22  # most rows of the projector
SEEDS = 0, 6, 2, 3, 9  # every kind of room, and every ratio of camera pixels to projector pixels


def pictures(camera: tuple[int, int]) -> dict[str, np.ndarray]:
    """Return grey pictures, in shares of white."""
    tiles = np.random.default_rng(1).uniform(0.05, 0.95, (camera[0] // 8 + 1, camera[1] // 8 + 1))
    ramp = np.tile((np.arange(camera[1]) + 0.5) / camera[1], (camera[0], 1))
    return {
        "even": np.full(camera, 0.5),
        "ramp": ramp,
        "tiles": np.kron(tiles, np.ones((8, 8)))[: camera[0], : camera[1]],
    }


def cards() -> GreyRoom:
    """Return cards that light each other, as one dense matrix. Many projector pixels are seen only through bounces."""
    return shipped_in_green("folded_cards", (18, 24), (14, 18))


@pytest.mark.parametrize("seed", [*SEEDS, None])
def test_a_still_is_near_the_optimum_and_not_below_direct_mapping(seed: int | None) -> None:
    given = cards() if seed is None else random_room(seed, ROWS)
    room = given.in_product
    maps, judge = cl.build_maps(room), Judge(given.T, given.camera)
    for name, picture in pictures(given.camera).items():
        with cl.Renderer(room, maps, backend="cpu") as renderer:
            product = renderer.render(np.repeat(picture[..., None], 3, axis=2), refine=STEPS_OF_A_STILL)[..., 1].ravel()
        b = (maps.white * picture - given.ambient).ravel()
        drives = product, judge.optimum(b), judge.direct(b)
        (over_all, within), (best, best_within), (direct, _) = (judge.psnr(p, b, maps.white) for p in drives)
        assert within >= best_within - NEAR_DB, (given.name, name)
        assert over_all >= direct - TIE_DB, (given.name, name)
        assert best >= over_all - TIE_DB  # error of the judge
