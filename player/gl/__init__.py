"""OpenGL: the only importer of moderngl and glfw.

Holds the device, which draws the passes of counterlight.passes with their shaders, and the window. OpenGL's flipped
rows exist only here. The maker of a texture, canvas or pass releases it. Read next: device.py.
"""

import os as _os
from importlib.util import find_spec as _find_spec
from pathlib import Path as _Path


def _choose_glfw() -> None:
    """Make the glfw package load its X11 library, also on Wayland, where windows cannot be placed otherwise.

    By default, the package chooses by session type, and starts a child process to read the version (0.05 s).
    """
    found = _find_spec("glfw")
    library = _Path(found.origin).parent / "x11" / "libglfw.so" if found is not None and found.origin else None
    if library is not None and library.is_file():
        _os.environ.setdefault("PYGLFW_LIBRARY", str(library))


_choose_glfw()
