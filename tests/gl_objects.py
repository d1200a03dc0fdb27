"""Lists the live OpenGL objects by asking OpenGL, because moderngl keeps no list."""

import ctypes

# Query is missing: moderngl's queries have no release and live as long as their context.
KINDS = ("Texture", "Buffer", "Framebuffer", "Renderbuffer", "VertexArray", "Program", "Sampler")
NAMES = range(1, 513)  # drivers assign the smallest free name
GL_DELETE_STATUS, GL_LINK_STATUS = 0x8B80, 0x8B82


def live_objects() -> dict[str, list[int]]:
    """Returns the names of the current context's live objects by kind, without empty kinds."""
    library = ctypes.CDLL("libGL.so.1")
    live = {kind: _alive(library, kind) for kind in KINDS}
    return {kind: names for kind, names in live.items() if names}


def _alive(library: ctypes.CDLL, kind: str) -> list[int]:
    is_object = getattr(library, f"glIs{kind}")
    is_object.argtypes, is_object.restype = [ctypes.c_uint], ctypes.c_ubyte
    return [name for name in NAMES if is_object(name) and (kind != "Program" or _is_usable(library, name))]


def _is_usable(library: ctypes.CDLL, program: int) -> bool:
    """Whether a program is linked and not deleted.

    A deleted program keeps its name while in use, and moderngl never releases a program that fails to compile.
    """
    deleted, linked = ctypes.c_int(), ctypes.c_int()
    library.glGetProgramiv(ctypes.c_uint(program), GL_DELETE_STATUS, ctypes.byref(deleted))
    library.glGetProgramiv(ctypes.c_uint(program), GL_LINK_STATUS, ctypes.byref(linked))
    return not deleted.value and bool(linked.value)
