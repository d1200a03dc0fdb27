"""The inverse that a build chooses, the reason that it prints, and how the maps are then played."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from counterlight.command import DONE
from counterlight.errors import InputError
from counterlight.pipeline.refinement import Advice, advice_of, default_steps
from counterlight.pipeline.room import read_room
from counterlight.tools.clusters.components import find_clusters
from counterlight.tools.inverse import near_light, price
from counterlight.tools.inverse.damping import choose_damping
from counterlight.tools.inverse.memory import ENTRY_BYTES, bytes_of_windows
from counterlight.tools.inverse.near_light import Inverse, InverseOptions, invert_near_light
from counterlight.tools.inverse.price import Price, price_of_clusters, price_of_windows
from counterlight.tools.inverse.rows import Truncation
from counterlight.tools.transport.transport import channels, stacked
from tests.programs import command, fail, succeed
from tests.rooms import blurred_transport, write_blurred_room

CAMERA, PROJECTOR = (44, 60), (36, 50)  # 1800 projector pixels in one cluster, so that windows are used


def invert(sigma: float, options: InverseOptions) -> Inverse:
    near = stacked((blurred_transport(np.random.default_rng(3), CAMERA, PROJECTOR, sigma),) * 3)
    reach = np.full((CAMERA[0] * CAMERA[1], 3), 0.5)
    return invert_near_light(near, np.ones(CAMERA, bool), PROJECTOR, reach, 0.5, options)


def test_a_small_room_is_inverted_whole() -> None:
    found = invert(0.5, InverseOptions())
    assert (found.chosen, found.reason, found.decomposition) == ("whole", "", None)
    assert found.residual.max() <= found.window_tolerance


def test_what_would_take_too_long_is_cut_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(price, "MOST_SECONDS", 0.0)
    monkeypatch.setattr(near_light, "MAX_CLUSTER", 100)
    monkeypatch.setattr(near_light, "price_of_clusters", lambda *_: Price())
    found = invert(0.5, InverseOptions())
    assert found.chosen == "cut"
    assert found.reason.startswith("it would take")
    assert found.clusters.projector_sizes.max() <= 100


def test_windows_that_would_miss_their_tolerance_are_known_before_the_work() -> None:
    found = invert(1.5, InverseOptions(damping=1e-3))
    assert found.chosen == "cut"
    assert "of its windows would miss their tolerance" in found.reason
    # with more damping, the windows meet the tolerance
    assert invert(1.5, InverseOptions(damping=0.3)).chosen == "whole"


def test_where_not_even_a_cut_pays_direct_mapping_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(price, "MOST_SECONDS", -1.0)
    found = invert(0.5, InverseOptions())
    assert found.chosen == "none"
    assert "cut, it would take" in found.reason
    lengths = np.diff(found.T_pinv.indptr)
    assert lengths.max() == 1


def test_direct_mapping_inverts_a_room_of_one_to_one_pixels() -> None:
    shades = np.linspace(0.2, 1, 30).astype(np.float32)
    T = sparse.csr_array(sparse.diags_array(shades))
    arguments = stacked((T,) * 3), np.ones((5, 6), bool), (5, 6), np.ones((30, 3)), 0.5
    found = invert_near_light(*arguments, InverseOptions(inverse="none"))
    for each in channels(found.T_pinv):
        np.testing.assert_allclose(each.toarray(), np.diag(1 / shades), rtol=1e-6)  # rounding to float32


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"inverse": "half"}, "--inverse half: expected auto, whole, cut, none, thesis"),
        ({"inverse": "whole", "max_cluster": 50}, "--inverse whole: cuts nothing; leave --max-cluster 50 out"),
        ({"inverse": "none", "max_cluster": 50}, "--inverse none: cuts nothing"),
    ],
)
def test_options_that_contradict_each_other(options: dict[str, object], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        InverseOptions(**options)


def test_the_price_of_windows_is_that_of_the_whole_room() -> None:
    """The price is estimated from the rows that the samples touch, and matches the entries of the whole build."""
    T = blurred_transport(np.random.default_rng(3), CAMERA, PROJECTOR, 0.5)
    truncation = Truncation(np.full((T.shape[0], 3), 0.5), 0.5 / 255)
    found = price_of_windows(T, 0.1, None, np.ones(PROJECTOR, bool), truncation, 0.5 / 255, ())
    built = invert_near_light(
        stacked((T,) * 3), np.ones(CAMERA, bool), PROJECTOR, truncation.reach, 0.5, InverseOptions(0.1, inverse="whole")
    )
    assert found.failing == 0
    # λ is relative to σ₁, which is 1 within a fifth here; a few windows represent all.
    entries = (found.needed - bytes_of_windows(T, T.shape[1])) / ENTRY_BYTES
    assert entries == pytest.approx(built.T_pinv.indices.size, rel=0.3)


def test_more_clusters_cost_more() -> None:
    one = sparse.csr_array(np.ones((8, 6)))
    few, many = (find_clusters(sparse.csr_array(sparse.block_diag([one] * count))) for count in (3, 30))
    prices = [price_of_clusters(each, np.ones(each.count, bool)).seconds for each in (few, many)]
    assert prices[1] == pytest.approx(10 * prices[0], rel=1e-9)


def test_damping_of_a_large_picture_is_chosen_on_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    camera, projector = (90, 100), (76, 84)
    T, mask = blurred_transport(np.random.default_rng(3), camera, projector, 0.7), np.ones(camera, bool)
    whole = choose_damping(T, 0.5, mask)
    monkeypatch.setattr("counterlight.tools.inverse.damping.SMALL", 100)
    monkeypatch.setattr("counterlight.tools.inverse.pictures.SIDE", 30)
    found = choose_damping(T, 0.5, mask)
    assert found.damping == whole.damping
    assert found.errors != whole.errors
    for damping, error in found.errors.items():
        assert error == pytest.approx(whole.errors[damping], rel=0.25)  # a photograph differs from place to place


def test_the_maps_say_how_they_are_played_and_options_prevail(tmp_path: Path) -> None:
    write_blurred_room(tmp_path / "room", np.random.default_rng(5), (30, 40), (24, 32))
    *lines, said = succeed("build", tmp_path / "room").splitlines()
    (rate,) = [line for line in lines if line.startswith("play draws ")][:1]
    assert re.fullmatch(r"play draws \d+(\.\d)? frames per second here with \d+ steps", rate)
    assert any(line.startswith("maps: the whole T⁺, ") for line in lines)
    result = (
        rf"{tmp_path / 'room'}: ready to play, built in \d+\.\d s; next: counterlight play {tmp_path / 'room'} MEDIA"
    )
    assert re.fullmatch(result, said)
    assert not re.search("λ|clusters|fill", "\n".join((*lines, said)))
    manifest = tmp_path / "room" / "correction" / "manifest.toml"
    advice = tomllib.loads(manifest.read_text())["play"]
    curve = advice["below_optimum_db"][advice["start"]]
    assert curve == sorted(curve, reverse=True)  # momentum may increase the error, but not here
    room = read_room(tmp_path / "room", None)
    assert (room.start, room.default_steps) == (advice["start"], advice["steps"])
    other = "map" if advice["start"] != "map" else "direct"
    room = read_room(tmp_path / "room", None, start=other)
    assert (room.start, room.default_steps) == (other, default_steps(other))
    text = manifest.read_text()
    manifest.write_text(text[: text.index("[play]")] + text[text.index("[maps") :])
    room = read_room(tmp_path / "room", None)
    assert room.start == "previous"


def test_a_camera_that_is_coarser_than_the_projector_is_named(tmp_path: Path) -> None:
    for name, camera, warned in (("coarse", (15, 20), True), ("fine", (30, 40), False)):
        write_blurred_room(tmp_path / name, np.random.default_rng(5), camera, (24, 32))
        outcome = command("build", tmp_path / name)
        assert outcome.returncode == DONE
        assert ("300 camera pixels see 768 projector pixels" in outcome.stderr) == warned


@pytest.mark.parametrize("play", [{"start": "moon", "steps": 4}, {"start": "map", "steps": -1}, {"start": "map"}, 3])
def test_damaged_advice_is_refused(play: object) -> None:
    with pytest.raises(InputError, match=r"manifest.toml.*rebuild"):
        advice_of({"play": play}, "manifest.toml", "rebuild it")
    assert advice_of({"play": {"start": "map", "steps": 6}}, "", "") == Advice("map", 6)


def test_no_steps_no_advice(tmp_path: Path) -> None:
    write_blurred_room(tmp_path / "room", np.random.default_rng(5), (30, 40), (24, 32))
    said = succeed("build", tmp_path / "room", "--no-refine", "--inverse", "none")
    assert "no T⁺, direct mapping" in said
    assert read_room(tmp_path / "room", None).default_steps == 0


def test_a_room_too_large_is_refused_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from counterlight.tools.inverse import memory

    monkeypatch.setattr("counterlight.memory.available_bytes", lambda: 1 << 30)
    with pytest.raises(InputError, match=r"a room of 9000 million entries needs about .* GiB .* use --no-refine"):
        memory.check_room(9_000_000_000, 0, 4_000_000)
    assert "--inverse" in fail("build", tmp_path, "--inverse", "half")
