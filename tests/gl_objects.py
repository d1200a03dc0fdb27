"""Which OpenGL objects are alive, asked of OpenGL itself: moderngl keeps no list."""

import ctypes

# Not Query: moderngl's has no release, so that it lives as long as its context.
KINDS = ("Texture", "Buffer", "Framebuffer", "Renderbuffer", "VertexArray", "Program", "Sampler")
NAMES = range(1, 513)  # drivers hand out the smallest free name
GL_DELETE_STATUS = 0x8B80


def live_objects() -> dict[str, list[int]]:
    """Names of the live objects of the current context, by kind; kinds without any are left out."""
    library = ctypes.CDLL("libGL.so.1")
    live = {kind: [name for name in NAMES if _is_alive(library, kind, name)] for kind in KINDS}
    return {kind: names for kind, names in live.items() if names}


def _is_alive(library: ctypes.CDLL, kind: str, name: int) -> bool:
    is_object = getattr(library, f"glIs{kind}")
    is_object.argtypes, is_object.restype = [ctypes.c_uint], ctypes.c_ubyte
    return bool(is_object(name)) and not (kind == "Program" and _is_deleted(library, name))


def _is_deleted(library: ctypes.CDLL, program: int) -> bool:
    """A deleted program keeps its name for as long as it is the one in use."""
    status = ctypes.c_int()
    library.glGetProgramiv(ctypes.c_uint(program), GL_DELETE_STATUS, ctypes.byref(status))
    return status.value != 0
