"""OpenGL contexts: without a window, through EGL, and of a window."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import moderngl

from counterlight.errors import InputError

PACKAGES = "libegl1 libgl1"  # OpenGL and its drivers, as named by counterlight doctor
SOFTWARE = ("llvmpipe", "softpipe", "swrast", "swiftshader", "software", "gdi generic", "basic render")

# Without these names, glcontext runs ldconfig twice for each context, which takes 9 ms.
ON_LINUX = sys.platform == "linux"
EGL_LIBRARIES: dict[str, Any] = {"libgl": "libGL.so.1", "libegl": "libEGL.so.1"} if ON_LINUX else {}
X11_LIBRARIES: dict[str, Any] = {"libgl": "libGL.so.1", "libx11": "libX11.so.6"} if ON_LINUX else {}


def window_context() -> moderngl.Context:
    """Return the OpenGL context, 3.3 or later, that a window has made current in this thread."""
    return moderngl.create_context(require=330, **X11_LIBRARIES)


@contextmanager
def headless_context(instead: str = "") -> Iterator[moderngl.Context]:
    """Open a standalone OpenGL 4.3 context through EGL (a GPU, or Mesa's llvmpipe), else 3.3; released at the end.

    instead : option of the command that avoids OpenGL, named in the error.

    Raises InputError with the fix if there is no OpenGL.
    """
    settings: dict[str, Any] = {"standalone": True, "backend": "egl", **EGL_LIBRARIES}
    try:
        try:
            context = moderngl.create_context(require=430, **settings)
        except Exception:  # moderngl and glcontext raise bare exceptions
            context = moderngl.create_context(require=330, **settings)
    except Exception as error:
        raise InputError(
            f"no OpenGL through EGL ({' '.join(str(error).split())}); install it with: apt-get install {PACKAGES}, "
            f"or ask counterlight doctor what is missing{instead and f', or {instead}'}"
        ) from None
    try:
        yield context
    finally:
        context.release()


def in_software(name: str) -> bool:
    """Whether OpenGL runs on the processor. name : the renderer name that OpenGL reports."""
    return any(word in name.lower() for word in SOFTWARE)
