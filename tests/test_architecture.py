"""docs/architecture.md names files that exist and the passes of the plan; the plan matches traces of frames."""

import re
from pathlib import Path

import numpy as np
import pytest

from counterlight.pipeline.frame_passes import listed, passes_of_frame
from tests.frame_trace import trace
from tests.refined_rooms import physical_room
from tests.rooms import yuv_frame

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("far", [True, False])
@pytest.mark.parametrize("steps", [0, 1, 2])
def test_the_passes_of_a_frame_are_those_of_the_plan(rng: np.random.Generator, steps: int, far: bool) -> None:
    traced = trace(physical_room(rng, far=far).room, yuv_frame(rng, (9, 14)), steps=steps)
    assert traced == [name for name, _ in passes_of_frame(steps=steps, far=far)]


def test_the_page_lists_the_passes_of_the_plan() -> None:
    assert f"\n\n{listed()}\n\n" in PAGE


def test_every_file_that_the_page_names_exists() -> None:
    named = re.findall(r"`((?:player|tools|tests|shaders)/[\w/]*(?:\.\w+)?)`", PAGE)
    assert len(named) > 20
    assert [name for name in named if "NAME" not in name and "VERB" not in name and not (ROOT / name).exists()] == []
