"""Words of 4 bytes: the format, the largest loss, and a room's light in words."""

from dataclasses import replace

import numpy as np
import pytest

from counterlight.maps import row_map
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import SparseRows, pack, unpack
from counterlight.maps.sliced_map import GROUP, NO_PIXEL, word_parts
from counterlight.maps.small_map import (
    FULL_TRUST,
    LARGEST_CODE,
    colours_of,
    unpacked_words,
)
from counterlight.maps.word_map import WordMap
from counterlight.maps.word_runs import in_words
from counterlight.tools.inverse.words_fit import Fit, fit
from counterlight.tools.inverse.words_light import words_of
from tests.refined_rooms import physical_room
from tests.small_rooms import as_long, coded, random_small, with_words

EXACT = 1e-12  # float64 sums


def read_words(words: np.ndarray) -> tuple[list[int], list[tuple[int, ...]], float]:
    """Return indices, codes and trust of one run, decoded from the format's description alone."""
    pixel, indices, codes, trust, k = 0, [], [], 1.0, 0
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
    assert np.abs(found / large - 1).max() <= 2.0**-13  # half a unit of the 12 bits after the leading bit
    np.testing.assert_array_equal(coded(found.astype(float)), found)
    assert coded(np.array([1e9]))[0] == LARGEST_CODE


def test_words_say_every_entry_and_trust(rng: np.random.Generator) -> None:
    """Entries with one, three and one channel's codes, negative entries, far jumps, empty rows."""
    small = random_small(rng, (7, 9), (300, 400), trusted=True)
    made = in_words(small)
    kinds = set((made.words & 7).tolist())
    assert {0, 3, 5, 7} <= kinds
    assert kinds & {1, 2, 4}
    assert small.trust is not None
    for row in range(63):
        indices, codes, trust = read_words(made.words[made.starts[row] : made.starts[row + 1]])
        own = slice(small.indptr[row], small.indptr[row + 1])
        np.testing.assert_array_equal(indices, small.indices[own])
        np.testing.assert_array_equal(np.reshape(codes, (-1, 3)), small.codes[own])
        assert trust == (small.trust[row] / FULL_TRUST if small.trust[row] else 1)


@pytest.mark.parametrize("lanes", [1, 8, 64])
@pytest.mark.parametrize("most", [1, 1 << 20])
def test_workgroups_read_every_entry_once(rng: np.random.Generator, lanes: int, most: int) -> None:
    small = random_small(rng, (11, 23), (40, 50))
    rows = unpack(pack(small.unpacked(), (11, 23), (40, 50)))
    found, parts = np.zeros((rows.shape[0], 2000, 3)), list(word_parts(WordMap.of(small), lanes, most))
    assert (len(parts) > 1) == (most == 1)
    for part in parts:
        for run in range(part.rows.shape[0] * lanes):
            at, colour = part.rows[run // lanes]
            base, length = part.groups[run // GROUP]
            indices, codes, _ = read_words(part.words[base + run % GROUP :: GROUP][:length])
            if at == NO_PIXEL:
                assert not indices
            for index, code in zip(indices, codes, strict=True):
                found[(at >> 16) * 23 + (at & 0xFFFF), index] += code * colours_of(np.array([colour]))[0].astype(float)
    expected = np.zeros_like(found)
    expected[rows.rows, rows.indices] = rows.weights
    np.testing.assert_allclose(small.scale * found, expected, rtol=1e-6)  # `pack` rounds to float32


def worst_change(rows: SparseRows, found: Fit, reach: np.ndarray) -> np.ndarray:
    """Return each row's largest change: the sum of all excesses or of all shortfalls, whichever is larger."""
    colours = colours_of(found.colours)[rows.rows].astype(float)
    change = (found.scale * found.codes * colours - rows.weights) * reach[rows.indices]
    sums = [replace(rows, weights=np.maximum(sign * change, 0)).sums() for sign in (1.0, -1.0)]
    return np.maximum(*sums)


def several_colours(rng: np.random.Generator, *, share: float) -> SparseRows:
    """Return 200 rows of 0 to 40 entries. A share of the entries differs from its row's colour."""
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
    """⟨w C ∘ T' u, v⟩ = ⟨u, Tᵀ' (w C ∘ v)⟩ of the codes T', for any colours."""
    small = random_small(rng, (7, 9), (20, 30))
    u, v = rng.uniform(size=(600, 3)), rng.uniform(size=(63, 3))
    back = small.transposed(None, None).unpacked().apply(v * colours_of(small.colours).astype(float))
    np.testing.assert_allclose((small.unpacked().apply(u) * v).sum(axis=0), (u * back).sum(axis=0), rtol=EXACT)


def test_words_are_read_as_they_were_made(rng: np.random.Generator) -> None:
    """Some greens and blues look like other kinds of words."""
    small = random_small(rng, (40, 50), (300, 400), trusted=True)
    indptr, indices, codes, trust = unpacked_words(in_words(small))
    np.testing.assert_array_equal(indptr, small.indptr)
    np.testing.assert_array_equal(indices, small.indices)
    np.testing.assert_array_equal(codes, small.codes)
    assert small.trust is not None
    np.testing.assert_array_equal(trust, np.where(small.trust == 0, FULL_TRUST, small.trust))


@pytest.mark.parametrize("far", [False, True])
def test_a_room_s_light_is_certified(rng: np.random.Generator, far: bool) -> None:
    room = with_words(physical_room(rng, far=far).room)
    words = room.maps.words
    assert words is not None
    assert 0 < words.used <= 0.8
    assert len(words.maps) == (8 if far else 2)
    long = as_long(room.maps)
    for _ in range(20):
        drive = (rng.uniform(size=(room.calibration.projector.pixels, 3)) < rng.uniform()).astype(float)
        change = np.abs(observed(long, drive) - observed(room.maps, drive)).max()
        assert 0 < 255 * change / room.maps.white <= 0.5 * words.used


@pytest.mark.parametrize("far", [False, True])
def test_rows_at_a_time_leave_no_trace(rng: np.random.Generator, far: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    maps = physical_room(rng, far=far).room.maps
    whole = words_of(maps, 0.5)
    monkeypatch.setattr(row_map, "BLOCK", 100)
    banded = words_of(maps, 0.5)
    assert whole is not None
    assert banded is not None
    assert banded.used == whole.used
    for name, each in whole.maps.items():
        np.testing.assert_array_equal(banded.maps[name].words, each.words)
        np.testing.assert_array_equal(banded.maps[name].rows, each.rows)


def observed(maps: RoomMaps, drive: np.ndarray) -> np.ndarray:
    """Return T p."""
    seen = unpack(maps.transport).apply(drive)
    if maps.far is not None:
        for part in (maps.far.gather, maps.far.mix, maps.far.scatter):
            drive = unpack(part).apply(drive)
        seen += drive
    return np.asarray(seen)


def test_a_room_that_asks_for_more_keeps_its_entries(rng: np.random.Generator) -> None:
    maps = physical_room(rng).room.maps
    for max_error in (1e-4, 0.0):
        assert words_of(maps, max_error) is None
    assert words_of(replace(maps, refinement=None), 0.5) is None


def test_words_are_judged_beside_the_white_that_is_shown(rng: np.random.Generator) -> None:
    maps = with_words(physical_room(rng).room).maps
    assert maps.words is not None
    darkest = maps.words.used * maps.white
    assert len(maps.in_words(maps.white)) == len(maps.in_words(1.01 * darkest)) == 8
    assert maps.in_words(0.99 * darkest) == {}


def test_a_word_an_entry_where_a_row_has_one_colour(rng: np.random.Generator) -> None:
    words = with_words(physical_room(rng, far=False).room).maps.words
    assert words is not None
    for made in words.maps.values():
        small = made.unpacked()
        assert (np.ptp(small.codes, axis=1) == 0).all()
