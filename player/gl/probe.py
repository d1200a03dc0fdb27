"""What this machine's OpenGL and screens offer, as JSON, for a parent that must survive a driver that crashes.

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
    """Vendor, renderer, version and largest texture of an OpenGL context made through EGL, without a screen."""
    with headless_context() as context:
        info = context.info
        return {
            "vendor": info["GL_VENDOR"],
            "renderer": info["GL_RENDERER"],
            "version": info["GL_VERSION"],
            "max_texture_size": info["GL_MAX_TEXTURE_SIZE"],
        }


def probe_screen() -> dict[str, Any]:
    """The monitors that GLFW sees; the null platform's and Xvfb's count as well."""
    return {"monitors": [dataclasses.asdict(monitor) | {"text": str(monitor)} for monitor in list_monitors()]}


PROBES: dict[str, Callable[[], dict[str, Any]]] = {"opengl": probe_opengl, "screen": probe_screen}


def main(argv: Sequence[str]) -> int:
    """Print what was found, or `{"error": …}`: whatever goes wrong here is the answer."""
    try:
        answer = PROBES[argv[0]]()
    except Exception as error:  # drivers and bindings raise anything
        answer = {"error": " ".join(str(error).split())}
    print(json.dumps(answer))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
