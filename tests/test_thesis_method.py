"""build --method thesis: near and far light in one T, cut, its energy fitted, inverted plainly (thesis 4.2.2, 5.1)."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.files.manifest import describe_files, write_toml
from counterlight.maps.row_map import unpack
from counterlight.pipeline.room import read_room
from counterlight.tools.clusters.decomposition import Parameters, decompose
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.near_light import THESIS_CLUSTER, InverseOptions
from counterlight.tools.transport.objective import ObjectiveOptions
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import channels, in_one
from tests.programs import fail, succeed
from tests.rooms import write_blurred_room

CAMERA, PROJECTOR, CELLS = (16, 22), (13, 17), 6
BY_HAND = Parameters(5, 0.3, 0.9)


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """Every camera pixel sees far light from every projector pixel."""
    write_blurred_room(tmp_path / "room", np.random.default_rng(5), CAMERA, PROJECTOR, CELLS)
    return tmp_path / "room"


def test_near_and_far_light_in_one_matrix_do_what_both_do(room: Path, rng: np.random.Generator) -> None:
    transport = read_transport(calibration.read(room))
    whole = in_one(transport)
    assert whole.indices.size == np.prod(transport.shape)  # far light reaches everything
    drive = rng.uniform(size=(transport.shape[1], 3))
    np.testing.assert_allclose(whole.apply(drive), transport.apply(drive), rtol=2e-6)  # float32 entries, all positive


def test_without_far_light_nothing_is_written_out(tmp_path: Path) -> None:
    write_blurred_room(tmp_path / "room", np.random.default_rng(5), CAMERA, PROJECTOR)
    transport = read_transport(calibration.read(tmp_path / "room"))
    assert in_one(transport) is transport.near


@pytest.mark.parametrize("options", [{"parameters": BY_HAND}, {}])
def test_it_is_the_pseudo_inverse_of_the_cut_transport(room: Path, options: dict[str, Parameters]) -> None:
    """Whatever drift is expected: the thesis knows neither weights nor a prior."""
    stored = calibration.read(room)
    asked = InverseOptions(method="thesis", max_error=0.0, **options)
    built = build_room_maps(stored, asked, ObjectiveOptions(drift=0.3))
    assert built.inverse.decomposition is not None
    parameters, report = built.inverse.decomposition
    assert parameters == BY_HAND if options else report.largest_cluster <= THESIS_CLUSTER
    cut = decompose(in_one(read_transport(stored).inside(stored.calibration.mask)), CAMERA, PROJECTOR, parameters)
    for found, T in zip(channels(built.inverse.T_pinv), channels(cut.near), strict=True):
        expected = np.linalg.pinv(T.toarray().astype(np.float64), rcond=max(T.shape) * 2.0**-23)
        error = np.abs(found.toarray() - expected).max()
        assert error <= 1e-5 * np.abs(expected).max()  # float32 weights, of clusters apart and of all at once


def test_its_maps_undo_no_far_light_and_are_played_without_a_step(room: Path) -> None:
    out = succeed("build", room, "--method", "thesis")
    assert out.splitlines()[-1].split(": ", 1)[1].startswith("T⁺ as the thesis computes it, ")
    assert "; play makes no step; next: " in out
    manifest = tomllib.loads((room / "correction" / "manifest.toml").read_text())
    assert manifest["options"]["method"] == manifest["inverse"]["chosen"] == "thesis"
    assert manifest["options"]["regularize"] == manifest["inverse"]["damping"] == 0.0
    assert manifest["play"] == {"start": "previous", "steps": 0}
    read = read_room(room, None)
    assert read.default_steps == 0
    assert read.maps.undo is None
    assert read.maps.far is not None  # what the camera will see has far light in it
    assert unpack(read.maps.correction).shape == (np.prod(PROJECTOR), np.prod(CAMERA))


def test_a_map_whose_far_light_is_half_gone_is_refused(room: Path) -> None:
    succeed("build", room)
    path = room / "correction" / "manifest.toml"
    manifest = tomllib.loads(path.read_text())
    del manifest["maps"]["undo_mix"]
    write_toml(path, manifest)
    assert "undo_mix" in fail("play", room, room / "mask.png", "--output", room.parent / "out.png")


def test_a_cut_by_hand_is_for_the_damped_inverse_too(room: Path) -> None:
    succeed("build", room, "--radius", "2", "--tau-1", "0.5")
    manifest = tomllib.loads((room / "correction" / "manifest.toml").read_text())
    assert manifest["inverse"]["chosen"] == "cut"
    cut = manifest["decomposition"]
    assert (cut["radius"], cut["tau_1"], cut["tau_2"]) == (2.0, 0.5, 1.0)


def test_one_dense_matrix_that_does_not_fit_is_refused(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = describe_files(room)
    monkeypatch.setattr("counterlight.memory.available_bytes", lambda: 1 << 23)
    with pytest.raises(InputError, match=r"near and far light in one T, of 352x221 entries, needs about 0\.0 GiB"):
        build_room_maps(calibration.read(room), InverseOptions(method="thesis"))
    assert describe_files(room) == before


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--method", "thesis", "--regularize", "0.1"], "--method thesis takes plain pseudo-inverses"),
        (["--method", "thesis", "--inverse", "whole"], "--inverse whole: cuts nothing; leave --method thesis out"),
        (["--inverse", "none", "--radius", "2", "--tau-1", "1"], "--inverse none: cuts nothing; leave --radius out"),
        (["--radius", "2"], "--tau-1: not given"),
        (["--tau-2", "1"], "--radius: not given"),
        (["--radius", "2", "--tau-1", "1", "--max-cluster", "9"], "--max-cluster 9 finds its own"),
        (["--radius", "-1", "--tau-1", "1"], "--radius -1.0: expected 0 or more"),
        (["--radius", "2", "--tau-1", "2"], "--tau-1 2.0: expected a fraction from 0 to 1"),
    ],
)
def test_cuts_that_contradict_themselves_are_one_line(room: Path, options: list[str], complaint: str) -> None:
    assert complaint in fail("build", room, *options)
    assert not (room / "correction").exists()
