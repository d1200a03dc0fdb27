"""OpenGL without a window, through EGL."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import moderngl

from player.errors import InputError


@contextmanager
def headless_context() -> Iterator[moderngl.Context]:
    """A standalone OpenGL 3.3 context through EGL (a GPU, or Mesa's llvmpipe), released at the end.

    Raises InputError with the fix when there is none.
    """
    try:
        settings: dict[str, Any] = {"backend": "egl"}
        context = moderngl.create_context(require=330, standalone=True, **settings)
    except Exception as error:  # moderngl and glcontext raise bare Exceptions
        raise InputError(
            f"no OpenGL through EGL ({' '.join(str(error).split())}); install it with: apt-get install libegl1 libgl1, "
            "ask counterlight-doctor what is missing, or use --backend cpu"
        ) from None
    try:
        yield context
    finally:
        context.release()
