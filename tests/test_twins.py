"""Every shader belongs to a pass, and a pass names the inputs of its shader."""

import importlib
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from counterlight.gl.shaders import read_source
from counterlight.passes.drawing import Draw, Pass

ROOT = Path(__file__).resolve().parents[1]
MODULE = re.compile(r"^// Pass: player/([\w/]+)\.py\.$", re.MULTILINE)
WITHOUT = {"present.frag"}  # composites picture and page onto the window; other tests compare its pixels on the screen
UNIFORMS = re.compile(r"^uniform \w+ ([\w, ]+)", re.MULTILINE)


def modules() -> dict[str, str]:
    """Return shader -> import name of the pass' module."""
    shaders = [path for path in sorted((ROOT / "shaders").iterdir()) if path.suffix in (".frag", ".comp")]
    found = {path.name: MODULE.search(path.read_text()) for path in shaders if path.name not in WITHOUT}
    assert [name for name, match in found.items() if match is None] == []
    return {name: "counterlight." + match[1].replace("/", ".") for name, match in found.items() if match is not None}


def test_every_shader_but_the_window_s_names_the_module_of_its_pass() -> None:
    named = modules()
    for shader, module in named.items():
        text = (ROOT / "player" / Path(*module.split(".")[1:]).with_suffix(".py")).read_text()
        assert shader in text, f"{shader}: {module} does not name it"
    drawn = {each.shader for each in PASSES}
    assert drawn <= named.keys()
    assert len(drawn) > 15


def passes() -> list[type[Draw[Any]]]:
    for module in set(modules().values()):
        importlib.import_module(module)
    return sorted({*Draw.__subclasses__(), *Pass.__subclasses__()} - {Pass}, key=lambda each: each.__name__)


PASSES = passes()


def inputs(kind: Any) -> set[str]:
    """Return the names of a pass' pictures and numbers, without the defines."""
    found = set[str]()
    hints = get_type_hints(kind)
    for field in fields(kind):
        hint = hints[field.name]
        groups = [each for each in (hint, *get_args(hint)) if is_dataclass(getattr(each, "__origin__", each))]
        if groups:
            found |= inputs(getattr(groups[0], "__origin__", groups[0]))
        elif hint is not bool:
            found.add(field.name)
    return found


@pytest.mark.parametrize("made", PASSES)
def test_a_pass_has_the_inputs_of_its_shader_and_a_cpu_function(made: type[Draw[Any]]) -> None:
    source = read_source(made.shader)
    named = {name.strip() for names in UNIFORMS.findall(source) for name in names.split(",")}
    own = inputs(made)
    if "SLOPE" in made.defines:
        assert own < named
    else:
        assert own == named
    for define in (field.name.upper() for field in fields(made) if field.type is bool):
        assert f"#ifdef {define}" in source
    assert "fill" in vars(made) or "fill_both" in vars(made)
