"""Builds programs from the GLSL files of counterlight.shaders, with defines; errors report the file's line numbers."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import resources

import moderngl

from counterlight.errors import DrawingError

VERTEX = "fullscreen.vert"


class ShaderError(DrawingError):
    """A product shader does not compile on this driver: an internal fault, with file and line."""


INCLUDE = re.compile(r'^#include "([\w.]+)"$', re.MULTILINE)


def read_source(name: str) -> str:
    """Return the text of an installed shader with its includes; all line numbers are kept."""
    text = resources.files("counterlight.shaders").joinpath(name).read_text(encoding="utf-8")
    return INCLUDE.sub(lambda found: _included(found, text), text)


def _included(found: re.Match[str], text: str) -> str:
    line = text.count("\n", 0, found.start()) + 1
    return f"#line 1\n{read_source(found[1])}#line {line + 1}"


def with_defines(source: str, defines: Mapping[str, int | None]) -> str:
    """Insert `#define NAME VALUE` after the #version line, keeping the file's line numbers."""
    version, _, rest = source.partition("\n")
    lines = [f"#define {name}{'' if value is None else f' {value}'}" for name, value in defines.items()]
    return "\n".join([version, *lines, "#line 2", rest])


def build_program(
    context: moderngl.Context, name: str, defines: Mapping[str, int | None] | None = None
) -> moderngl.Program:
    """Compile and link one fragment shader with the full-screen triangle."""
    source = with_defines(read_source(name), defines or {})
    with _naming(name):
        return context.program(vertex_shader=read_source(VERTEX), fragment_shader=source)


def build_compute_program(
    context: moderngl.Context, name: str, defines: Mapping[str, int | None] | None = None
) -> moderngl.ComputeShader:
    """Compile and link one compute shader; the context must offer OpenGL 4.3."""
    with _naming(name):
        return context.compute_shader(with_defines(read_source(name), defines or {}))


@contextmanager
def _naming(name: str) -> Iterator[None]:
    """Convert a compiler error to a ShaderError with the file's name and line."""
    try:
        yield
    except moderngl.Error as error:
        line = re.search(r"\b0[:(](\d+)", str(error))
        where = f"{name}:{line.group(1)}" if line else name
        raise ShaderError(f"shaders/{where}: {' '.join(str(error).split())}") from error
