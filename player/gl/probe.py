"""What this machine's OpenGL and screens offer, as JSON, for a parent that must survive a driver that crashes.

python -m player.gl.probe opengl|screen
"""

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from typing import Any

import moderngl

from player.gl.monitors import list_monitors


def probe_opengl() -> dict[str, Any]:
    """Vendor, renderer, version and largest texture of an OpenGL context made through EGL, without a screen."""
    context = moderngl.create_context(standalone=True, backend="egl")
    try:
        info = context.info
        return {
            "vendor": info["GL_VENDOR"],
            "renderer": info["GL_RENDERER"],
            "version": info["GL_VERSION"],
            "version_code": context.version_code,
            "max_texture_size": info["GL_MAX_TEXTURE_SIZE"],
        }
    finally:
        context.release()


def probe_screen() -> dict[str, Any]:
    return {"monitors": [dataclasses.asdict(monitor) for monitor in list_monitors()]}


PROBES: dict[str, Callable[[], dict[str, Any]]] = {"opengl": probe_opengl, "screen": probe_screen}


def main(argv: Sequence[str]) -> int:
    """Print what was found, or `{"error": …}`: whatever goes wrong here is the answer."""
    try:
        answer = PROBES[argv[0]]()
    except Exception as error:  # moderngl raises bare Exception
        answer = {"error": str(error)}
    print(json.dumps(answer))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
