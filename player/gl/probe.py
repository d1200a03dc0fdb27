"""Reports this machine's OpenGL and screens as JSON, in a child process, so that the parent survives a crashing driver.

Run as `python -m counterlight.gl.probe opengl` or `… screen`.
"""

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from typing import Any

from counterlight.gl.context import headless_context
from counterlight.gl.monitors import list_monitors


def probe_opengl() -> dict[str, Any]:
    """Return vendor, renderer, version and largest texture of an OpenGL context made through EGL, without a screen."""
    with headless_context() as context:
        info = context.info
        return {
            "vendor": info["GL_VENDOR"],
            "renderer": info["GL_RENDERER"],
            "version": info["GL_VERSION"],
            "max_texture_size": info["GL_MAX_TEXTURE_SIZE"],
        }


def probe_screen() -> dict[str, Any]:
    """Return the monitors that GLFW sees, including monitors of the null platform and of Xvfb."""
    return {"monitors": [dataclasses.asdict(monitor) | {"text": str(monitor)} for monitor in list_monitors()]}


PROBES: dict[str, Callable[[], dict[str, Any]]] = {"opengl": probe_opengl, "screen": probe_screen}


def main(argv: Sequence[str]) -> int:
    """Print the result, or `{"error": …}` for any failure."""
    try:
        answer = PROBES[argv[0]]()
    except Exception as error:  # drivers and bindings raise any exception
        answer = {"error": " ".join(str(error).split())}
    print(json.dumps(answer))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
