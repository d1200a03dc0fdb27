"""What a frame costs: the shader beside scipy's product of the same map, and whole frames through both backends.

Room: projector 512x384, camera 640x480, 16 or 64 entries a projector pixel around its place in the camera's view.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import moderngl
import numpy as np
from scipy import sparse

from player.calibration import Calibration, Device
from player.cpu_renderer import CpuRenderer
from player.gl.context import headless_context
from player.gl.passes import float_texture
from player.gl.renderer import GlRenderer
from player.gl.row_map_pass import MapTextures, RowMapPass
from player.maps import RoomMaps
from player.renderer import Room
from player.response import Response
from player.row_map import RowMap, SparseRows, pack, unpack
from player.video import MediaReader
from tests.bench_rows import REPEATS, WARM_UP, median_ms

CLIP = Path(__file__).resolve().parents[1] / "calib_data" / "media" / "big_buck_bunny.mp4"
PROJECTOR, CAMERA = (384, 512), (480, 640)
FRAME_TIMEOUT_S = 60.0


def shader() -> Iterator[str]:
    """One row map pass, beside scipy's CSR product of the three channels."""
    rng = np.random.default_rng(1)
    picture = rng.uniform(size=(*CAMERA, 3)).astype(np.float32)
    with headless_context() as context:
        yield f"{context.info['GL_RENDERER']}, milliseconds"
        for side in (4, 8):
            correction = local_map(PROJECTOR, CAMERA, side, rng)
            ours, csr = shader_ms(context, correction, picture), scipy_ms(correction, picture)
            yield f"{side**2:3} entries: shader {ours:.1f}, scipy CSR x3 {csr:.1f}, scipy/shader {csr / ours:.2f}"


def frames() -> Iterator[str]:
    """A real 720p clip through both backends."""
    rng = np.random.default_rng(1)
    device = Device(*PROJECTOR, Response("srgb"))
    black = np.zeros((*CAMERA, 3), np.float32)
    calibration = Calibration("bench", "", (device,), Device(*CAMERA, Response("linear")), black, np.ones(CAMERA, bool))
    maps = RoomMaps(local_map(PROJECTOR, CAMERA, 4, rng), local_map(CAMERA, PROJECTOR, 2, rng), None, None, 0.5)
    room = Room(calibration, maps, 0.5)
    with headless_context() as context:
        for name, renderer in (("gl", GlRenderer(context, room)), ("cpu", CpuRenderer(room))):
            with MediaReader.open(CLIP, loop=True) as reader:
                renderer.open(reader.info.format)
                stages = frame_ms(renderer, reader)
            renderer.release()
            yield f"whole frame, 720p H.264, {name}: " + ", ".join(f"{stage} {ms:.1f}" for stage, ms in stages.items())


def local_map(output: tuple[int, int], source: tuple[int, int], side: int, rng: np.random.Generator) -> RowMap:
    """side × side entries around each output pixel's place in the source."""
    y, x = np.mgrid[: output[0], : output[1]].reshape(2, -1, 1, 1)
    offset = np.arange(side) - side // 2
    rows = np.clip(y * source[0] // output[0] + offset[:, None], 0, source[0] - 1)
    columns = np.clip(x * source[1] // output[1] + offset, 0, source[1] - 1)
    indices = (rows * source[1] + columns).reshape(len(y), -1)
    weights = rng.uniform(0, 1 / side**2, (indices.size, 3)).astype(np.float32)
    indptr = np.arange(0, indices.size + 1, side**2)
    return pack(SparseRows(indptr, indices.ravel().astype(np.int64), weights), output, source)


def scipy_ms(packed: RowMap, picture: np.ndarray) -> float:
    rows = unpack(packed)
    shape = len(rows.indptr) - 1, picture.shape[0] * picture.shape[1]
    matrices = [sparse.csr_array((rows.weights[:, i].copy(), rows.indices, rows.indptr), shape=shape) for i in range(3)]
    columns = [picture[..., i].ravel().copy() for i in range(3)]
    return median_ms(lambda: [T @ c for T, c in zip(matrices, columns, strict=True)])


def shader_ms(context: moderngl.Context, packed: RowMap, picture: np.ndarray) -> float:
    rgba = np.concatenate([picture, np.ones((*picture.shape[:2], 1), np.float32)], axis=2)
    source = float_texture(context, picture.shape[:2], rgba)
    textures = MapTextures(context, packed)
    step = RowMapPass(context, textures, "CLAMP")

    def work() -> None:
        step.run(source)
        context.finish()

    result = median_ms(work)
    for resource in (step, textures, source):
        resource.release()
    return result


def frame_ms(renderer: GlRenderer | CpuRenderer, reader: MediaReader) -> dict[str, float]:
    """Medians of the stages of a whole frame: wait for the decoder, upload, correct, read back."""
    stages: dict[str, list[float]] = {name: [] for name in ("wait", "decode", "upload", "correct", "read back", "all")}
    for index in range(WARM_UP + REPEATS):
        marks = [time.perf_counter()]
        frame = reader.next_frame(FRAME_TIMEOUT_S)
        assert frame is not None
        marks.append(time.perf_counter())
        renderer.upload(frame)
        reader.release(frame)
        marks.append(time.perf_counter())
        renderer.render("projector", compensate=True, frame=index)
        renderer.finish()
        marks.append(time.perf_counter())
        renderer.encoded()
        marks.append(time.perf_counter())
        wait, upload, correct, read_back = np.diff(marks)
        times = (wait, frame.decode_s, upload, correct, read_back, marks[-1] - marks[0])
        for name, seconds in zip(stages, times, strict=True):
            stages[name].append(1000 * seconds)
    return {name: float(np.median(values[WARM_UP:])) for name, values in stages.items()}
