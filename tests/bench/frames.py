"""Cost of a frame: the row-map product on every path next to scipy's and Numba's, and whole frames on both backends.

Room: projector 512x384, camera 640x480, 16 or 64 entries per projector pixel around its place in the camera's view. A
GPU also runs 1920x1080 for both.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import moderngl
import numpy as np
from scipy import sparse

from counterlight.calibration import Calibration, Device
from counterlight.gl.context import headless_context, in_software
from counterlight.gl.gpu_maps import MapBuffers, MapTextures, WordBuffers, WordTextures, supports_compute
from counterlight.gl.passes import picture_texture
from counterlight.gl.renderer import GlRenderer
from counterlight.maps.prior import Prior
from counterlight.maps.room_maps import RefinementMaps, RoomMaps
from counterlight.maps.row_map import PreparedRows, RowMap, SparseRows, pack, unpack
from counterlight.maps.word_map import WordMap
from counterlight.media.frames import radiance_frame
from counterlight.media.video import MediaReader
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.device import GpuPath, StoredMap
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.room import Room
from counterlight.response import Response
from counterlight.tools.inverse.words_fit import fit
from counterlight.tools.inverse.words_light import small_map
from counterlight.tools.shipped import CLIP
from tests.bench.rows import REPEATS, WARM_UP, median_ms
from tests.oracles.renderer import ReferenceRenderer

PROJECTOR, CAMERA = (384, 512), (480, 640)
HD, FULL_HD = (720, 1280), (1080, 1920)
REFINED_ENTRIES, STEPS = 25, 8
FRAME_TIMEOUT_S = 60.0
COPY_BYTES = 1 << 28
MB = 1e6


@dataclass(frozen=True)
class Contender:
    """One implementation of the product.

    milliseconds : milliseconds of a frame.
    megabytes : minimal data transfer, with each byte of map and pictures once.
    """

    name: str
    milliseconds: float
    megabytes: float

    def row(self, bandwidth: float, scipy_ms: float | None) -> str:
        """Returns a row of the table.

        bandwidth : bytes per second of a copy, read and written, on the same device.
        """
        share = self.megabytes * MB / bandwidth / (self.milliseconds / 1000)
        beside = "" if scipy_ms is None else f"{scipy_ms / self.milliseconds:8.2f}"
        return f"  {self.name:<28}{self.milliseconds:8.2f}{beside}{self.megabytes:8.1f}{share:8.0%}"


def shader() -> Iterator[str]:
    """The row-map product on every path next to scipy's and Numba's; bytes moved, and the share of a copy's speed."""
    rng = np.random.default_rng(1)
    with headless_context() as context:
        software, host = drawn_in_software(context), host_copy_bandwidth()
        device = host if software else device_copy_bandwidth(context)
        yield f"{context.info['GL_RENDERER']}; a copy reads and writes {host / 1e9:.1f} GB/s on all cores" + (
            "" if software else f", {device / 1e9:.0f} GB/s on the GPU"
        )
        for side in (4, 8):
            yield from table(context, local_map(PROJECTOR, CAMERA, side, rng), (device, host))
        if software:
            yield "1920x1080, 64 entries: left out, no GPU here (OpenGL runs on the CPU)"
        else:
            yield from table(context, local_map(FULL_HD, FULL_HD, 8, rng), (device, host), baseline=False)


def refined() -> Iterator[str]:
    """Eight steps of refinement, maps of 25 entries per pixel, on both GPU paths and on the processor."""
    rng = np.random.default_rng(1)
    with headless_context() as context:
        yield context.info["GL_RENDERER"]
        yield refined_line(context, PROJECTOR, CAMERA, rng)
        if drawn_in_software(context):
            yield "1920x1080: left out, no GPU here (OpenGL runs on the CPU)"
        else:
            yield refined_line(context, FULL_HD, FULL_HD, rng)


def frames() -> Iterator[str]:
    """A real 720p clip through both backends. At the thesis' size, the numpy reference is measured as well."""
    rng = np.random.default_rng(1)
    with headless_context() as context:
        yield f"{context.info['GL_RENDERER']}; 720p H.264, 16 entries a pixel, milliseconds:"
        yield "| projector | drawn by | upload | to codes | read back | whole frame | processor, all cores |"
        yield "|---|---|---|---|---|---|---|"
        for projector, camera in ((PROJECTOR, CAMERA), (HD, HD)):
            maps = RoomMaps(local_map(projector, camera, 4, rng), local_map(camera, projector, 2, rng), None, None, 0.5)
            room = bench_room(maps, projector, camera)
            backends: list[Callable[[], Renderer]] = [lambda: GlRenderer(context, room), lambda: CpuRenderer(room)]  # noqa: B023
            if projector == PROJECTOR:
                backends.append(lambda: ReferenceRenderer(room))  # noqa: B023
            for made in backends:
                renderer = made()
                with MediaReader.open(CLIP, loop=True) as reader:
                    renderer.open(reader.info.format)
                    stages = frame_ms(renderer, reader)
                renderer.release()
                size, name = f"{projector[1]}x{projector[0]}", renderer.path.name
                yield f"| {size} | {name} | {' | '.join(f'{ms:.1f}' for ms in stages.values())} |"


def table(
    context: moderngl.Context, packed: RowMap, bandwidths: tuple[float, float], *, baseline: bool = True
) -> Iterator[str]:
    """Yield a row per implementation, for one map.

    bandwidths : bytes per second of a copy where OpenGL runs, and on the CPU.
    baseline : include scipy and Numba, which take seconds for a large map.
    """
    rng = np.random.default_rng(2)
    picture = rng.uniform(size=(*packed.source_shape, 3)).astype(np.float32)
    height, width = packed.output_shape
    yield (
        f"{width}x{height} from {packed.source_shape[1]}x{packed.source_shape[0]}, "
        f"{packed.count / (height * width):.0f} entries:"
    )
    yield f"  {'':<28}{'ms':>8}" + (f"{'scipy/':>8}" if baseline else "") + f"{'MB':>8}{'of copy':>8}"
    on_cpu = [scipy_product(packed, picture), numba_product(packed, picture)] if baseline else []
    scipy_ms = on_cpu[0].milliseconds if baseline else None
    for contender in gl_products(context, packed, picture):
        yield contender.row(bandwidths[0], scipy_ms) + ("" if baseline else fps(contender.milliseconds))
    for contender in on_cpu:
        yield contender.row(bandwidths[1], scipy_ms)


def gl_products(context: moderngl.Context, packed: RowMap, picture: np.ndarray) -> Iterator[Contender]:
    pixels = packed.output_shape[0] * packed.output_shape[1]
    pictures = 16 * (pixels + picture.shape[0] * picture.shape[1])
    ways: list[tuple[str, Callable[[], StoredMap], int]] = [
        ("fragment", lambda: MapTextures(context, packed), 16 * packed.count + 12 * pixels)
    ]
    if supports_compute(context):
        ways.append(("compute", lambda: MapBuffers(context, packed), 16 * packed.count + 16 * pixels))
    words = words_of(packed)
    ways.append(("fragment, words", lambda: WordTextures(context, words), words.nbytes))
    if supports_compute(context):
        ways.append(("compute, words", lambda: WordBuffers(context, words), words.nbytes))
    for name, store, map_bytes in ways:
        yield Contender(name, product_ms(context, store(), picture), (map_bytes + pictures) / MB)


def words_of(packed: RowMap) -> WordMap:
    """Returns words that are certified to a code value per row, for any source within 0..1."""
    rows = unpack(packed).ascending()
    found = fit(rows, np.ones((rows.columns, 3)), np.full((rows.shape[0], 3), 1 / 255))
    return WordMap.of(small_map((packed.output_shape, packed.source_shape), rows, found))


def product_ms(context: moderngl.Context, stored: StoredMap, picture: np.ndarray) -> float:
    """Time the product of `stored` and release it."""
    source, product = picture_texture(context, picture), stored.product("CLAMP")

    def work() -> None:
        product.run(source)
        context.finish()

    result = median_ms(work)
    for resource in (product, stored, source):
        resource.release()
    return result


def scipy_product(packed: RowMap, picture: np.ndarray) -> Contender:
    rows = unpack(packed)
    shape = len(rows.indptr) - 1, picture.shape[0] * picture.shape[1]
    matrices = [sparse.csr_array((rows.weights[:, i].copy(), rows.indices, rows.indptr), shape=shape) for i in range(3)]
    columns = [picture[..., i].ravel().copy() for i in range(3)]
    milliseconds = median_ms(lambda: [T @ c for T, c in zip(matrices, columns, strict=True)])
    moved = sum(
        T.data.nbytes + T.indices.nbytes + T.indptr.nbytes + c.nbytes + 4 * shape[0]
        for T, c in zip(matrices, columns, strict=True)
    )
    return Contender("scipy CSR x3, one core", milliseconds, moved / MB)


def numba_product(packed: RowMap, picture: np.ndarray) -> Contender:
    rows, prepared = packed.output_shape[0] * packed.output_shape[1], PreparedRows(packed)
    moved = 16 * packed.count + 8 * rows + picture.nbytes + 24 * rows
    return Contender("Numba, all cores (tools)", median_ms(lambda: prepared.apply(picture)), moved / MB)


def host_copy_bandwidth() -> float:
    """Returns bytes read and written per second by a Numba loop over all cores: the limit of CPU implementations."""
    from numba import njit, prange

    def copy(source: np.ndarray, target: np.ndarray) -> None:
        for i in prange(source.size):
            target[i] = source[i]

    fast, source = njit(parallel=True)(copy), np.ones(COPY_BYTES // 8)
    target = np.empty_like(source)
    return 2 * COPY_BYTES / (median_ms(lambda: fast(source, target)) / 1000)


def device_copy_bandwidth(context: moderngl.Context) -> float:
    """Returns bytes read and written per second by a GPU copy from buffer to buffer."""
    source, target = (context.buffer(reserve=COPY_BYTES) for _ in range(2))

    def work() -> None:
        context.copy_buffer(target, source)
        context.finish()

    bandwidth = 2 * COPY_BYTES / (median_ms(work) / 1000)
    source.release()
    target.release()
    return bandwidth


def refined_line(
    context: moderngl.Context, projector: tuple[int, int], camera: tuple[int, int], rng: np.random.Generator
) -> str:
    side = int(REFINED_ENTRIES**0.5)
    dual, transport = local_map(projector, camera, side, rng), local_map(camera, projector, side, rng)
    step_size = np.full((*projector, 3), 0.5, np.float32)
    direct, prior = local_map(projector, camera, 1, rng), Prior.none(projector)
    weights, seen = np.ones(camera, np.float32), np.ones(projector, np.float32)
    refinement = RefinementMaps(dual, None, direct, step_size, prior, weights, seen)
    room = bench_room(RoomMaps(dual, transport, None, None, 0.5, refinement=refinement), projector, camera)
    frame = radiance_frame(rng.uniform(0, 0.5, (*camera, 3)).astype(np.float32))
    found = []
    backends: list[Callable[[], Renderer]] = [lambda: GlRenderer(context, room)]
    if supports_compute(context):
        backends.append(lambda: GlRenderer(context, room, GpuPath("compute")))
    for made in (*backends, lambda: CpuRenderer(room)):
        renderer = made()
        renderer.open(frame.format)
        renderer.upload(frame)

        def work(renderer: Renderer = renderer) -> None:
            renderer.render("projector", compensate=True, steps=STEPS)
            renderer.finish()

        milliseconds = median_ms(work)
        found.append(f"{renderer.path.name} {milliseconds:.1f} ms{fps(milliseconds)}")
        renderer.release()
    return f"{projector[1]}x{projector[0]}, camera {camera[1]}x{camera[0]}: {'; '.join(found)}"


def fps(milliseconds: float) -> str:
    return f" ({1000 / milliseconds:.0f} fps)"


def clock_of(context: moderngl.Context) -> Callable[[], float]:
    """Returns the clock that other load affects least: processor time over all cores if OpenGL runs on the CPU."""
    return time.process_time if drawn_in_software(context) else time.perf_counter


def drawn_in_software(context: moderngl.Context) -> bool:
    return in_software(context.info["GL_RENDERER"])


def bench_room(maps: RoomMaps, projector: tuple[int, int], camera: tuple[int, int]) -> Room:
    black, mask = np.zeros((*camera, 3), np.float32), np.ones(camera, bool)
    device = Device(*projector, Response("srgb"))
    return Room(Calibration("bench", "", (device,), Device(*camera, Response("linear")), black, mask), maps, 0.5)


def local_map(output: tuple[int, int], source: tuple[int, int], side: int, rng: np.random.Generator) -> RowMap:
    """Returns a map with side × side entries around each output pixel's place in the source."""
    y, x = np.mgrid[: output[0], : output[1]].reshape(2, -1, 1, 1)
    offset = np.arange(side) - side // 2
    rows = np.clip(y * source[0] // output[0] + offset[:, None], 0, source[0] - 1)
    columns = np.clip(x * source[1] // output[1] + offset, 0, source[1] - 1)
    indices = (rows * source[1] + columns).reshape(len(y), -1)
    weights = rng.random((indices.size, 3), np.float32)
    weights /= side**2
    indptr = np.arange(0, indices.size + 1, side**2)
    return pack(SparseRows(indptr, indices.ravel(), weights, source[0] * source[1]), output, source)


def frame_ms(renderer: Renderer, reader: MediaReader) -> dict[str, float]:
    """Returns medians of the stages of a whole frame without decoding, which another process does in parallel."""
    stages: dict[str, list[float]] = {name: [] for name in ("upload", "to codes", "read back", "whole", "processor")}
    for index in range(WARM_UP + REPEATS):
        frame = reader.next_frame(FRAME_TIMEOUT_S)
        assert frame is not None
        marks, processor_s = [time.perf_counter()], time.process_time()
        renderer.upload(frame)
        marks.append(time.perf_counter())
        renderer.render("projector", compensate=True, frame=index)
        renderer.finish()
        marks.append(time.perf_counter())
        renderer.encoded()
        marks.append(time.perf_counter())
        reader.release(frame)
        times = (*np.diff(marks), marks[-1] - marks[0], time.process_time() - processor_s)
        for name, seconds in zip(stages, times, strict=True):
            stages[name].append(1000 * seconds)
    return {name: float(np.median(values[WARM_UP:])) for name, values in stages.items()}
