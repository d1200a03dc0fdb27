"""Which OpenGL objects are alive, asked of OpenGL itself: moderngl keeps no list."""

import ctypes

# Not Query: moderngl's has no release, so that it lives as long as its context.
KINDS = ("Texture", "Buffer", "Framebuffer", "Renderbuffer", "VertexArray", "Program", "Sampler")
NAMES = range(1, 513)  # drivers hand out the smallest free name
GL_DELETE_STATUS, GL_LINK_STATUS = 0x8B80, 0x8B82


def live_objects() -> dict[str, list[int]]:
    """Names of the live objects of the current context, by kind; kinds without any are left out."""
    library = ctypes.CDLL("libGL.so.1")
    live = {kind: _alive(library, kind) for kind in KINDS}
    return {kind: names for kind, names in live.items() if names}


def _alive(library: ctypes.CDLL, kind: str) -> list[int]:
    is_object = getattr(library, f"glIs{kind}")
    is_object.argtypes, is_object.restype = [ctypes.c_uint], ctypes.c_ubyte
    return [name for name in NAMES if is_object(name) and (kind != "Program" or _is_usable(library, name))]


def _is_usable(library: ctypes.CDLL, program: int) -> bool:
    """Not deleted (the program in use keeps its name) and linked (moderngl forgets one that does not compile)."""
    deleted, linked = ctypes.c_int(), ctypes.c_int()
    library.glGetProgramiv(ctypes.c_uint(program), GL_DELETE_STATUS, ctypes.byref(deleted))
    library.glGetProgramiv(ctypes.c_uint(program), GL_LINK_STATUS, ctypes.byref(linked))
    return not deleted.value and bool(linked.value)
