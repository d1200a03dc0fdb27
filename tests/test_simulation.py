"""The simulator: closed forms, independent recomputation, and effects that run only if the scene needs them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.tools.simulation import assembly
from counterlight.tools.simulation.geometry import trace
from counterlight.tools.simulation.needs import needs_of
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import channel, channels
from tests.programs import command, fail, here, python, succeed
from tests.scenes import SCENES, flat, plane, rectangle, scene_file, small

# On demand


def test_needs_are_read_off_the_scene(tmp_path: Path) -> None:
    wall, corner = needs_of(small("wall")), needs_of(small("corner"))
    assert (wall["inter_reflection"].on, wall["inter_reflection"].reason) == (False, "one plane")
    assert corner["inter_reflection"].on
    assert "74°" in corner["inter_reflection"].reason
    assert not wall["shadows"].on
    assert not corner["shadows"].on
    dark = needs_of(load_scene(scene_file(tmp_path, plane())))
    assert [name for name, need in dark.items() if need.on] == ["direct"]


IMPORTED = """
import os
import sys
from dataclasses import replace
from pathlib import Path
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.simulation.simulate import simulate
for path in map(Path, sys.argv[1:]):
    if os.fork():
        os.wait()
        continue
    scene = load_scene(path)
    scene = replace(scene, cells=40, camera=scene.camera.resized(9, 16), projector=scene.projector.resized(9, 16))
    result = simulate(scene)
    prefix = "counterlight.tools.simulation.effects."
    imported = {module.removeprefix(prefix) for module in sys.modules if module.startswith(prefix)}
    known = {report.need.effect for report in result.reports}
    print(*sorted(imported & known))
    print(*sorted(report.need.effect for report in result.reports if report.need.on), flush=True)
    os._exit(0)
"""


def test_an_effect_that_is_off_is_not_even_imported() -> None:
    """Each scene has its own copy of an interpreter that has imported no effect."""
    scenes = [f"{SCENES / name}.toml" for name in ("wall", "corner", "statuette", "folded_cards", "two_planes")]
    lines = python("-c", IMPORTED, *scenes).splitlines()
    assert len(lines) == 2 * len(scenes)
    for imported, on in zip(lines[::2], lines[1::2], strict=True):
        assert imported == on
        assert "direct" in on


def test_effects_are_switched_off_for_a_study() -> None:
    scene = replace(small("corner"), cells=60)
    whole, without = simulate(scene), simulate(scene, without=["inter_reflection"])
    assert without.transport.far is None
    for a, b in zip(channels(whole.transport.near), channels(without.transport.near), strict=True):
        assert a.data.tobytes() == b.data.tobytes()
    only = simulate(scene, only=["direct"])
    assert [report.need.effect for report in only.reports if report.need.on] == ["direct"]
    assert not only.ambient.any()
    (report,) = (report for report in without.reports if report.need.effect == "inter_reflection")
    assert str(report).endswith("switched off by --without")
    far = simulate(scene, only=["inter_reflection"]).transport
    assert channel(far.near, 0).nnz == 0
    np.testing.assert_allclose(
        far.composition() + without.transport.composition(), whole.transport.composition(), rtol=1e-6
    )
    with pytest.raises(InputError, match="unknown effect 'inter_reflexion'; did you mean 'inter_reflection'"):
        simulate(scene, without=["inter_reflexion"])


def test_the_report_says_what_effects_cost() -> None:
    result = simulate(replace(small("corner"), cells=60))
    by_name = {report.need.effect: report for report in result.reports}
    assert by_name["direct"].entries == channel(result.transport.near, 0).nnz
    far = result.transport.far
    assert far is not None
    ends = [*channels(far.gather), *channels(far.scatter)]
    assert by_name["inter_reflection"].entries == far.mix.matrices.size + sum(matrix.nnz for matrix in ends)
    shares = [by_name[name].energy_share for name in ("direct", "inter_reflection", "ambient_light", "black_level")]
    assert sum(shares) == pytest.approx(1, abs=1e-6)  # rounding to float32
    assert by_name["direct"].energy_share == pytest.approx(1 - sum(shares[1:]), abs=1e-6)


def test_thinned_rows_keep_their_light() -> None:
    scene = replace(small("two_planes"), samples=6)
    exact, thin = simulate(replace(scene, threshold=0.0)), simulate(replace(scene, threshold=0.1))
    assert channel(thin.transport.near, 0).nnz < 0.95 * channel(exact.transport.near, 0).nnz
    # rounding to float32
    np.testing.assert_allclose(thin.transport.composition(), exact.transport.composition(), rtol=1e-5)
    pixels, relative = thin.transport.near.rows, []
    for weights in thin.transport.near.weights.T:
        largest = np.zeros(27 * 48)
        np.maximum.at(largest, pixels, weights)
        relative.append(weights / largest[pixels])
    assert np.max(relative, axis=0).min() > 0.0999  # rounding to float32


def test_an_effect_that_is_off_leaves_the_transport_bit_identical() -> None:
    """A second card behind the back of the first plane needs no effect, and changes nothing."""
    scene = small("wall")
    moved = replace(flat(scene, 0), corner=flat(scene, 0).corner - [0, 0, 1.0])
    behind = replace(scene.surfaces[0], name="behind", shape=moved)
    both = replace(scene, surfaces=(*scene.surfaces, behind))
    assert not needs_of(both)["inter_reflection"].on
    for a, b in zip(*(channels(simulate(s).transport.near) for s in (scene, both)), strict=True):
        assert a.data.tobytes() == b.data.tobytes()
        assert a.indices.tobytes() == b.indices.tobytes()


def test_black_and_ambient_light_add_up() -> None:
    scene = small("wall")
    result = simulate(scene)
    bright = simulate(replace(scene, ambient_irradiance=2 * scene.ambient_irradiance))
    unlit = simulate(replace(scene, projector=replace(scene.projector, black_level=0.0)))
    composition = result.transport.composition().reshape(result.ambient.shape)
    np.testing.assert_allclose(
        result.ambient - unlit.ambient, scene.projector.black_level * composition, atol=1e-7
    )  # rounding to float32
    np.testing.assert_allclose(bright.ambient - result.ambient, unlit.ambient, atol=1e-7)


def test_rays_meet_the_nearest_surface(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path, plane() + rectangle([-0.5, -0.5, 1], [1, 0, 0], [0, 1, 0])))
    hits = trace(np.array([0, 0, 2.0]), np.array([[0, 0, -1.0], [2, 0, -1.0], [0, 0, 1.0]]), scene.surfaces)
    np.testing.assert_array_equal(hits.surface, [1, -1, -1])  # the card, past the plane's edge at x = 3, nothing


# Scene files and the command


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("albedo = [0.5, 0.6, 0.7]", "albedo = [0.5, 0.6, 1.7]", "surfaces 1, albedo: found .* from 0 to 1"),
        ("albedo = [0.5, 0.6, 0.7]", "albedo = [-0.5, 0.6, 0.7]", "surfaces 1, albedo"),
        ("albedo = [0.5, 0.6, 0.7]", "albedo = [0.5, 0.6]", "expected 3 numbers"),
        ("albedo = [0.5, 0.6, 0.7]", "", "found none, expected one of albedo, texture, pattern"),
        ("albedo = [0.5, 0.6, 0.7]", 'texture = "none.png"', "none.png: missing"),
        ("albedo", "albedoo", "found none, expected one of albedo"),
        ("edge_v = [0, 6, 0]", "edge_v = [3, 0, 0]", "span no area"),
        ("[projector]", "[projektor]", r"needs projector; is 'projektor' meant to be it"),
        ("[camera]", "[camera]\nfocus = 3", r"\[camera\]: unknown key 'focus'"),
        ("[camera]", "[camera]\nbrightnes = 3", r"\[camera\]: unknown key 'brightnes'"),
        ("width = 16", "width = 0", "from 1 to 4096"),
        ("width = 16", "width = 16.5", "a whole number"),
        ("look_at = [0, 0, 0]", "look_at = [0, 0, 2]", "the same point"),
        ("look_at = [0, 0, 0]", "look_at = [0, 1, 2]", "looks straight along up"),
        ("horizontal_field_of_view_deg = 30", "horizontal_field_of_view_deg = 200", "from 0.1 to 170"),
        ("position = [0, 0, 2]", "position = [0, 0, nan]", "expected 3 numbers"),
        ("edge_u = [6, 0, 0.0]", "edge_u = 6", "expected 3 numbers"),
        ("corner = ", "corner = = ", "not valid TOML"),
    ],
)
def test_wrong_scenes_name_table_and_key(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    path = scene_file(tmp_path, plane())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=f"{path.name}.*{complaint}"):
        load_scene(path)


BALL = 'shape = "sphere"\ncentre = [0, 0, 0]\nradius = 0.5\n'
RELIEF = 'shape = "relief"\ncorner = [0, 0, 0]\nedge_u = [1, 0, 0]\nedge_v = [0, 1, 0]\nheight = 0.1\n'
PAINT = "albedo = [0.5, 0.5, 0.5]\n"
SEGMENT = "[[0, 0, 0], [0.4, 0.4, 0.4]]"


@pytest.mark.parametrize(
    ("surface", "complaint"),
    [
        (BALL + "dielectric = { index = 0.9 }", r"\[dielectric\], index: found 0.9, expected a number from 1 to 4"),
        (BALL + "dielectric = { index = 1.5, abe = 3 }", r"\[dielectric\]: unknown key 'abe'; did you mean 'abbe'"),
        (BALL + PAINT + "dielectric = { index = 1.5 }", "albedo: a dielectric is clear"),
        (BALL + "dielectric = { index = 1.5 }\ngloss = { roughness = 0 }", "a dielectric takes neither gloss"),
        (RELIEF + 'figure = "waves"\ndielectric = { index = 1.5 }', "dielectric: 'surfaces 1' bounds no solid"),
        (BALL + PAINT + "gloss = { roughness = -0.1 }", r"\[gloss\], roughness: found -0.1"),
        (BALL + PAINT + "gloss = { reflectance = 0.04 }", r"\[gloss\]: needs roughness"),
        (BALL + PAINT + "translucency = { mean_free_path = [1, 1] }", "mean_free_path: found .*expected 3 numbers"),
        (BALL.replace("0.5", "-0.5") + PAINT, "radius: found -0.5"),
        (BALL.replace("sphere", "spere") + PAINT, "shape: found 'spere', expected .*; did you mean 'sphere'"),
        (BALL.replace("centre", "center") + PAINT, "needs centre; is 'center' meant to be it"),
        (RELIEF + PAINT, "expected one of figure and heights"),
        (RELIEF + PAINT + 'figure = "statue"', "figure: found 'statue', .*did you mean 'statuette'"),
        (RELIEF + PAINT + 'heights = "none.png"', "heights: .*none.png: missing"),
        ('shape = "mesh"\nfile = "none.obj"\n' + PAINT, "file: .*none.obj: missing"),
        ('shape = "lathe"\nbase = [0, 0, 0]\nprofile = [[-1, 0], [1, 1]]\n' + PAINT, "profile: a radius is -1"),
        (
            'shape = "card"\ncorner = [0, 0, 0]\nfold = [0, 1, 0]\nwings = [[1, 0, 0]]\n' + PAINT,
            "wings: found .* a list of 2",
        ),
    ],
)
def test_wrong_surfaces_name_the_key(tmp_path: Path, surface: str, complaint: str) -> None:
    with pytest.raises(InputError, match=f"scene.toml: surfaces 1.*{complaint}"):
        load_scene(scene_file(tmp_path, "[[surfaces]]\n" + surface))


@pytest.mark.parametrize(
    ("device", "line", "complaint"),
    [
        ("projector", "aperture = -0.1", r"\[projector\], aperture: found -0.1"),
        ("projector", "focus_distance = 0", r"\[projector\], focus_distance: found 0"),
        ("projector", "vignetting = 1.5", r'\[projector\], vignetting: found 1.5, .* or "cos4"'),
        ("camera", "vignetting = 'cos3'", r"\[camera\], vignetting: found 'cos3'"),
        ("camera", "bloom = { share = 2, radius_deg = 1 }", r"\[bloom\], share: found 2"),
        ("camera", "bloom = { share = 0.1 }", r"\[bloom\]: needs radius_deg"),
        ("camera", "sensor = { bits = 20 }", r"\[sensor\], bits: found 20"),
        ("camera", "brightness = 2", r"\[camera\]: unknown key 'brightness'"),
        ("camera", "wander = -0.1", r"\[camera\], wander: found -0.1, expected a number from 0 to 0.2"),
        ("camera", f"white_segment = {SEGMENT}", r"\[camera\]: white_segment and processing are of a projector"),
        ("projector", "lateral_colour = { shift = [[1, 0]] }", r"\[lateral_colour\], shift: found .*a list of 3"),
        ("projector", "lateral_colour = { scale = [2, 1, 1] }", r"\[lateral_colour\], scale: found .* from 0.9 to 1.1"),
        (
            "projector",
            "lateral_colour = { shifts = [] }",
            r"\[lateral_colour\]: unknown key 'shifts'; did you mean 'shift'",
        ),
        ("projector", "halo = { share = 0.1 }", r"\[halo\]: needs radius_deg"),
        ("projector", "vividness = [5, 0, 0]", r"\[projector\], vividness: found .* 3 numbers from -0.5 to 2"),
        ("projector", f"vividness = [1, 0, 0]\nwhite_segment = {SEGMENT}", "expected one of vividness, processing and"),
    ],
)
def test_wrong_lenses_and_sensors_name_the_key(tmp_path: Path, device: str, line: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        load_scene(scene_file(tmp_path, plane(), **{device: line}))


@pytest.mark.parametrize("device", ["camera", "projector"])
def test_a_device_inside_a_solid(tmp_path: Path, device: str) -> None:
    ball = BALL.replace("[0, 0, 0]", "[0, 0, 2]")
    scene = load_scene(scene_file(tmp_path, f"{plane()}\n[[surfaces]]\nname = 'ball'\n{ball}{PAINT}"))
    other = {"camera": "projector", "projector": "camera"}[device]
    aside = replace(getattr(scene, other), position=np.array([0.0, 0.0, 3.0]))
    with pytest.raises(InputError, match=rf"\[{device}\], position: is inside the solid 'ball'"):
        simulate(replace(scene, **{other: aside}))


def test_devices_that_see_nothing(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path, plane()))
    away = {"position": np.array([0.0, 0.0, -9.0]), "forward": np.array([0.0, 0.0, -1.0])}
    with pytest.raises(InputError, match="the camera sees no surface"):
        simulate(replace(scene, camera=replace(scene.camera, **away)))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="lit by the projector"):
        simulate(replace(scene, projector=replace(scene.projector, **away)))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"need about .* GiB"):
        simulate(replace(scene, camera=scene.camera.resized(4096, 4096), samples=16))


def test_a_matrix_that_would_not_fit_is_refused_when_that_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    row, column = (np.repeat(np.arange(10), 40), np.tile(np.arange(40), 10))
    tenth = 400 * assembly.BYTES_AN_ENTRY
    # most entries for which T fits: a tenth, and nine tenths of half the length
    for most, fits in ((5.6 * tenth, True), (5.4 * tenth, False)):
        monkeypatch.setattr(assembly, "MAX_BYTES", int(most))
        near = assembly.NearLight((100, 50), 0.0, "blurred")
        if fits:
            near.add_band(0, 10, row, column, np.ones((400, 3)))
            continue
        with pytest.raises(InputError, match=r"blurred: T would take about .* \(10 % of its rows take"):
            near.add_band(0, 10, row, column, np.ones((400, 3)))


@pytest.mark.parametrize(("name", "has_far"), [("wall", False), ("corner", True)])
def test_the_command_writes_a_calibration(tmp_path: Path, name: str, has_far: bool) -> None:
    scene = SCENES / f"{name}.toml"
    out = succeed("simulate", scene, "-o", tmp_path / "room", "--camera", "96x72", "--projector", "80x60")
    assert ("inter_reflection" in out) == has_far
    stored = calibration.read(tmp_path / "room")
    assert stored.calibration.camera.shape == (72, 96)
    assert stored.calibration.mask.mean() > 0.4
    transport = read_transport(stored)
    assert (transport.far is not None) == has_far
    assert "--force" in fail("simulate", scene, "-o", tmp_path / "room")
    assert command("simulate", scene, "-o", tmp_path / "room", "--camera", "20").returncode == 2


def test_compensating_the_corner_takes_the_far_light_out(tmp_path: Path) -> None:
    """In a small scene `corner`, compensation must gain 8 dB over plain projection, judged by the whole T."""
    room = tmp_path / "corner"
    here("simulate", SCENES / "corner.toml", "-o", room, "--camera", "120x68", "--projector", "96x54")
    here("build", room)
    figures = []
    clip = SCENES.parent / "media" / "big_buck_bunny.mp4"
    for option in ([], ["--no-compensation"]):
        out = here("play", room, clip, "--start", "2", "--output", tmp_path / "c.png", "--view", "camera", *option)
        figures.append(float(out.rpartition("PSNR ")[2].split()[0]))
    assert figures[0] >= figures[1] + 8
    assert figures[0] > 25


def test_explain_without_writing(tmp_path: Path) -> None:
    scene = SCENES / "wall.toml"
    out = succeed("simulate", scene, "--explain", "--camera", "24x18", "--projector", "24x18")
    assert "inter_reflection  off" in out
    assert "one plane" in out
    assert list(tmp_path.iterdir()) == []
    assert "give -o FOLDER, --explain or both" in fail("simulate", scene)
    assert "unknown effect 'shadow'; did you mean 'shadows'" in fail(
        "simulate", scene, "--explain", "--without", "shadow"
    )
