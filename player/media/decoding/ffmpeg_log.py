"""FFmpeg's messages, printed by FFmpeg."""

import av


def log_natively(level: int) -> None:
    """Print messages at least as serious as an av.logging level to stderr, in every process that codes or decodes.

    PyAV's own log callback takes the GIL: a codec thread that logs while the main thread frees the codec hung the
    process in half of the runs on a damaged H.264 file. FFmpeg's callback needs no GIL.
    """
    av.logging.restore_default_callback()
    av.logging.set_libav_level(level)
