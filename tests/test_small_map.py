"""Words of 4 bytes: the format, what is lost by them at most, and a whole room's light in them."""

from dataclasses import replace

import numpy as np
import pytest

from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import SparseRows, pack, unpack
from counterlight.maps.sliced_map import GROUP, NO_PIXEL
from counterlight.maps.sliced_words import word_parts
from counterlight.maps.small_correction import small_correction
from counterlight.maps.small_fit import Fit, fit
from counterlight.maps.small_light import small_light
from counterlight.maps.small_map import (
    FULL_TRUST,
    LARGEST_CODE,
    SmallMap,
    coded,
    colours_of,
    in_words,
    words_of_entries,
)
from tests.refined_rooms import physical_room
from tests.rooms import CAMERA, random_room
from tests.small_rooms import random_small, with_bound

EXACT = 1e-12  # of float64 sums


def read_words(words: np.ndarray, pixel: int) -> tuple[list[int], list[tuple[int, ...]], float]:
    """Indices, codes and trust of one run, by the format's text alone."""
    indices, codes, trust, k = [], [], 1.0, 0
    while k < len(words):
        word = int(words[k])
        kind, code = word & 7, word >> 16
        if kind == 0:
            pixel += word >> 3
        elif kind == 5:
            trust = code / FULL_TRUST
        else:
            pixel += word >> 3 & 0x1FFF
            own = code_of(code)
            codes.append(tuple(own if kind >> k & 1 else 0 for k in range(3)))
            if kind == 3:
                k += 1
                codes[-1] = (own, code_of(int(words[k]) & 0xFFFF), code_of(int(words[k]) >> 16))
            indices.append(pixel)
        k += 1
    return indices, codes, trust


def code_of(bits: int) -> int:
    exponent, fraction = bits >> 12 & 7, bits & 0xFFF
    size = fraction if exponent == 0 else (4096 + fraction) << (exponent - 1)
    return -size if bits >> 15 else size


def test_a_code_is_the_nearest_of_13_bits() -> None:
    small, large = np.arange(-8192.0, 8193), np.geomspace(8192, LARGEST_CODE, 1000)
    np.testing.assert_array_equal(coded(small), small)
    found = coded(large)
    assert np.abs(found / large - 1).max() <= 2.0**-13  # half of a unit of 12 bits behind the first
    np.testing.assert_array_equal(coded(found.astype(float)), found)
    assert coded(np.array([1e9]))[0] == LARGEST_CODE


def test_words_say_every_entry_and_trust(rng: np.random.Generator) -> None:
    """Entries of one, three and one channel's codes, negative ones, far jumps, empty rows."""
    small = random_small(rng, (7, 9), (300, 400), trusted=True)
    made = in_words(small, np.zeros(63, np.int64))
    kinds = set((made.words & 7).tolist())
    assert {0, 3, 5, 7} <= kinds
    assert kinds & {1, 2, 4}
    assert small.trust is not None
    for row in range(63):
        indices, codes, trust = read_words(made.words[made.starts[row] : made.starts[row + 1]], 0)
        own = slice(small.indptr[row], small.indptr[row + 1])
        np.testing.assert_array_equal(indices, small.indices[own])
        np.testing.assert_array_equal(np.reshape(codes, (-1, 3)), small.codes[own])
        assert trust == (small.trust[row] / FULL_TRUST if small.trust[row] else 1)


@pytest.mark.parametrize("lanes", [1, 8, 64])
@pytest.mark.parametrize("most", [1, 1 << 20])
def test_workgroups_read_every_entry_once(rng: np.random.Generator, lanes: int, most: int) -> None:
    small = random_small(rng, (11, 23), (40, 50))
    rows = unpack(pack(small.unpacked(), (11, 23), (40, 50)))
    found, parts = np.zeros((rows.shape[0], 2000, 3)), list(word_parts(small, lanes, most))
    assert (len(parts) > 1) == (most == 1)
    for part in parts:
        for run in range(part.rows.shape[0] * lanes):
            at, first, colour = part.rows[run // lanes]
            base, length = part.groups[run // GROUP]
            indices, codes, _ = read_words(part.words[base + run % GROUP :: GROUP][:length], int(first))
            if at == NO_PIXEL:
                assert not indices
            for index, code in zip(indices, codes, strict=True):
                found[(at >> 16) * 23 + (at & 0xFFFF), index] += code * colours_of(np.array([colour]))[0].astype(float)
    expected = np.zeros_like(found)
    expected[rows.rows, rows.indices] = rows.weights
    np.testing.assert_allclose(small.scale * found, expected, rtol=1e-6)  # `pack` rounds to float32


def worst_change(rows: SparseRows, found: Fit, reach: np.ndarray) -> np.ndarray:
    """Of every row, by the two sources that could be worst: all of what is too much, all of what is too little."""
    colours = colours_of(found.colours)[rows.rows].astype(float)
    change = (found.scale * found.codes * colours - rows.weights) * reach[rows.indices]
    sums = [replace(rows, weights=np.maximum(sign * change, 0)).sums() for sign in (1.0, -1.0)]
    return np.maximum(*sums)


def several_colours(rng: np.random.Generator, *, share: float) -> SparseRows:
    """200 rows of 0 to 40 entries, each of its row's colour but for a share."""
    lengths = rng.integers(0, 40, 200)
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    indices = np.concatenate([np.sort(rng.choice(300, n, replace=False)) for n in lengths])
    owner = np.repeat(np.arange(200), lengths)
    colours = rng.uniform(0.05, 1, (200, 3)) * 10 ** rng.uniform(-3, 2, (200, 1))
    weights = colours[owner] * rng.uniform(0, 1, (owner.size, 1)) ** 3
    other = rng.uniform(size=owner.size) < share
    weights[other] *= rng.uniform(0, 3, (int(other.sum()), 3))
    return SparseRows(indptr, indices, weights, 300)


@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
def test_what_is_allowed_is_kept_and_certified(rng: np.random.Generator, share: float) -> None:
    rows, reach = several_colours(rng, share=share), rng.uniform(0.5, 2, (300, 3))
    allowed = np.maximum(replace(rows, weights=rows.weights * reach[rows.indices]).sums() / 1000, 1e-9)
    found = fit(rows, reach, allowed)
    assert (found.change <= allowed).all()
    np.testing.assert_allclose(found.change, worst_change(rows, found, reach), atol=1e-9 * allowed.max())
    wide = (np.ptp(found.codes, axis=1) > 0).mean()
    assert 0.5 * share <= wide <= 1.5 * share + 0.01  # a channel of 5 % of the largest is known to 1/410


def test_what_cannot_be_kept_is_said(rng: np.random.Generator) -> None:
    rows, reach = several_colours(rng, share=0.5), np.ones((300, 3))
    found = fit(rows, reach, np.full((200, 3), 1e-12))
    assert found.change.max() > 1e-12
    np.testing.assert_allclose(found.change, worst_change(rows, found, reach), rtol=1e-9)


def test_the_transpose_has_the_same_numbers(rng: np.random.Generator) -> None:
    """⟨w C ∘ T' u, v⟩ = ⟨u, Tᵀ' (w C ∘ v)⟩ of the codes T', whatever the colours."""
    small = random_small(rng, (7, 9), (20, 30))
    u, v = rng.uniform(size=(600, 3)), rng.uniform(size=(63, 3))
    back = small.transposed(None, None).unpacked().apply(v * colours_of(small.colours).astype(float))
    np.testing.assert_allclose((small.unpacked().apply(u) * v).sum(axis=0), (u * back).sum(axis=0), rtol=EXACT)


@pytest.mark.parametrize("far", [False, True])
def test_a_room_s_light_is_certified(rng: np.random.Generator, far: bool) -> None:
    room = with_bound(physical_room(rng, far=far).room)
    small = small_light(room.maps, room.white)
    assert small is not None
    assert 0 < small.change <= small.allowed == 0.5
    assert len(small.maps) == (8 if far else 2)
    assert small.entry_bytes < 8
    for _ in range(20):
        drive = (rng.uniform(size=(room.calibration.projector.pixels, 3)) < rng.uniform()).astype(float)
        change = np.abs(observed(room.maps, small.maps, drive) - observed(room.maps, {}, drive)).max()
        assert 0 < 255 * change / room.white <= small.change


def observed(maps: RoomMaps, small: dict[int, SmallMap], drive: np.ndarray) -> np.ndarray:
    """T p, by small maps where there are any."""
    rows = {id(packed): unpack(packed) for packed in maps.named().values()}
    rows |= {key: found.unpacked() for key, found in small.items()}
    seen = rows[id(maps.transport)].apply(drive)
    if maps.far is not None:
        cells = rows[id(maps.far.mix)].apply(rows[id(maps.far.gather)].apply(drive))
        seen += rows[id(maps.far.scatter)].apply(cells)
    return np.asarray(seen)


def test_a_room_that_asks_for_more_keeps_its_entries(rng: np.random.Generator) -> None:
    room = physical_room(rng).room
    assert small_light(room.maps, room.white) is None  # says no bound
    fine = small_light(with_bound(room, 1e-4).maps, room.white)
    assert fine is not None
    assert not fine.certified
    assert small_light(with_bound(room, 0.0).maps, room.white) is None
    assert small_light(replace(with_bound(room).maps, refinement=None), room.white) is None
    assert small_light(with_bound(room, 8.0).maps, room.white).allowed == 0.5  # type: ignore[union-attr]


def test_a_word_an_entry_where_a_row_has_one_colour(rng: np.random.Generator) -> None:
    room = with_bound(physical_room(rng, far=False).room)
    small = small_light(room.maps, room.white)
    assert small is not None
    for found in small.maps.values():
        np.testing.assert_array_equal(words_of_entries(found), 1)


@pytest.mark.parametrize(("max_error_codes", "certified"), [(0.11, False), (1.0, True)])
def test_the_correction_is_certified_while_both_bounds_fit(
    rng: np.random.Generator, max_error_codes: float, certified: bool
) -> None:
    maps = thin_room(rng, max_error_codes, left_out=0.1 / 255)
    ambient = np.zeros((*CAMERA, 3), np.float32)
    words = small_correction(maps, maps.white, ambient)
    assert words is not None
    rows, kept = unpack(maps.correction), words.map.unpacked()
    lost = (written_out(rows) - written_out(kept)) * maps.white
    assert words.change == pytest.approx(0.1 / 255 + np.abs(lost).sum(axis=1).max(), rel=1e-6)
    assert words.certified == certified
    brighter = small_correction(maps, 10 * maps.white, ambient)
    assert brighter is None or brighter.change > 1 / 255
    assert small_correction(maps, 20 * maps.white, ambient) is None  # what was left out is already more


def test_a_map_without_a_bound_keeps_its_entries(rng: np.random.Generator) -> None:
    maps = random_room(rng, far=False).maps
    assert small_correction(maps, 1.0, np.zeros((*CAMERA, 3), np.float32)) is None


def thin_room(rng: np.random.Generator, max_error_codes: float, left_out: float) -> RoomMaps:
    details = {"options": {"max_error_codes": max_error_codes}, "certified": {"truncation_drive": left_out}}
    return replace(random_room(rng, far=False).maps, details=details)


def written_out(rows: SparseRows) -> np.ndarray:
    """(rows, columns, channels); entries of one place add up."""
    dense = np.zeros((*rows.shape, 3))
    np.add.at(dense, (rows.rows, rows.indices), rows.weights)
    return dense
