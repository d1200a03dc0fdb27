"""Measures or simulates light transport, and plays through its inverse: `import counterlight as cl` (docs/api.md).

This folder runs once per frame: the player and the files that it reads. tools/ is counterlight.tools. files/ reads all
files, writing/ writes them, and maps/ is the matrix format. media/ reads pictures and sound. passes/ holds a frame's
passes, pipeline/ runs them, gl/ draws them on a GPU, and overlay/ draws over the picture. show/ is the loop in a
window, and the rendering into files. jobs/ runs parts of a task in parallel, unattended/ supervises a show. Here are
also calibration.py (the calibration folder), response.py, plots.py, command.py and errors.py. tests/test_house.py
checks the imports between folders.
May import numpy, OpenEXR, cv2 and PyAV, never scipy. May not import `counterlight.tools`, except for the names below
when they are used. Only `counterlight.gl` imports moderngl and glfw.
Read next: maps/row_map.py (the contract), passes/ (the mathematics of a frame), app.py (the command).
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from counterlight.errors import InputError
    from counterlight.tools.api import (
        Room,
        Solution,
        build_maps,
        read_maps,
        read_picture,
        read_room,
        simulate,
        solve,
    )
    from counterlight.tools.renderer import Renderer

    __version__: str

__all__ = [
    "InputError",
    "Renderer",
    "Room",
    "Solution",
    "__version__",
    "build_maps",
    "read_maps",
    "read_picture",
    "read_room",
    "simulate",
    "solve",
]


def __getattr__(name: str) -> object:
    """Import the module of a public name when the name is first used."""
    if name == "__version__":
        from importlib.metadata import version

        return version("counterlight")
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    module = {"InputError": "errors", "Renderer": "tools.renderer"}.get(name, "tools.api")
    return getattr(import_module(f"{__name__}.{module}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
