"""Which media are live: cameras and streams, without an end and without a way back. Parses names only."""

import re
import stat
from dataclasses import dataclass
from pathlib import Path

STEADY_S = 10.0  # what lasts as long may break off, or its decoder die, again: it is tried again as soon
_DEVICES = re.compile(r"(v4l2|lavfi|dshow|avfoundation|x11grab):(.+)", re.DOTALL)
_STREAMS = re.compile(r"(rtsp|rtsps|rtmp|rtp|udp|srt|tcp)://.+")
# What a stream of each kind is made of; FFmpeg opens nothing else for it, whatever the other end sends.
_PROTOCOLS = {
    "rtsp": "rtp,srtp,udp,tcp",
    "rtsps": "rtp,srtp,udp,tcp,tls",
    "rtmp": "rtmp,tcp",
    "rtp": "rtp,udp",
    "udp": "udp",
    "srt": "srt",
    "tcp": "tcp",
}
_DEVICE_PROTOCOLS = "file"  # a device has none; FFmpeg takes an empty list for all


@dataclass(frozen=True)
class LiveAddress:
    """What FFmpeg opens: an address, the format that reads it (None: it finds out), the protocols that it may use."""

    address: str
    format: str | None
    protocols: str


def live_address(name: str) -> LiveAddress | None:
    """`v4l2:/dev/video0`, `/dev/video0`, `lavfi:testsrc`, `rtsp://…`, `udp://…`; None for files."""
    if match := _DEVICES.fullmatch(name):
        return LiveAddress(match[2], match[1], _DEVICE_PROTOCOLS)
    if match := _STREAMS.fullmatch(name):
        return LiveAddress(name, None, _PROTOCOLS[match[1]])
    if name.startswith("/dev/video") and _is_character_device(Path(name)):
        return LiveAddress(name, "v4l2", _DEVICE_PROTOCOLS)
    return None


def is_device(name: str) -> bool:
    """Whether a name is that of a camera, a screen or a filter graph of this computer."""
    return _DEVICES.fullmatch(name) is not None or name.startswith("/dev/")


def _is_character_device(path: Path) -> bool:
    try:
        return stat.S_ISCHR(path.stat().st_mode)
    except (OSError, ValueError):
        return False
