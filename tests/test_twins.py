"""Every shader names its CPU twin. The twin exists, and the reference renderer runs it."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from counterlight.media.frames import radiance_frame
from counterlight.pipeline import adaptation, encoding, reference, reference_renderer
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.reference_renderer import ReferenceRenderer
from counterlight.pipeline.views import VIEWS
from tests.coloured_rooms import with_mixing
from tests.refined_rooms import physical_room
from tests.rooms import CAMERA, yuv_frame
from tests.viewed_rooms import as_set, two_views

ROOT = Path(__file__).resolve().parents[1]
TWIN = re.compile(r"^// CPU twin: ([\w.]+) in ([\w/]+\.py)\.$", re.MULTILINE)
WITHOUT = {"present.frag"}  # composites picture and page onto the window; other tests compare its pixels on the screen
PINNED = ((0.1, 0.1), (0.9, 0.0), (0.9, 0.9), (0.0, 1.0))


def named() -> dict[str, tuple[str, str]]:
    """Return shader -> twin and the twin's file."""
    shaders = [path for path in sorted((ROOT / "shaders").iterdir()) if path.suffix in (".frag", ".comp")]
    found = {path.name: TWIN.search(path.read_text()) for path in shaders if path.name not in WITHOUT}
    assert [name for name, match in found.items() if match is None] == []
    return {name: (match[1], match[2]) for name, match in found.items() if match is not None}


def test_every_shader_but_the_window_s_names_a_twin_that_is_there() -> None:
    for shader, (twin, file) in named().items():
        defined = (ROOT / file).read_text()
        assert re.search(rf"^ *(def|class) {twin.rpartition('.')[2]}\b", defined, re.MULTILINE), f"{shader}: {twin}"


def test_the_renderer_without_opengl_runs_every_twin(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: set[str] = set()

    def watched(name: str, twin: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **words: Any) -> Any:
            ran.add(name)
            return twin(*arguments, **words)

        return run

    homes = {
        f"player/pipeline/{home.__name__.rpartition('.')[2]}.py": home for home in (adaptation, encoding, reference)
    }
    twins = {twin: homes[file] for twin, file in named().values() if file in homes}
    for name in twins.keys() - {"PreparedRows"}:
        original = getattr(twins[name], name)
        monkeypatch.setattr(twins[name], name, watched(name, original))
        for shader, drawn in reference_renderer.TWINS.items():
            if drawn is original:
                monkeypatch.setitem(reference_renderer.TWINS, shader, watched(name, original))
    monkeypatch.setattr(reference_renderer, "PreparedRows", watched("PreparedRows", reference.PreparedRows))
    frame, radiance = yuv_frame(rng, (9, 15)), radiance_frame(rng.uniform(size=(*CAMERA, 3)).astype(np.float32))
    mixing = ReferenceRenderer(with_mixing(physical_room(rng).room, rng))
    mixing.open(radiance.format)
    mixing.upload(radiance)
    mixing.render("camera", compensate=True)
    between = ReferenceRenderer(as_set(two_views()))
    between.open(frame.format)
    between.upload(frame)
    between.render("projector", compensate=True, steps=1)
    renderer = ReferenceRenderer(physical_room(rng).room)
    renderer.open(frame.format)
    for adjustments in (Adjustments(), Adjustments(adapt=3, flicker=0.5, clipping=True, corners=PINNED)):
        renderer.adjust(adjustments)
        for view in VIEWS:
            renderer.upload(frame)
            renderer.render(view, compensate=True, steps=1)
            renderer.certificate()
    assert twins.keys() - ran == set()
