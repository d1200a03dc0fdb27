"""Messages between the player and its watcher: messages survive any cut of the stream, and damage is refused."""

from itertools import pairwise

import numpy as np
import pytest

from counterlight.pipeline.shown_copies import factor_of, reduced_boxes
from counterlight.raster import Region
from counterlight.unattended import watch_link
from counterlight.unattended.watch_link import Answer, Light, Message, Picture, Projected, Situation, Start, Unpacker
from tests.oracles.formulas import grid_means, reduced

BOXES = Region(0, 0, 11, 6), Region(11, 0, 7, 9)


def test_messages_survive_any_cut_of_the_stream(rng: np.random.Generator) -> None:
    sent: list[Message] = [
        Start("room", ("v4l2:0", "v4l2:2"), (0.033,), 4, 1 / 60, "folder"),
        Light(1.25, rng.random((*watch_link.GRID, 3), np.float32)),
        Picture(1.25, rng.random((5, 7, 3), np.float32).astype(np.float16)),
        Situation(frozen=True),
    ]
    stream, unpacker, came = b"".join(map(watch_link.packed, sent)), Unpacker(), list[Message]()
    cuts = [0, *np.sort(rng.integers(0, len(stream), 40)).tolist(), len(stream)]
    for start, end in pairwise(cuts):
        came += unpacker.feed(stream[start:end])
    assert len(came) == len(sent)
    for before, after in zip(sent, came, strict=True):
        assert type(before) is type(after)
        for name, value in vars(before).items():
            np.testing.assert_array_equal(getattr(after, name), value)
    with pytest.raises(ValueError, match="kind"):
        list(unpacker.feed(b"\0" * watch_link.HEADER.size))


def test_an_answer_survives_its_line() -> None:
    rows = ((1.0, 0.0, 0.5), (0.0, 1.0, -0.25), (0.0, 0.0, 1.0))
    answer = Answer("correcting", "why", (Projected(rows, (0.9, 1, 1), 0.01),), (((0.1, 0.2, 0.3),),), 0.5, 0.07, 3)
    assert np.array_equal(np.array(Answer.parse(answer.line()).projectors[0].to_raster), rows)
    assert Answer.parse(answer.line()).line() == answer.line()
    thinking = answer.line().replace(b"correcting", b"thinking")
    for line, said in ((b"{}", "no answer"), (b"[]", "no answer"), (b"no", "value"), (thinking, "'thinking'")):
        with pytest.raises(ValueError, match=said):
            Answer.parse(line)


def test_pictures_are_reduced_projector_by_projector(rng: np.random.Generator) -> None:
    drive = rng.random((9, 18, 3))
    found = reduced(drive, BOXES, 4)
    assert reduced_boxes(BOXES, 4) == [(0, 0, 3, 2), (3, 0, 2, 3)]
    assert found.shape == (3, 5, 3)
    for (left, top, columns, rows), cell in (((8, 4, 3, 2), (1, 2)), ((15, 8, 3, 1), (2, 4)), ((11, 0, 4, 4), (0, 3))):
        mean = drive[top : top + rows, left : left + columns].mean(axis=(0, 1))
        np.testing.assert_allclose(found[cell], mean, rtol=1e-3)  # half floats have 11 bits
    assert not found[2, :3].any()
    picture = rng.random((50, 70, 3))
    np.testing.assert_allclose(grid_means(picture)[5, 9], picture[10:12, 19:21].mean(axis=(0, 1)), rtol=1e-6)
    assert factor_of(1920) == 4
    assert factor_of(100) == 1
