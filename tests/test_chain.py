"""Chains against numpy: products of factors and their transposes, and what a manifest must list of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.files.reading import read_toml
from counterlight.maps.chain import Chain, Operator
from counterlight.maps.room_maps import CHAINS, FOLDER, MANIFEST, read_maps
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.transport.transport import Dense, Transport, dense_rows, in_one, transposed
from tests.rooms import write_blurred_room

CAMERA, CELLS, PROJECTOR = 13, 5, 11  # pixels, cells, pixels
ROUNDING = 1e-12  # float64 sums of at most 11 terms, twice or three times


@pytest.fixture
def factors(rng: np.random.Generator) -> list[np.ndarray]:
    """D, M and U, (3, rows, columns) each, with gaps in D and U."""
    shapes = (CELLS, PROJECTOR), (CELLS, CELLS), (CAMERA, CELLS)
    D, M, U = (rng.uniform(size=(3, *shape)) for shape in shapes)
    return [D * (D > 0.4), M, U * (U > 0.4)]


@pytest.mark.parametrize("mixed", [True, False])
def test_a_chain_is_the_product_of_its_factors(
    factors: list[np.ndarray], mixed: bool, rng: np.random.Generator
) -> None:
    D, M, U = factors
    chain = Chain(dense_rows(D), Dense(M) if mixed else None, dense_rows(U))
    whole = U @ (M if mixed else np.eye(CELLS)) @ D
    p, c = rng.uniform(size=(PROJECTOR, 3)), rng.uniform(size=(CAMERA, 3))
    backwards = transposed(chain)
    assert backwards is not None
    assert len(chain.factors) == 2 + mixed
    light, gathered = np.einsum("kij,jk->ik", whole, p), np.einsum("kij,ik->jk", whole, c)
    for operator, given, expected in (
        (chain.apply, p, light),
        (chain.apply_transpose, c, gathered),
        (backwards.apply, c, gathered),
        (backwards.apply_transpose, p, light),
    ):
        np.testing.assert_allclose(operator(given), expected, rtol=ROUNDING)


def test_each_changes_every_factor_in_place(factors: list[np.ndarray]) -> None:
    D, M, U = factors
    chain: Chain[Operator, Operator | None] = Chain(dense_rows(D), Dense(M), dense_rows(U))
    assert chain.each(id).factors == tuple(map(id, chain.factors))
    assert replace(chain, mix=None).each(id).mix is None


def test_transport_adds_its_chains_to_near_light(factors: list[np.ndarray], rng: np.random.Generator) -> None:
    D, M, U = factors
    far, blurred = Chain(dense_rows(D), Dense(M), dense_rows(U)), Chain(dense_rows(D), None, dense_rows(U))
    S = rng.uniform(size=(3, CAMERA, PROJECTOR))
    T = Transport(dense_rows(S), far, blurred=blurred)
    assert T.chains == [blurred, far]
    whole, p = S + U @ M @ D + U @ D, rng.uniform(size=(PROJECTOR, 3))
    np.testing.assert_allclose(T.apply(p), np.einsum("kij,jk->ik", whole, p), rtol=ROUNDING)
    found = in_one(T).weights.T.reshape(3, CAMERA, PROJECTOR)
    np.testing.assert_allclose(found, whole, rtol=1e-6)  # rounding to float32


def test_maps_without_one_factor_of_a_chain_are_refused(rng: np.random.Generator, tmp_path: Path) -> None:
    write_blurred_room(tmp_path, rng, (12, 16), (9, 14), cells=4)
    stored = calibration.read(tmp_path)
    build_room_maps(stored, InverseOptions())
    manifest = tmp_path / FOLDER / MANIFEST
    complete = read_toml(manifest, "")
    read_maps(stored)
    for missing in {name for chain in ("far", "undo", "dual") for name in CHAINS[chain]}:
        listed = {name: sizes for name, sizes in complete["maps"].items() if name != missing}
        assert len(listed) == len(complete["maps"]) - 1
        manifest.write_text(tomli_w.dumps(complete | {"maps": listed}))
        with pytest.raises(InputError, match=missing):
            read_maps(stored)
