"""docs/architecture.md matches the code: the files that it names, and the passes of a frame."""

import re
from pathlib import Path

import numpy as np

from tests.frame_trace import trace
from tests.refined_rooms import physical_room
from tests.rooms import yuv_frame

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_the_passes_of_a_frame_are_those_of_the_page(rng: np.random.Generator) -> None:
    room = physical_room(rng).room
    listed = re.findall(r"(?m)^\d+\. `([^`]+)`", PAGE[PAGE.index("## The path of a frame") :].partition("\n## ")[0])
    assert trace(room, yuv_frame(rng, (9, 14)), steps=1) == listed


def test_every_file_that_the_page_names_exists() -> None:
    named = re.findall(r"`((?:player|tools|tests|shaders)/[\w/]*(?:\.\w+)?)`", PAGE)
    assert len(named) > 20
    assert [name for name in named if "NAME" not in name and "VERB" not in name and not (ROOT / name).exists()] == []
