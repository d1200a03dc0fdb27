"""build --inverse thesis, play --refine 0: clamp(T⁺ (c − e)) of chapter 5 against numpy's pseudo-inverse."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

import counterlight as cl
from counterlight import calibration
from counterlight.errors import InputError
from counterlight.files.manifest import describe_files, write_toml
from counterlight.pipeline.room import read_room
from counterlight.tools.clusters.decomposition import Parameters, decompose
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.near_light import THESIS_CLUSTER, InverseOptions
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import Csr, channels, in_one, luminance
from tests.programs import ROOT, fail, succeed
from tests.rooms import write_blurred_room

CAMERA, PROJECTOR, CELLS = (16, 22), (13, 17), 6
BY_HAND = Parameters(5, 0.3, 0.9)
TAU = 0.02


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """Return a room in which every camera pixel sees far light from every projector pixel."""
    write_blurred_room(tmp_path / "room", np.random.default_rng(5), CAMERA, PROJECTOR, CELLS)
    return tmp_path / "room"


def random_room(rng: np.random.Generator, camera: tuple[int, int], projector: tuple[int, int]) -> cl.Room:
    """Return T with a few random connections per camera pixel. Some camera and projector pixels have none."""
    shape = camera[0] * camera[1], projector[0] * projector[1]
    unseeing = np.arange(shape[0]) % 7 == 0
    T = sparse.diags_array(1.0 - unseeing) @ sparse.random_array(shape, density=3 / shape[1], rng=rng)
    tints = (1.0, 0.8, 0.6)
    ambient = rng.uniform(0, 0.05, (*camera, 3))
    made = [T * tint for tint in tints]
    return cl.Room.from_matrices(*made, camera=camera, projector=projector, ambient=ambient, response="linear")


def pseudo_inverses(matrices: tuple[Csr, ...]) -> list[np.ndarray]:
    """Return Moore-Penrose inverses, without the singular values that float32 cannot distinguish from 0."""
    dense = [T.toarray().astype(np.float64) for T in matrices]
    return [np.linalg.pinv(T, rcond=max(T.shape) * 2.0**-23) for T in dense]


def assert_drive(found: np.ndarray, inverses: list[np.ndarray], b: np.ndarray) -> None:
    for i, T_pinv in enumerate(inverses):
        expected = np.clip(T_pinv @ b[:, i], 0, 1)
        allowed = 2e-5 + 1e-6 * (np.abs(T_pinv) @ np.abs(b[:, i]))  # float32 weights, sums and light
        assert np.all(np.abs(found[..., i].ravel() - expected) <= allowed)


@pytest.mark.parametrize("backend", ["gl", "cpu"])
@pytest.mark.parametrize(("camera", "projector"), [((11, 15), (9, 13)), ((7, 9), (10, 12))])
def test_the_drive_is_the_pseudo_inverse_clamped(
    rng: np.random.Generator, camera: tuple[int, int], projector: tuple[int, int], backend: str
) -> None:
    """The test includes light that no pixel can show, and light below the ambient light."""
    room = random_room(rng, camera, projector)
    maps = cl.build_maps(room, inverse="thesis", max_error=0.0)
    inverses = pseudo_inverses(channels(room.parts.near))
    with cl.Renderer(room, maps, backend=backend) as renderer:
        for picture in (rng.uniform(0, 2, (*camera, 3)), np.zeros((*camera, 3)), np.ones((*camera, 3))):
            drive = renderer.render(picture, refine=0)
            assert_drive(drive, inverses, (picture * maps.white - room.ambient).reshape(-1, 3))


@pytest.mark.parametrize("backend", ["gl", "cpu"])
def test_a_cut_has_the_pseudo_inverse_of_the_cut_and_fitted_transport(
    rng: np.random.Generator, room: Path, backend: str
) -> None:
    """A threshold cuts T with far light, by command and in Python. The test cuts the same entries itself."""
    cut = "--cut", 5, 0.3, 0.9
    succeed("build", room, "--inverse", "thesis", "--max-error", 0, "--tau", TAU, *cut)
    known = cl.read_room(room)
    maps = cl.read_maps(room)
    in_python = cl.build_maps(known, inverse="thesis", max_error=0, tau=TAU, parameters=BY_HAND)
    for name, packed in maps.named().items():
        np.testing.assert_array_equal(in_python.named()[name].entries, packed.entries)
    kept = in_one(known.parts, TAU * maps.white)
    assert luminance(kept.weights).min() >= TAU * maps.white
    floodlights = (each.apply(np.ones((kept.columns, 3))) for each in (known.parts, kept))
    fitted = kept.scaled(np.divide(*floodlights))
    inverses = pseudo_inverses(channels(decompose(fitted, CAMERA, PROJECTOR, BY_HAND).near))
    picture = rng.uniform(0, 1.5, (*CAMERA, 3))
    with cl.Renderer(known, maps, backend=backend) as renderer:
        drive = renderer.render(picture, refine=0)
    assert_drive(drive, inverses, (picture * maps.white - known.ambient).reshape(-1, 3))


def test_the_threshold_is_of_near_and_far_light_together(room: Path, rng: np.random.Generator) -> None:
    transport = read_transport(calibration.read(room))
    whole, some = in_one(transport), in_one(transport, 0.01)
    assert whole.indices.size == np.prod(transport.shape)  # far light reaches everything
    assert some.indices.size == np.count_nonzero(luminance(whole.weights) >= 0.01)
    drive = rng.uniform(size=(transport.shape[1], 3))
    np.testing.assert_allclose(whole.apply(drive), transport.apply(drive), rtol=2e-6)  # float32 entries, all positive


def test_its_maps_undo_no_far_light_and_are_played_without_a_step(room: Path) -> None:
    out = succeed("build", room, "--inverse", "thesis")
    kept = r"\d+ connections above τ 0.001 of white cut to \d+ \(radius \d+, τ₁ [\d.]+\)"
    assert re.search(rf"\nmaps: T⁺ as the thesis computes it, {kept}, .*; play makes no step\n", out)
    manifest = tomllib.loads((room / "correction" / "manifest.toml").read_text())
    assert manifest["options"]["inverse"] == manifest["inverse"]["chosen"] == "thesis"
    assert manifest["options"]["regularize"] == manifest["inverse"]["damping"] == 0.0
    assert manifest["decomposition"]["largest_cluster"] <= THESIS_CLUSTER
    assert manifest["play"] == {"start": "previous", "steps": 0}
    assert manifest["bounded"] is False
    read = read_room(room, None)
    assert read.default_steps == 0
    assert read.maps.undo is None
    assert read.maps.far is not None  # the room as the camera sees it has far light


def test_a_map_whose_far_light_is_half_gone_is_refused(room: Path) -> None:
    succeed("build", room)
    path = room / "correction" / "manifest.toml"
    manifest = tomllib.loads(path.read_text())
    del manifest["maps"]["undo_mix"]
    write_toml(path, manifest)
    assert "undo_mix" in fail("play", room, room / "mask.png", "--output", room.parent / "out.png")


def test_a_cut_by_hand_is_for_the_damped_inverse_too(room: Path) -> None:
    succeed("build", room, "--cut", 2, 0.5, 1)
    manifest = tomllib.loads((room / "correction" / "manifest.toml").read_text())
    assert manifest["inverse"]["chosen"] == "cut"
    assert manifest["bounded"] is True
    cut = manifest["decomposition"]
    assert (cut["radius"], cut["tau_1"], cut["tau_2"]) == (2.0, 0.5, 1.0)


def test_one_dense_matrix_that_does_not_fit_is_refused(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = describe_files(room)
    monkeypatch.setattr("counterlight.memory.available_bytes", lambda: 1 << 23)
    with pytest.raises(InputError, match=r"near and far light in one T, of 352x221 entries, needs about 0\.0 GiB"):
        build_room_maps(calibration.read(room), InverseOptions(inverse="thesis", tau=0.0))
    assert describe_files(room) == before


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--inverse", "thesis", "--regularize", "0.1"], "--regularize 0.1: --inverse thesis takes plain"),
        (["--inverse", "thesis", "--tau", "1"], "--tau 1: expected 0 up to 1"),
        (["--tau", "0.01"], "--tau 0.01: the threshold of --inverse thesis"),
        (["--inverse", "none", "--cut", "2", "1", "1"], "--inverse none: cuts nothing; leave --cut 2 1 1 out"),
        (["--cut", "2", "1"], "argument --cut: expected 3 arguments"),
        (["--cut", "2", "1", "1", "--max-cluster", "9"], "--cut 2 1 1: --max-cluster 9 finds its own"),
        (["--cut", "-1", "1", "1"], "--cut -1 1 1: found radius -1, expected 0 or more"),
        (["--cut", "2", "2", "1"], "--cut 2 2 1: found TAU_1 2, expected a fraction from 0 to 1"),
    ],
)
def test_cuts_that_contradict_themselves_are_one_line(room: Path, options: list[str], complaint: str) -> None:
    assert complaint in fail("build", room, *options)
    assert not (room / "correction").exists()


def test_the_lines_of_the_mathematics_reach_their_figure(capsys: pytest.CaptureFixture[str]) -> None:
    block = re.search(r"```python\n(.*?)```", (ROOT / "docs" / "mathematics.md").read_text(), re.DOTALL)
    assert block
    names: dict[str, np.ndarray] = {}
    exec(compile(block[1], "docs/mathematics.md", "exec"), names)
    assert f"# {capsys.readouterr().out.splitlines()[0]}\n" in block[1]
    np.testing.assert_allclose(names["same"], names["drive"], atol=2e-5)  # float32 weights and sums
