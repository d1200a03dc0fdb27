"""Decoded frames: their planes, pixel format and times, and their layout in the ring.

Both sides of the decoder's pipe import this module. It imports only numpy.
"""

import mmap
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_ALIGNMENT = 64


@dataclass(frozen=True)
class PlaneShape:
    """Size of a plane in samples.

    stride_samples : samples from one row to the next.
    """

    width: int
    height: int
    stride_samples: int


@dataclass(frozen=True)
class PixelFormat:
    """Everything that a shader needs to convert three planes into linear RGB.

    width : width of the stored picture, before `rotation`.
    height : height of the stored picture, before `rotation`.
    layout : "yuv" (Y, Cb, Cr), "rgb" (R, G, B), "radiance" (R, G, B, linear).
    depth : bits per sample; 8 is uint8, 9 to 16 uint16 in the low bits, 32 (radiance) float32.
    matrix : "bt601", "bt709", "bt2020"; "identity" unless yuv.
    transfer : "bt1886", "srgb", "linear", "gamma22", "gamma28", "pq", "hlg".
    chroma_siting : "left", "center", "topleft".
    rotation : 0, 90, 180 or 270 degrees counter-clockwise that bring the stored picture upright. At 90, the stored
        right column becomes the top row: displayed[y, x] = stored[x, width − 1 − y], that is numpy.rot90(stored).
    pixel_aspect : width / height of a stored sample; 1 if unknown.
    primaries : "bt709", "bt2020", "p3".
    peak_nits : cd/m² of the brightest PQ light; 0 if the medium does not state it.
    """

    width: int
    height: int
    layout: str
    depth: int
    planes: tuple[PlaneShape, ...]
    matrix: str
    full_range: bool
    transfer: str
    chroma_siting: str
    rotation: int
    pixel_aspect: float
    primaries: str = "bt709"
    peak_nits: float = 0.0

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype("<f4" if self.depth == 32 else "u1" if self.depth == 8 else "<u2")


@dataclass(frozen=True)
class MediaInfo:
    """Properties of a medium.

    duration_s : declared duration; None if the medium declares none, and for a still.
    frames : declared number of frames; None if the medium declares none.
    live : a camera or stream, which has no end and cannot seek. Only its newest frame matters.
    """

    path: Path | str
    format: PixelFormat
    frames_per_second: float
    duration_s: float | None
    still: bool
    codec: str
    frames: int | None
    live: bool = False
    sound: bool = False


@dataclass(frozen=True)
class Frame:
    """A picture and its time.

    time_s : presentation time; the first frame of the medium is at 0. It grows across loops.
    decode_s : seconds that decoding took.
    planes : three arrays (rows, stride), views into the ring, valid until MediaReader.release.
    slot : (decoder's number, slot) in the ring, for release.
    skipped : decoded pictures that were dropped before this frame, as MediaReader.skip allows.
    """

    index: int
    time_s: float
    duration_s: float
    decode_s: float
    format: PixelFormat
    planes: tuple[NDArray[Any], ...]
    slot: tuple[int, int]
    skipped: int = 0


def radiance_frame(radiance: NDArray[np.floating]) -> Frame:
    """Convert linear radiance, (rows, columns, 3), into a frame."""
    height, width = radiance.shape[:2]
    plane = PlaneShape(width, height, width)
    pixels = PixelFormat(width, height, "radiance", 32, (plane,) * 3, "identity", True, "linear", "center", 0, 1.0)
    planes = tuple(np.ascontiguousarray(radiance[..., i], np.float32) for i in range(3))
    return Frame(0, 0.0, 0.04, 0.0, pixels, planes, (0, 0))


def slot_bytes(pixels: PixelFormat) -> int:
    """Return the bytes of one ring slot. Its planes are aligned to 64 bytes."""
    return sum(_plane_bytes(pixels, plane) for plane in pixels.planes)


def slot_planes(ring: mmap.mmap, pixels: PixelFormat, slot: int) -> tuple[NDArray[Any], ...]:
    """Return the planes of a slot as views into the ring, (rows, stride) each."""
    offset, planes = slot * slot_bytes(pixels), []
    for shape in pixels.planes:
        count = shape.height * shape.stride_samples
        flat = np.frombuffer(ring, pixels.dtype, count, offset)
        planes.append(flat.reshape(shape.height, shape.stride_samples))
        offset += _plane_bytes(pixels, shape)
    return tuple(planes)


def format_from_json(fields: dict[str, Any]) -> PixelFormat:
    """Rebuild a PixelFormat from the result of dataclasses.asdict."""
    return PixelFormat(**fields | {"planes": tuple(PlaneShape(**plane) for plane in fields["planes"])})


def describe_info(info: MediaInfo) -> dict[str, Any]:
    """Return a MediaInfo's fields for JSON, without its path."""
    return {name: value for name, value in asdict(info).items() if name != "path"}


def _plane_bytes(pixels: PixelFormat, plane: PlaneShape) -> int:
    used = plane.height * plane.stride_samples * pixels.dtype.itemsize
    return -(-used // _ALIGNMENT) * _ALIGNMENT
