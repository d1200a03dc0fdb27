"""Lets FFmpeg print its own messages."""

import av


def log_natively(level: int) -> None:
    """Print messages from an av.logging level on to stderr. Call this in every process that codes or decodes.

    PyAV's log callback takes the GIL. A codec thread that logs while the main thread frees the codec then hangs the
    process, in half of the runs on a damaged H.264 file. FFmpeg's callback needs no GIL.
    """
    av.logging.restore_default_callback()
    av.logging.set_libav_level(level)
