"""Builds and plays rooms with blurred light: against numpy's dense T, and by whole commands."""

import shutil
import tomllib
from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.files.manifest import write_toml
from counterlight.maps.room_maps import read_maps
from counterlight.maps.row_map import unpack
from counterlight.media.frames import radiance_frame
from counterlight.passes.colour import LUMINANCE
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.room import Room
from counterlight.tools.acquisition.registration import _without_far
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.inverse import refinement_maps
from counterlight.tools.inverse.build import BuiltRoom, build_maps, build_room_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import Transport
from tests.blurred_rooms import CAMERA, PROJECTOR, calibrated, discs, far_light, in_blocks, write_room, written_out
from tests.mutants import READ, REFUSED, DamagedRoom, mutant, outcome
from tests.oracles.renderer import ReferenceRenderer
from tests.programs import fail, succeed

RADIUS = 6.0
FLOAT32 = 1e-5  # share of full drive or of white: sums of a few hundred float32 terms per step


def built(rng: np.random.Generator, *, far: bool) -> tuple[Transport, BuiltRoom]:
    T = in_blocks(discs(rng, RADIUS))
    if far:
        T = replace(T, far=far_light(T.shape))
    return T, build_maps(tier_of(calibrated(T), T), InverseOptions())


@pytest.mark.parametrize("far", [False, True])
def test_its_maps_multiply_as_the_dense_transport(rng: np.random.Generator, far: bool) -> None:
    T, made = built(rng, far=far)
    maps, dense = made.maps, written_out(T.without_far)
    assert maps.blurred is not None
    assert maps.refinement is not None
    assert maps.refinement.blurred_dual is not None
    assert maps.words is None
    near, scatter, gather = (unpack(part) for part in (maps.transport, maps.blurred.scatter, maps.blurred.gather))
    p = rng.uniform(size=(T.shape[1], 3))
    seen = near.apply(p) + scatter.apply(gather.apply(p))
    np.testing.assert_allclose(seen, np.einsum("cij,jc->ic", dense, p), atol=FLOAT32)
    dual = maps.refinement.blurred_dual
    c, weights = rng.uniform(size=(T.shape[0], 3)), maps.refinement.weights.reshape(-1, 1)
    back = unpack(maps.refinement.dual).apply(c) + unpack(dual.scatter).apply(unpack(dual.gather).apply(c))
    np.testing.assert_allclose(back, np.einsum("cij,ic->jc", dense, weights * c), atol=FLOAT32)


def test_blocks_that_many_pixels_see_are_gathered_in_parts(
    rng: np.random.Generator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A narrow texture forces cells with several parts.

    Maps read from the folder still multiply like the dense transport.
    """
    T = in_blocks(discs(rng, RADIUS))
    write_room(tmp_path / "room", T)
    monkeypatch.setattr(refinement_maps, "MAX_TEXTURE_WIDTH", 20)
    stored = calibration.read(tmp_path / "room")
    build_room_maps(stored, InverseOptions())
    further = read_maps(stored).refinement
    assert further is not None
    assert further.blurred_dual is not None
    gather, scatter = further.blurred_dual.factors
    assert gather.lookup[..., 2].max() == 20
    assert T.blurred is not None
    assert gather.lookup[..., 2].astype(bool).sum() > T.blurred.gather.shape[0]
    c = rng.uniform(size=(T.shape[0], 3))
    back = unpack(further.dual).apply(c) + unpack(scatter).apply(unpack(gather).apply(c))
    expected = np.einsum("cij,ic->jc", written_out(T), further.weights.reshape(-1, 1) * c)
    np.testing.assert_allclose(back, expected, atol=FLOAT32)


@pytest.mark.parametrize("far", [False, True])
def test_a_frame_is_the_steps_of_the_dense_transport(rng: np.random.Generator, far: bool) -> None:
    T, made = built(rng, far=far)
    room = Room(made.calibration, made.maps, made.maps.white, start="grey")
    frame = radiance_frame(rng.choice([0.02, 0.3, 0.6], (*CAMERA, 3)).astype(np.float32))
    b = np.stack([plane[: CAMERA[0], : CAMERA[1]] for plane in frame.planes], axis=-1) - made.calibration.ambient
    objective = objective_of(T, made.calibration, DEFAULT_AIMS)
    drive = next(islice(objective.steps(np.full((T.shape[1], 3), 0.5), objective.bounded(b.reshape(-1, 3))), 5, None))
    seen = np.einsum("cij,jc->ic", written_out(T), drive).reshape(*CAMERA, 3) + made.calibration.ambient
    for renderer in (CpuRenderer(room), ReferenceRenderer(room)):
        renderer.open(frame.format)
        renderer.upload(frame)
        renderer.render("projector", compensate=True, steps=5)
        # division by T·1 amplifies rounding
        np.testing.assert_allclose(renderer.linear().reshape(-1, 3), drive, atol=10 * FLOAT32)
        renderer.render("camera", compensate=True, steps=5)
        np.testing.assert_allclose(renderer.linear(), seen, atol=10 * FLOAT32)


def test_what_full_drive_gives_without_far_light_is_near_and_blurred(rng: np.random.Generator) -> None:
    T, made = built(rng, far=True)
    renderer = ReferenceRenderer(Room(made.calibration, made.maps, made.maps.white))
    most = renderer._main_view.views.most[..., :3].reshape(-1, 3)
    np.testing.assert_allclose(most, written_out(T.without_far).sum(axis=2).T, atol=FLOAT32)


@pytest.mark.parametrize("option", [{"inverse": "whole"}, {"max_cluster": 50}, {"inverse": "cut"}, {"damping": 0.0}])
def test_what_asks_for_an_inverse_is_refused(rng: np.random.Generator, option: dict[str, object]) -> None:
    T = in_blocks(discs(rng, RADIUS))
    with pytest.raises(InputError, match=r"--inverse (whole|cut): blurred light is kept in blocks of pixels"):
        build_maps(tier_of(calibrated(T), T), InverseOptions(**option))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("blurred") / "room"
    write_room(folder, in_blocks(discs(np.random.default_rng(11), RADIUS)))
    return folder


def test_commands_build_play_relight_and_compensate(room: Path, tmp_path: Path) -> None:
    out = succeed("build", room, "--report", tmp_path / "report")
    assert "no T⁺, direct mapping (blurred light is kept in blocks of pixels)" in out
    picture, shown = tmp_path / "picture.png", tmp_path / "shown.png"
    letters = np.random.default_rng(2).choice([40, 200], (*CAMERA, 1)).repeat(3, axis=2).astype(np.uint8)
    cv2.imwrite(str(picture), letters)
    succeed("play", room, picture, "--output", shown, "--frames", "1")
    assert cv2.imread(str(shown)).shape == (*PROJECTOR, 3)
    succeed("relight", room, picture, "--view", "dual", "-o", tmp_path / "dual.png")
    solved = succeed("compensate", room, picture, "--solver", "map,box,nnls")
    assert all(name in solved for name in ("map", "box", "nnls"))
    said = fail("compensate", room, picture, "--solver", "nnls", "--max-cluster", "50")
    assert "--max-cluster 50: blurred light is kept in blocks of pixels" in said
    assert "--inverse whole: blurred light" in fail("build", room, "--inverse", "whole")
    assert "kept in blocks of pixels" in fail("study", room, "-o", tmp_path / "study")


def test_maps_of_which_a_part_is_gone_are_refused(room: Path, tmp_path: Path) -> None:
    succeed("build", room)
    path = room / "correction" / "manifest.toml"
    manifest = tomllib.loads(path.read_text())
    del manifest["maps"]["blurred_scatter"]
    write_toml(path, manifest)
    assert "blurred_scatter" in fail("play", room, room / "mask.png", "--output", tmp_path / "out.png")


def test_damaged_blurred_light_is_read_or_refused(room: Path, tmp_path: Path) -> None:
    """Sixty mutants of the file with renewed checksums are read or refused. So is damage that mutants rarely have."""
    shutil.copytree(room, tmp_path / "room", ignore=shutil.ignore_patterns("correction"))
    damaged, name = DamagedRoom.of(tmp_path / "room"), "blurred_light.npz"
    found = set()
    for i in range(60):
        content = mutant(damaged.files[name], name, np.random.default_rng([20061122, i]))
        damaged.put(name, content)
        found.add(outcome(lambda: read_transport(calibration.read(damaged.folder))))
    assert found == {READ, REFUSED}  # otherwise the mutants are too mild or too harsh
    with np.load(room / name) as stored:
        parts = dict(stored)
    wrong = {"cells": np.array(0)}, {"scatter_red_data": parts["scatter_red_data"] * np.nan}
    for change, complaint in zip(wrong, ("0 cells, expected 1 to", "are NaN or infinite"), strict=True):
        np.savez(tmp_path / "other.npz", **(parts | change))  # type: ignore[arg-type]
        damaged.put(name, (tmp_path / "other.npz").read_bytes())
        with pytest.raises(InputError, match=rf"blurred_light\.npz: .*{complaint}"):
            read_transport(calibration.read(damaged.folder))


def test_a_shift_of_the_projector_is_looked_for_with_all_its_light(rng: np.random.Generator) -> None:
    T = in_blocks(discs(rng, RADIUS))
    rows, columns = np.arange(150, 450), np.arange(100, 700)
    found = _without_far(T, rows, columns)
    dense = np.einsum("cij,c->ij", written_out(T), LUMINANCE)[np.ix_(rows, columns)]
    p, c = rng.normal(size=(columns.size, 8)), rng.normal(size=rows.size)
    np.testing.assert_allclose(found @ p, dense @ p, atol=FLOAT32)
    np.testing.assert_allclose(found.T @ c, dense.T @ c, atol=FLOAT32)
