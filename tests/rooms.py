"""Small rooms for tests, asymmetric so that a flip or a swap of height and width shows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.calibration import Calibration, Device, writing
from counterlight.maps.chain import Chain
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import RowMap, SparseRows, pack
from counterlight.media.video import Frame, PixelFormat, PlaneShape
from counterlight.pipeline.room import Room
from counterlight.processing import LEVELS, Processing
from counterlight.raster import Region
from counterlight.response import RasterResponse, Response, WhiteSegment, parse_response
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import FarLight, Transport, far_light_of

CAMERA, PROJECTOR = (11, 17), (7, 13)
CELLS = (1, 6)
MIXED, COLOUR = "mixed", ((0.75, 0.25, 0.0), (0.0, 0.875, 0.125), (0.125, 0.125, 0.75))
# columns of each projector, and its response
UNLIKE = (4, "srgb"), (6, [[0, 0, 0], [0.1, 0.4, 0.2], [1, 1, 1]]), (3, "srgb")
SEGMENT = WhiteSegment(((0, 0, 0), (0.1, 0.05, 0.02), (0.5, 0.4, 0.3)))
SEGMENTED = (4, "srgb"), (6, Response("gamma", 2.2, segment=SEGMENT)), (3, "srgb")
FACTORS = np.random.default_rng(8).uniform(0.8, 1.25, (LEVELS**3, 3)).tolist()
PROCESSING = Processing(tuple(map(tuple, FACTORS)))
PROCESSED = (4, "srgb"), (6, Response("gamma", 2.2, processing=PROCESSING)), (3, "srgb")
FAINTEST = 1e-2  # share of a blur's peak; smaller entries are dropped


def random_map(
    rng: np.random.Generator, output: tuple[int, int], source: tuple[int, int], longest: int, scale: float = 1.0
) -> RowMap:
    """Random row map with 0 to `longest` entries per row, of both signs."""
    lengths = rng.integers(0, longest + 1, output[0] * output[1])
    indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    indices = rng.integers(0, source[0] * source[1], indptr[-1])
    weights = (scale * rng.normal(size=(indptr[-1], 3))).astype(np.float32)
    return pack(SparseRows(indptr, indices, weights, source[0] * source[1]), output, source)


def random_room(rng: np.random.Generator, *, far: bool, dither: str = "ordered", response: str = "srgb") -> Room:
    """Room with random maps: not physical, and with no equal parts."""
    calibration = Calibration(
        "random",
        "made by a test",
        (Device(*PROJECTOR, Response(response)),),
        Device(*CAMERA, Response("linear")),
        rng.uniform(0, 0.05, (*CAMERA, 3)).astype(np.float32),
        np.ones(CAMERA, bool),
    )
    scatter = random_map(rng, CAMERA, CELLS, 4)
    chain, undo = (
        Chain(random_map(rng, CELLS, source, 20, 0.1), random_map(rng, CELLS, CELLS, 6, 0.2), scatter)
        for source in (PROJECTOR, CAMERA)
    )
    maps = RoomMaps(
        random_map(rng, PROJECTOR, CAMERA, 12),
        random_map(rng, CAMERA, PROJECTOR, 9),
        chain if far else None,
        undo if far else None,
        0.6,
    )
    return Room(calibration, maps, maps.white, dither)


def in_strips(room: Room, strips: tuple[tuple[int, object], ...]) -> Room:
    """Split the room's projector into several, each with its columns and response; MIXED has other primaries."""
    height = room.calibration.projector.height
    devices = tuple(
        Device(height, width, parse_response("linear"), None, COLOUR)
        if response == MIXED
        else Device(height, width, response if isinstance(response, Response) else parse_response(response))
        for width, response in strips
    )
    assert sum(width for width, _ in strips) == room.calibration.projector.width
    return replace(room, calibration=replace(room.calibration, projectors=devices))


def in_two_rows() -> RasterResponse:
    """Three projectors in a raster of 9x13, with different responses; the third has other primaries and lies below."""
    responses = parse_response("srgb"), parse_response(1.6), parse_response("linear")
    return RasterResponse(responses, (Region(0, 0, 6, 5), Region(6, 0, 7, 4), Region(0, 5, 8, 4)), (None, None, COLOUR))


def yuv_frame(rng: np.random.Generator, shape: tuple[int, int], **changes: object) -> Frame:
    """Random 4:2:0 frame of odd size with padded rows, 8 or 10 bits."""
    height, width = shape
    depth = int(changes.get("depth", 8))  # type: ignore[call-overload]
    luma = PlaneShape(width, height, width + 3)
    chroma = PlaneShape(-(-width // 2), -(-height // 2), width)
    fields: dict[str, object] = {
        "width": width,
        "height": height,
        "layout": "yuv",
        "depth": depth,
        "planes": (luma, chroma, chroma),
        "matrix": "bt709",
        "full_range": False,
        "transfer": "bt1886",
        "chroma_siting": "left",
        "rotation": 0,
        "pixel_aspect": 1.0,
    }
    return frame_of(PixelFormat(**(fields | changes)), rng)  # type: ignore[arg-type]


def rgb_frame(picture: NDArray[np.uint8], transfer: str = "srgb") -> Frame:
    """Frame of a picture (rows, columns, 3) of 8-bit codes."""
    height, width = picture.shape[:2]
    plane = PlaneShape(width, height, width)
    pixels = PixelFormat(width, height, "rgb", 8, (plane,) * 3, "identity", True, transfer, "center", 0, 1.0)
    return _frame(pixels, tuple(np.ascontiguousarray(picture[..., i]) for i in range(3)))


def frame_of(pixels: PixelFormat, rng: np.random.Generator) -> Frame:
    """Frame with random code values in a pixel format."""
    shapes = [(plane.height, plane.stride_samples) for plane in pixels.planes]
    planes = tuple(rng.integers(0, 1 << pixels.depth, shape).astype(pixels.dtype) for shape in shapes)
    return _frame(pixels, planes)


def _frame(pixels: PixelFormat, planes: tuple[NDArray[np.generic], ...]) -> Frame:
    return Frame(index=0, time_s=0.0, duration_s=0.04, decode_s=0.0, format=pixels, planes=planes, slot=(0, 0))


def blurred_transport(
    rng: np.random.Generator,
    camera: tuple[int, int],
    projector: tuple[int, int],
    sigma: float,
    shift: tuple[float, float] = (0, 0),
) -> sparse.csr_array:
    """T of a textured surface with Gaussian blur: camera pixels overlap their neighbours' projector pixels.

    shift : shift of the projector picture on the surface, in projector pixels right and down.
    """
    y, x = np.mgrid[: camera[0], : camera[1]].reshape(2, -1, 1)
    centre_y = (y + 0.5) * projector[0] / camera[0] - shift[1]
    centre_x = (x + 0.5) * projector[1] / camera[1] - shift[0]
    reach = int(np.ceil(sigma * np.sqrt(-2 * np.log(FAINTEST)))) + 1
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, 1, -1)
    v, u = v + np.floor(centre_y).astype(int), u + np.floor(centre_x).astype(int)
    dy, dx = centre_y - v - 0.5, centre_x - u - 0.5
    weights = np.exp(-(dx**2 + dy**2) / (2 * sigma**2))
    weights[(weights < FAINTEST) | (v < 0) | (v >= projector[0]) | (u < 0) | (u >= projector[1])] = 0
    weights *= rng.uniform(0.4, 1, (weights.shape[0], 1)) / weights.sum(axis=1, keepdims=True)
    lit = np.nonzero(weights)
    places = lit[0].astype(np.int32), (v * projector[1] + u)[lit].astype(np.int32)
    shape = weights.shape[0], projector[0] * projector[1]
    return sparse.csr_array((weights[lit].astype(np.float32), places), shape=shape)


def write_blurred_room(
    folder: Path,
    rng: np.random.Generator,
    camera: tuple[int, int] = (36, 50),
    projector: tuple[int, int] = (30, 40),
    cells: int = 0,
    mixing: NDArray[np.float64] | None = None,
    shift: tuple[float, float] = (0, 0),
) -> Transport:
    """Write a calibration of a textured, tinted, slightly blurred wall, and return its transport.

    cells : cells of far light, a tenth of all light; 0 for none.
    mixing : (3, 3). Share of each primary per channel for the floodlights of the primaries; rows sum to 1.
    shift : as in `blurred_transport`; the paint stays.
    """
    blur = blurred_transport(rng, camera, projector, 0.5, shift)
    tints = rng.uniform(0.5, 1, (3, blur.shape[0], 1))
    near = tuple(sparse.csr_array(blur.multiply(tint), dtype=np.float32) for tint in tints)
    transport = Transport.from_matrices(near, _far_light(rng, blur.shape, cells) if cells else None)
    calibration = Calibration(
        "blurred wall",
        "made by a test",
        (Device(*projector, Response("srgb")),),
        Device(*camera, Response("linear")),
        rng.uniform(0, 0.02, (*camera, 3)).astype(np.float32),
        np.ones(camera, bool),
        None if mixing is None else _floodlights(transport.composition(), mixing).reshape(3, *camera, 3),
    )
    with writing(folder, calibration) as stage:
        write_transport(transport, stage)
    return transport


def _floodlights(composition: NDArray[np.float64], mixing: NDArray[np.float64]) -> NDArray[np.float32]:
    """Floodlights of the primaries, (primary, camera pixels, camera channel)."""
    return np.moveaxis(composition[:, :, None] * mixing, 2, 0).astype(np.float32)


def _far_light(rng: np.random.Generator, shape: tuple[int, int], cells: int) -> FarLight:
    """Far light: each cell averages its projector pixels, lights all cells, and is seen by its camera pixels."""
    seen, lit = (np.arange(pixels) * cells // pixels == np.arange(cells)[:, None] for pixels in shape)
    gather = sparse.csr_array((lit / lit.sum(axis=1, keepdims=True)).astype(np.float32))
    scatter = sparse.csr_array(seen.T.astype(np.float32))
    mix = rng.uniform(0.05, 0.15, (3, cells, cells)) / cells
    return far_light_of((gather,) * 3, mix, (scatter,) * 3)


def write_one_to_one_room(folder: Path, shape: tuple[int, int]) -> None:
    """Write a calibration of a textured wall with one camera pixel per projector pixel."""
    pixels = shape[0] * shape[1]
    albedo = np.random.default_rng(1).uniform(0.5, 1, pixels).astype(np.float32)
    T, device = sparse.csr_array(sparse.diags_array(albedo)), Device(*shape, Response("linear"))
    ambient, mask = np.zeros((*shape, 3), np.float32), np.ones(shape, bool)
    with writing(folder, Calibration("one to one", "made by a test", (device,), device, ambient, mask)) as stage:
        write_transport(Transport.from_matrices((T, T, T)), stage)
