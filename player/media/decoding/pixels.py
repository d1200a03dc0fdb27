"""Unpacks one decoded FFmpeg picture into three planes of samples, and describes their meaning.

numpy unpacks everything, exactly. swscale is not used: measured, it is biased from YUV to RGB, converts yuvj formats to
limited range unasked, and its threads sometimes overwrite the end of each other's rows.
"""

import ctypes
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from math import atan2, degrees
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.media.frames import PixelFormat, PlaneShape

Plane = NDArray[Any]

MAX_PIXELS = 1 << 26  # 8192², 800 MB as float32 RGB; a larger size indicates a damaged or hostile header
_MATRICES = {1: "bt709", 4: "bt601", 5: "bt601", 6: "bt601", 7: "bt709", 9: "bt2020", 10: "bt2020"}  # 7 is SMPTE 240M
_TRANSFERS = {1: "bt1886", 4: "gamma22", 5: "gamma28", 6: "bt1886", 7: "bt1886", 8: "linear", 11: "bt1886"}
_TRANSFERS |= {13: "srgb", 14: "bt1886", 15: "bt1886", 16: "pq", 18: "hlg"}
_PRIMARIES = {9: "bt2020", 11: "p3", 12: "p3"}  # DCI-P3's white is treated as the screen's white
_REFUSED = {8: "YCgCo", 14: "ICtCp", 15: "IPT-C2", 16: "YCgCo-Re", 17: "YCgCo-Ro"}
UNTAGGED = 2  # FFmpeg's value for a missing tag of any kind
_FULL = 2  # FFmpeg's AVCOL_RANGE_JPEG: codes use the full range
_LIMITED = 1
# offset in AVMasteringDisplayMetadata, after eight chromaticities and the least luminance
_MASTERING_MOST = 2 * 8 * 4 + 8


@dataclass(frozen=True)
class Samples:
    """Views of a picture's code values.

    planes : Y, Cb, Cr or R, G, B, (rows, columns) each.
    alpha : (rows, columns); None without.
    """

    layout: str
    depth: int
    planes: tuple[Plane, Plane, Plane]
    alpha: Plane | None = None
    full_range: bool = True


@dataclass(frozen=True)
class Tags:
    """FFmpeg's numbers for the medium's colour properties; UNTAGGED if the medium does not declare one."""

    matrix: int
    transfer: int
    picture: bool  # a still or a sequence of stills; if untagged, it is sRGB with JFIF's BT.601
    centered: bool  # chroma lies between the luma samples (JPEG, MPEG-1, WebP)
    primaries: int = UNTAGGED
    peak_nits: float = 0.0  # brightest light of the medium in cd/m², see PixelFormat


def unpack(frame: av.VideoFrame, *, picture: bool) -> Samples:
    """Return views of a decoded frame's planes. Raises InputError for an unsupported pixel format."""
    name = frame.format.name
    for pattern, read in _READERS:
        if match := re.fullmatch(pattern, name):
            return read(frame, match, picture)
    raise InputError(f"its pixel format {name} is not supported; convert it to yuv420p or rgb24")


def describe(samples: Samples, tags: Tags, *, rotation: int, pixel_aspect: float) -> PixelFormat:
    """Return everything that a shader needs to convert `samples` into linear RGB."""
    height, width = samples.planes[0].shape
    transfer = _transfer(tags) if samples.layout != "radiance" else "linear"
    hdr = transfer in ("pq", "hlg")
    return PixelFormat(
        width=width,
        height=height,
        layout=samples.layout,
        depth=samples.depth,
        planes=tuple(PlaneShape(p.shape[1], p.shape[0], p.shape[1]) for p in samples.planes),
        matrix=_matrix(tags, hdr=hdr) if samples.layout == "yuv" else "identity",
        full_range=samples.full_range,
        transfer=transfer,
        chroma_siting="center" if tags.centered else "left",
        rotation=rotation,
        pixel_aspect=pixel_aspect,
        primaries=_primaries(tags, hdr=hdr) if samples.layout != "radiance" else "bt709",
        peak_nits=tags.peak_nits if transfer == "pq" else 0.0,
    )


def store(samples: Samples, out: tuple[Plane, ...], *, flip_rows: bool) -> None:
    """Copy the planes into `out`. An alpha plane composites them over black, in code values."""
    step = -1 if flip_rows else 1
    opaque = samples.alpha is None or bool(samples.alpha.min() == _full_scale(samples))
    for i, (source, target) in enumerate(zip(samples.planes, out, strict=True)):
        np.copyto(target[::step], source if opaque else _over_black(samples, i), casting="unsafe")


def check_finite(planes: tuple[Plane, ...]) -> None:
    """Raise InputError if there are NaN or infinite values, with their number and the place of the first."""
    bad = [~np.isfinite(plane) for plane in planes]
    count = sum(int(plane.sum()) for plane in bad)
    if not count:
        return
    channel = next(i for i, plane in enumerate(bad) if plane.any())
    row, column = (int(i) for i in np.argwhere(bad[channel])[0])
    where = f"the first in channel {'RGB'[channel]} at column {column}, row {row}"
    raise InputError(f"{count} values are NaN or infinite, {where}; replace them by finite radiance")


def peak_notice(pixels: PixelFormat) -> str | None:
    """Return a warning if the medium is HDR and does not state its brightest light, otherwise None."""
    if pixels.transfer != "pq" or pixels.peak_nits:
        return None
    return "PQ (HDR) that does not say how bright it gets; 1000 cd/m² are assumed, --hdr-peak says otherwise"


def brightest_nits(frame: av.VideoFrame) -> float:
    """Return the cd/m² of the medium's brightest pixel (MaxCLL), else of its mastering display; 0 if undeclared."""
    light = _side_data(frame, "CONTENT_LIGHT_LEVEL")
    if light is not None and (most := struct.unpack_from("=I", light)[0]):
        return float(most)
    display = _side_data(frame, "MASTERING_DISPLAY_METADATA")
    if display is None:
        return 0.0
    numerator, denominator, _, known = struct.unpack_from("=4i", display, _MASTERING_MOST)
    return numerator / denominator if known and numerator > 0 and denominator > 0 else 0.0


def display_rotation(frame: av.VideoFrame) -> tuple[int, bool]:
    """Return (degrees counter-clockwise, flip rows first) that bring the stored picture upright.

    The display matrix maps x' = a x + c y, y' = b x + d y. A mirrored matrix (ad − bc < 0) is a rotation after flipping
    the rows. In both cases, a and b give the angle.
    """
    matrix = _side_data(frame, "DISPLAYMATRIX")
    if matrix is None:
        return round(frame.rotation / 90) * 90 % 360, False
    a, b, _, c, d = (int(v) for v in np.frombuffer(matrix, "<i4")[:5])
    return round(-degrees(atan2(b, a)) / 90) * 90 % 360, a * d - b * c < 0


def _side_data(frame: av.VideoFrame, name: str) -> bytes | None:
    try:
        side_data: list[Any] = list(frame.side_data)  # elements are SideData, although PyAV's annotation says str
    # PyAV 18 fails on EXIF side data, and then lists no side data; a mirrored EXIF picture stays mirrored
    except ValueError:
        return None
    return next((bytes(data) for data in side_data if data.type.name == name), None)


def _matrix(tags: Tags, *, hdr: bool) -> str:
    if tags.matrix in _REFUSED:
        raise InputError(f"its {_REFUSED[tags.matrix]} colour matrix is not supported; convert it to BT.709 or BT.2020")
    return _MATRICES.get(tags.matrix, "bt2020" if hdr else "bt601" if tags.picture else "bt709")


def _primaries(tags: Tags, *, hdr: bool) -> str:
    unsaid = "bt2020" if hdr and tags.primaries == UNTAGGED else "bt709"
    return _PRIMARIES.get(tags.primaries, unsaid)


def _transfer(tags: Tags) -> str:
    return _TRANSFERS.get(tags.transfer, "srgb" if tags.picture else "bt1886")


def _full_scale(samples: Samples) -> float:
    return 1.0 if samples.layout == "radiance" else (1 << samples.depth) - 1


def _over_black(samples: Samples, i: int) -> Plane:
    """Return plane i mixed with the code value of black (or of neutral chroma) by the opacity."""
    assert samples.alpha is not None
    plane = samples.planes[i]
    rows, columns = (-(-a // p) for a, p in zip(samples.alpha.shape, plane.shape, strict=True))
    alpha = samples.alpha[::rows, ::columns]  # chroma is sited at (or near) the first of its luma samples
    if samples.layout == "radiance":
        return plane * alpha
    zero, full = _zero_code(samples, i), int(_full_scale(samples))
    weighted = (plane.astype(np.int64) - zero) * alpha
    return (weighted + full // 2) // full + zero


def _zero_code(samples: Samples, i: int) -> int:
    if samples.layout == "rgb":
        return 0
    if i > 0:
        return 1 << (samples.depth - 1)
    return 0 if samples.full_range else 16 << (samples.depth - 8)


def _plane(frame: av.VideoFrame, index: int, kind: str) -> Plane:
    """Return the rows of a plane, (rows, line size), without copying. Bottom-up pictures have a negative line size."""
    plane: Any = frame.planes[index]  # a buffer, which PyAV does not annotate
    if plane.line_size >= 0:
        rows: Plane = np.frombuffer(plane, kind).reshape(plane.height, -1)
        return rows
    lowest = plane.buffer_ptr + plane.line_size * (plane.height - 1)
    stored: Any = (ctypes.c_uint8 * (-plane.line_size * plane.height)).from_address(lowest)
    return np.frombuffer(stored, kind).reshape(plane.height, -1)[::-1].copy()  # `stored` does not keep the frame alive


def _planar(frame: av.VideoFrame, index: int, kind: str) -> Plane:
    return _plane(frame, index, kind)[:, : frame.planes[index].width]


def _kind(depth: int, order: str | None) -> str:
    return "u1" if depth == 8 else ">u2" if order == "be" else "<u2"


def _planar_yuv(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    depth = int(match["depth"] or 8)
    kind = _kind(depth, match["order"])
    y, cb, cr = (_planar(frame, i, kind) for i in range(3))
    alpha = _planar(frame, 3, kind) if match["variant"] == "a" else None
    full_range = match["variant"] == "j" or frame.color_range == _FULL
    return Samples("yuv", depth, (y, cb, cr), alpha, full_range)


def _coarse_yuv(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    """Read 4:1:1, 4:1:0 and 4:4:0. Repeats chroma to 4:2:2, 4:2:0 and 4:4:4, which shaders support."""
    depth = int(match["depth"] or 8)
    y, cb, cr = (_planar(frame, i, _kind(depth, match["order"])) for i in range(3))
    rows, columns = {"11": (1, 2), "10": (2, 2), "40": (2, 1)}[match["sampling"]]
    fine = frame.height if rows == 2 and columns == 1 else -(-frame.height // rows), -(-frame.width // columns)
    cb, cr = (plane.repeat(rows, 0).repeat(columns, 1)[: fine[0], : fine[1]] for plane in (cb, cr))
    return Samples("yuv", depth, (y, cb, cr), full_range=match["variant"] == "j" or frame.color_range == _FULL)


def _semi_planar_yuv(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    """Read nv12 and its variants: a luma plane and a plane of chroma pairs. p010 and its variants use the high bits."""
    depth = int(match["depth"] or 8)
    kind, shift = _kind(depth, match["order"]), 0 if depth == 8 else 16 - depth
    y, pairs = _planar(frame, 0, kind), _plane(frame, 1, kind)[:, : 2 * frame.planes[1].width]
    swapped = match["name"] in ("nv21", "nv42")
    cb, cr = pairs[:, swapped::2], pairs[:, 1 - swapped :: 2]
    return _yuv(frame, depth, (y, cb, cr), shift)


def _packed_422(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    """Read yuyv422 and its variants: two pixels in four samples. y210 has its bits at the top of 16."""
    depth = int(match["depth"] or 8)
    order = match["letters"] or "yuyv"
    pairs = -(-frame.width // 2)
    samples = _plane(frame, 0, _kind(depth, match["order"]))[:, : 4 * pairs]
    y = samples[:, order.index("y") :: 2][:, : frame.width]
    return _yuv(frame, depth, (y, samples[:, order.index("u") :: 4], samples[:, order.index("v") :: 4]), -depth % 8)


def _packed_444(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    letters, depth = match["letters"], 16 if match["bits"] else 8
    pixels = _plane(frame, 0, _kind(depth, match["order"]))[:, : 4 * frame.width]
    y, cb, cr = (pixels[:, letters.index(letter) :: 4] for letter in "yuv")
    alpha = pixels[:, letters.index("a") :: 4] if "a" in letters else None
    return Samples("yuv", depth, (y, cb, cr), alpha, frame.color_range == _FULL)


def _yuv(frame: av.VideoFrame, depth: int, planes: tuple[Plane, Plane, Plane], shift: int) -> Samples:
    y, cb, cr = (plane >> shift if shift else plane for plane in planes)
    return Samples("yuv", depth, (y, cb, cr), full_range=frame.color_range == _FULL)


def _planar_rgb(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    depth = int(match["depth"] or 8)
    kind = _kind(depth, match["order"])
    g, b, r = (_planar(frame, i, kind) for i in range(3))
    return Samples("rgb", depth, (r, g, b), _planar(frame, 3, kind) if match["alpha"] else None)


def _planar_radiance(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    kind = ">f4" if match["order"] == "be" else "<f4"
    order = (0, 0, 0) if match["base"] == "gray" else (2, 0, 1)
    planes = [_planar(frame, i, kind) for i in order]
    check_finite(tuple(planes))
    return Samples(
        "radiance", 32, (planes[0], planes[1], planes[2]), _planar(frame, 3, kind) if match["alpha"] else None
    )


def _packed_rgb(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    letters = match["letters"]
    depth = 16 if match["bits"] in ("48", "64") else 8
    pixels = _plane(frame, 0, _kind(depth, match["order"]))[:, : frame.width * len(letters)]
    r, g, b = (pixels[:, letters.index(letter) :: len(letters)] for letter in "rgb")
    alpha = pixels[:, letters.index("a") :: len(letters)] if "a" in letters else None
    return Samples("rgb", depth, (r, g, b), alpha)


def _palette(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    indices = _planar(frame, 0, "u1")
    colours: Any = frame.planes[1]
    argb = np.frombuffer(colours, "=u4")[indices]
    r, g, b, alpha = ((argb >> shift & 255).astype(np.uint8) for shift in (16, 8, 0, 24))
    return Samples("rgb", 8, (r, g, b), alpha)


def _bits(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    ones = np.unpackbits(_plane(frame, 0, "u1"), axis=1)[:, : frame.width]
    gray = (255 * (ones ^ (match["white"] == "w"))).astype(np.uint8)  # monow: 0 is white
    return Samples("rgb", 8, (gray, gray, gray))


def _gray(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    """Return gray as three equal planes. Gray of limited range becomes luma with a single neutral chroma sample."""
    depth = int(match["depth"] or 8)
    gray = _planar(frame, 0, _kind(depth, match["order"]))
    if frame.color_range == _FULL or (picture and frame.color_range != _LIMITED):
        return Samples("rgb", depth, (gray, gray, gray))
    neutral = np.full((1, 1), 1 << (depth - 1), gray.dtype)
    return Samples("yuv", depth, (gray, neutral, neutral), full_range=False)


def _gray_alpha(frame: av.VideoFrame, match: re.Match[str], picture: bool) -> Samples:
    depth = int(match["depth"])
    pixels = _plane(frame, 0, _kind(depth, match["order"]))[:, : 2 * frame.width]
    gray, alpha = pixels[:, ::2], pixels[:, 1::2]
    return Samples("rgb", depth, (gray, gray, gray), alpha)


_READERS: tuple[tuple[str, Callable[[av.VideoFrame, re.Match[str], bool], Samples]], ...] = (
    (r"yuv(?P<variant>[ja]?)4(20|22|44)p(?P<depth>\d*)(?P<order>le|be)?", _planar_yuv),
    (r"yuv(?P<variant>j?)4(?P<sampling>11|10|40)p(?P<depth>\d*)(?P<order>le|be)?", _coarse_yuv),
    (r"(?P<name>nv(12|21|16|24|42)|p[024])(?P<depth>(?<=p\d)(10|12|16))?(?P<order>le|be)?", _semi_planar_yuv),
    (r"(?P<letters>yuyv|uyvy|yvyu)422(?P<depth>)(?P<order>)", _packed_422),
    (r"(?P<letters>)y2(?P<depth>1[026])(?P<order>le|be)", _packed_422),
    (r"(?P<letters>vuya|vuyx|ayuv|uyva)(?P<bits>64)?(?P<order>le|be)?", _packed_444),
    (r"gbr(?P<alpha>a?)p(?P<depth>\d*)(?P<order>le|be)?", _planar_rgb),
    (r"(?P<base>gbr|gray)(?P<alpha>a?)p?f32(?P<order>le|be)", _planar_radiance),
    (r"(?P<letters>(?=.*r)(?=.*g)(?=.*b)[rgba0]{3,4})(?P<bits>24|48|64)?(?P<order>le|be)?", _packed_rgb),
    (r"pal8", _palette),
    (r"mono(?P<white>[wb])", _bits),
    (r"gray(?P<depth>\d*)(?P<order>le|be)?", _gray),
    (r"ya(?P<depth>8|16)(?P<order>le|be)?", _gray_alpha),
)
