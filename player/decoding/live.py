"""Which media are live: cameras and streams, without an end and without a way back. Parses names only."""

import re
import stat
from dataclasses import dataclass
from pathlib import Path

_DEVICES = re.compile(r"(v4l2|lavfi|dshow|avfoundation|x11grab):(.+)", re.DOTALL)
_STREAMS = re.compile(r"(rtsp|rtsps|rtmp|rtp|udp|srt|tcp)://.+")


@dataclass(frozen=True)
class LiveAddress:
    """What FFmpeg opens: an address, and the input format that reads it (None: FFmpeg finds out)."""

    address: str
    format: str | None


def live_address(name: str) -> LiveAddress | None:
    """`v4l2:/dev/video0`, `/dev/video0`, `lavfi:testsrc`, `rtsp://…`, `udp://…`; None for files."""
    if match := _DEVICES.fullmatch(name):
        return LiveAddress(match[2], match[1])
    if _STREAMS.fullmatch(name):
        return LiveAddress(name, None)
    return LiveAddress(name, "v4l2") if name.startswith("/dev/video") and _is_device(Path(name)) else None


def _is_device(path: Path) -> bool:
    try:
        return stat.S_ISCHR(path.stat().st_mode)
    except OSError:
        return False
