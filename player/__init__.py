"""Light transport measured or simulated, inverted, and played through: `import counterlight as cl` (docs/api.md).

This folder is what runs once per frame: the player and the files it reads. tools/ is counterlight.tools.
files/ reads whatever comes from outside, writing/ is how anything gets onto the disk; maps/ is the matrix format.
media/ is how pictures and sound come in, pipeline/ what a frame goes through, gl/ that on a GPU, overlay/ what is
drawn over it; show/ is the loop in a window, and what renders into files; jobs/ is who works on parts of a whole,
unattended/ what watches over a show. Beside them: calibration.py, the room's folder; response.py; command.py;
errors.py. Which room may know which is in tests/test_house.py.
May import numpy, OpenEXR, cv2 and PyAV; never `counterlight.tools` (but for the names below, when somebody asks for
them), never scipy. Only `counterlight.gl` touches moderngl and glfw.
Read next: maps/row_map.py (the contract), pipeline/reference.py (the mathematics), app.py (the command).
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
    """Imports what a public name needs when it is first used."""
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
