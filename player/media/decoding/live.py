"""Recognises live media by name: cameras and streams, which have no end and cannot seek."""

import re
import stat
from dataclasses import dataclass
from pathlib import Path

STEADY_S = 10.0  # after a connection of this length, the next attempt is immediate again
_DEVICES = re.compile(r"(v4l2|lavfi|dshow|avfoundation|x11grab):(.+)", re.DOTALL)
_STREAMS = re.compile(r"(rtsp|rtsps|rtmp|rtp|udp|srt|tcp)://.+")
# Protocols of each kind of stream. FFmpeg opens no other protocol for it, whatever the sender requests.
_PROTOCOLS = {
    "rtsp": "rtp,srtp,udp,tcp",
    "rtsps": "rtp,srtp,udp,tcp,tls",
    "rtmp": "rtmp,tcp",
    "rtp": "rtp,udp",
    "udp": "udp",
    "srt": "srt",
    "tcp": "tcp",
}
_DEVICE_PROTOCOLS = "file"  # a device uses no protocol, but FFmpeg takes an empty list for all protocols


@dataclass(frozen=True)
class LiveAddress:
    """What FFmpeg opens.

    address : passed to FFmpeg.
    format : FFmpeg's input format; None to detect it.
    protocols : protocols that FFmpeg may use.
    """

    address: str
    format: str | None
    protocols: str


def live_address(name: str) -> LiveAddress | None:
    """Parse `v4l2:/dev/video0`, `/dev/video0`, `lavfi:testsrc`, `rtsp://…`, `udp://…`. Returns None for files."""
    if match := _DEVICES.fullmatch(name):
        return LiveAddress(match[2], match[1], _DEVICE_PROTOCOLS)
    if match := _STREAMS.fullmatch(name):
        return LiveAddress(name, None, _PROTOCOLS[match[1]])
    if name.startswith("/dev/video") and _is_character_device(Path(name)):
        return LiveAddress(name, "v4l2", _DEVICE_PROTOCOLS)
    return None


def is_device(name: str) -> bool:
    """Whether a name means a camera, a screen or a filter graph of this computer."""
    return _DEVICES.fullmatch(name) is not None or name.startswith("/dev/")


def _is_character_device(path: Path) -> bool:
    try:
        return stat.S_ISCHR(path.stat().st_mode)
    except (OSError, ValueError):
        return False
