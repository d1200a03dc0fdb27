"""The worth of effects, recomputed by other commands; the tolerance also holds for pictures that were not judged."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import counterlight as cl
from counterlight.arrays import FloatArray
from counterlight.pipeline.content import psnr
from counterlight.tools.simulation.needs import Need, needs_of
from counterlight.tools.simulation.room import simulated_calibration
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.study.pictures import BUILT_IN
from counterlight.tools.study.worth import PICTURES, priced
from tests.programs import fail, python, succeed
from tests.scenes import SCENES, plane, rectangle, scene_file, small

BRICKS = 'pattern = { kind = "bricks", colours = [[0.7, 0.5, 0.4], [0.5, 0.6, 0.6]], repeat = [24, 30] }'
COAT = "albedo = [0.6, 0.5, 0.5]\ngloss = { reflectance = 0.002, roughness = 0.2 }"


def room(scene: Scene, needs: dict[str, Need] | None = None, without: tuple[str, ...] = ()) -> cl.Room:
    result = simulate(scene, needs, without=without)
    return cl.Room(simulated_calibration(scene, result), result.transport)


def off_by(whole: cl.Room, lacking: cl.Room, name: str) -> tuple[float, float]:
    """Return the loss in dB from solving without an effect, and the excess in dB of its predicted PSNR."""
    picture = BUILT_IN[name](whole.camera)

    def seen(room: cl.Room, drive: FloatArray) -> float:
        return psnr(float(np.mean(((room.seen(drive) / whole.white - picture)[whole.mask]) ** 2)))

    best, drive = (cl.solve(each, picture, white=whole.white).drive for each in (whole, lacking))
    return seen(whole, best) - seen(whole, drive), seen(lacking, drive) - seen(whole, best)


@pytest.mark.parametrize("effect", ["inter_reflection", "ambient_light"])
def test_an_effect_is_worth_what_the_room_loses_without_it(effect: str) -> None:
    scene = replace(small("corner"), cells=60)
    errors = [off_by(room(scene), room(scene, without=(effect,)), name) for name in PICTURES]
    worst = max(max(lost, abs(promised)) for lost, promised in errors)
    # Box optima have a relative gap of 3e-3 instead of 1e-4: 0.013 dB each.
    assert priced(scene, needs_of(scene))[effect].worth == pytest.approx(worst, abs=0.02)


def test_a_lens_is_judged_by_its_picture_not_by_its_circle_of_confusion(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path, plane(extra=BRICKS))).resized((45, 60), (36, 48))
    opened = replace(scene.projector, aperture=0.1, focus_distance=1.0)
    worth = []
    for pixels in (0.02, 0.45, 0.9):
        lens = replace(opened, aperture=0.1 * pixels / float(opened.blur_pixels(np.array([2.0]))[0]))
        soft = replace(scene, projector=lens)
        need = priced(soft, needs_of(soft), 0.1)["projector_defocus"]
        assert need.worth is not None
        assert need.on == (need.worth > 0.05)
        worth.append(need.worth)
    assert sorted(worth) == worth
    assert worth[0] < 0.05 < worth[2]


def test_a_lens_that_bends_is_judged_by_the_pixels_that_it_moves(tmp_path: Path) -> None:
    """The same lens moves more pixels of a larger picture.

    With a lens that bends ten times as `strongly`, the picture would fold.
    """
    scene = load_scene(scene_file(tmp_path, plane(extra=BRICKS)))
    slightly, strongly = (
        replace(scene, camera=replace(scene.camera, distortion=(k1, 0.0, 0.0, 0.0, 0.0))) for k1 in (-0.004, -0.15)
    )
    for bent, sizes, pays in (
        (slightly, ((45, 60), (36, 48)), False),
        (slightly, ((360, 480), (288, 384)), True),
        (strongly, ((1080, 1440), (864, 1152)), True),
    ):
        sized = bent.resized(*sizes)
        assert priced(sized, needs_of(sized), 0.1)["distortion"].on == pays


def faint_coat(tmp_path: Path) -> Scene:
    """Return two cards at a right angle, one with a coat that reflects almost nothing."""
    card = rectangle([-0.5, -0.5, 0.0], [1.0, 0, 0], [0, 1.0, 0], 0.6)
    coated = f"[[surfaces]]\ncorner = [-0.5, -0.5, 0]\nedge_u = [0, 0, 0.6]\nedge_v = [0, 1, 0]\n{COAT}\n"
    return load_scene(scene_file(tmp_path, card + coated))


def small_card(tmp_path: Path) -> Scene:
    """Return a small dark card far from a wall that it hardly lights."""
    card = rectangle([0.2, 0, 0.9], [0, 0, 0.1], [0, 0.1, 0], 0.05)
    return load_scene(scene_file(tmp_path, plane(extra=BRICKS) + card))


def test_a_small_shadow_may_fall_on_the_brightest_part_of_a_picture(tmp_path: Path) -> None:
    """In the small room, the effect was worth 0.03 dB, because windows are dark there. The photograph lost 0.15 dB."""
    lenses = {"position": "[0.35, 0.25, 2]", "fov": "34"}, {"position": "[-0.2, 0.1, 2.1]", "fov": "28"}
    sizes = (160, 120), (200, 150)
    devices = "".join(
        f"[{name}]\nwidth = {width}\nheight = {height}\nposition = {lens['position']}\nlook_at = [0, 0, 0]\n"
        f"horizontal_field_of_view_deg = {lens['fov']}\n"
        for name, lens, (width, height) in zip(("projector", "camera"), lenses, sizes, strict=True)
    )
    wall = f"[[surfaces]]\ncorner = [-1.2, -0.9, 0]\nedge_u = [2.4, 0, 0]\nedge_v = [0, 1.8, 0]\n{BRICKS}\n"
    fly = rectangle([-0.07, 0.03, 0.8], [0.014, 0, 0], [0, 0.014, 0], 0.02)
    path = tmp_path / "fly.toml"
    path.write_text(f"{devices}[ambient]\nirradiance = [0.01, 0.01, 0.01]\n{wall}{fly}")
    scene = load_scene(path)
    lost = np.max(np.abs(off_by(room(scene), room(scene, without=("shadows",)), "photograph")))
    assert lost > 0.1
    assert priced(scene, needs_of(scene), 0.1)["shadows"].on


@pytest.mark.parametrize("make", [faint_coat, small_card])
def test_a_tolerance_is_kept_at_a_size_that_nobody_judged(make: Callable[[Path], Scene], tmp_path: Path) -> None:
    scene = replace(make(tmp_path), cells=200).resized((105, 140), (72, 96))
    needs = priced(scene, needs_of(scene), 0.1)
    assert [name for name, need in needs.items() if not need.on and need.worth is not None]
    whole, lacking = room(scene), room(scene, needs)
    for name in ("photograph", "film", "text"):
        assert np.max(np.abs(off_by(whole, lacking, name))) < 0.1


def test_all_that_costs_goes_for_an_endless_tolerance_and_what_is_free_stays() -> None:
    scene = replace(small("folded_cards"), cells=60)
    found = priced(scene, needs_of(scene), 1e9)
    assert [name for name, need in found.items() if need.on] == ["direct", "ambient_light", "black_level"]
    assert "--within 1e+09 dB" in found["shadows"].reason


def test_without_any_light_left_an_effect_is_worth_everything(tmp_path: Path) -> None:
    """The camera sees the wall only through a ball of glass."""
    ball = '[[surfaces]]\nshape = "sphere"\ncentre = [0, 0, 1.7]\nradius = 0.25\ndielectric = { index = 1.5 }\n'
    scene = load_scene(scene_file(tmp_path, plane() + ball))
    assert priced(scene, needs_of(scene), 20.0)["refraction"].worth == np.inf


def test_judging_imports_no_effect_that_the_scene_does_not_call_for(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, plane() + "[ambient]\nirradiance = [0.02, 0.02, 0.02]\n")
    script = f"""
import sys
from counterlight.tools.verbs import main
main(["simulate", {str(scene)!r}, "--explain", "--within", "0.1dB"])
prefix = "counterlight.tools.simulation.effects."
print(*sorted(name.removeprefix(prefix) for name in sys.modules if name.startswith(prefix)))
"""
    assert python("-c", script).splitlines()[-1] == "ambient_light direct"


def test_the_command_says_what_effects_are_worth() -> None:
    scene = SCENES / "corner.toml"
    said = succeed("simulate", scene, "--explain", "--camera", "40x24", "--projector", "32x20")
    lines = {line.split()[0]: line.split() for line in said.splitlines()}
    assert lines["effect"][5] == "dB"
    assert float(lines["inter_reflection"][6]) > 1  # in dB; the percent sign of the energy is a separate word
    assert "decibels are a number of at least 0" in fail("simulate", scene, "--explain", "--within=-1dB")
