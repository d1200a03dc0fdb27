"""Simulation of a scene: runs the effects that it calls for, in bands of camera rows, and reports the cost of each."""

import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.command import track
from counterlight.errors import InputError
from counterlight.tools.blurring.blurring import Blurring
from counterlight.tools.choices import BLUR_TOLERANCE, MOST_TOLERANCE
from counterlight.tools.simulation.assembly import ADVICE, Blur, NearLight, summed
from counterlight.tools.simulation.bands import Band, Elsewhere, SceneSource, albedo_of, camera_samples, paint_of
from counterlight.tools.simulation.effects_on import Costs, EffectsOn
from counterlight.tools.simulation.needs import MOVES, TAKES, Need, chosen, needs_of
from counterlight.tools.simulation.paths import Arrivals, Deposits, Samples
from counterlight.tools.simulation.projector_side import arrivals, deposits
from counterlight.tools.simulation.scene import Scene, inside_of
from counterlight.tools.transport.transport import FarLight, Transport

BAND_RAYS = 1 << 18  # rays traced at once
SAMPLES_AT_ONCE = 1 << 15  # samples lit at once: a light map may send a hundred arrivals to a sample
MANY = 1 << 17  # a batch with more entries is summed before the next batch
MAX_BYTES = 8 << 30
BYTES_A_RAY = 16  # bytes for the entries made from one ray
BYTES_A_BEAM = 100  # bytes for a projector pixel's entries in D
THROUGH_GLASS = ("refraction", "caustics")  # effects whose light dispersion moves
Entries = tuple[IntArray, IntArray, FloatArray]


@dataclass(frozen=True)
class EffectReport:
    """Cost of an effect: processor seconds, entries of T or its factors, share of the floodlit room's light."""

    need: Need
    seconds: float = 0.0
    entries: int = 0
    energy_share: float = 0.0

    def __str__(self) -> str:
        name, worth = f"{self.need.effect:17}", "" if self.need.worth is None else f"{self.need.worth:.2f}"
        if not self.need.on:
            return f"{name} off  {'':31} {worth:>6}  {self.need.reason}"
        sign = "-" if self.need.effect in TAKES else "~" if self.need.effect in MOVES else "+"
        energy = f"{sign}{100 * self.energy_share:.2f} %"
        return f"{name} on   {self.seconds:7.2f} {self.entries:13,} {energy:>9} {worth:>6}  {self.need.reason}"


@dataclass(frozen=True)
class Spectral:
    """Light per primary, and how the camera sees it.

    transport : T_l of each primary.
    mixing : X, (camera height, camera width, 3, 3), channel by primary.
    primaries : F, (3, camera height, camera width, 3). Floodlights, red first.
    """

    transport: Transport
    mixing: FloatArray
    primaries: NDArray[np.float32]


@dataclass(frozen=True)
class Simulated:
    """T and e (camera height, camera width, 3) of a scene, with one report per effect.

    spectral : light per primary, if the camera's channels see several primaries; T then describes white light.
    blurring : report on the shortening of long rows; None if no row was shortened.
    """

    transport: Transport
    ambient: NDArray[np.float32]
    reports: tuple[EffectReport, ...]
    cpu_seconds: float
    seconds: float
    spectral: Spectral | None = None
    blurring: Blurring | None = None

    def explained(self, *, all_effects: bool = True) -> str:
        """Returns the reports as lines under a heading: active effects, their costs, and the reasons."""
        heading = (
            f"{'effect':22} {'CPU s':>7} {'entries':>13} {'energy':>9} {'dB':>6}  why (+ adds, - takes away, ~ moves)"
        )
        lines = [str(report) for report in self.reports if all_effects or report.need.on]
        rest = self.cpu_seconds - sum(report.seconds for report in self.reports)
        lines += [
            f"{'rays and entries':22} {rest:7.2f}",
            f"{'together':22} {self.cpu_seconds:7.2f}  in {self.seconds:.1f} s",
        ]
        return "\n".join([heading, *lines])


def simulate(
    scene: Scene,
    needs: Mapping[str, Need] | None = None,
    *,
    without: Collection[str] = (),
    only: Collection[str] = (),
    tolerance: float = BLUR_TOLERANCE,
    elsewhere: Elsewhere | None = None,
) -> Simulated:
    """Simulate the effects that a scene calls for.

    needs : effects that the scene needs; None derives them from the scene.
    without, only : effects to switch off, or to keep, for a study.
    tolerance : dB that pictures may lose where rows of T are too long for maps; 0 keeps T as it is.
    elsewhere : worker processes that trace the bands; None traces in this process.

    Raises InputError if projector or camera sees no surface.
    """
    if not 0 <= tolerance <= MOST_TOLERANCE:
        raise InputError(f"tolerance {tolerance:g}: expected 0 (T stays as it is) to {MOST_TOLERANCE:g} dB")
    needs = chosen(needs_of(scene) if needs is None else needs, without, only)
    _check(scene, needs)
    return _Simulation(scene, needs, tolerance).run(elsewhere)


def trace_band(source: SceneSource, needs: tuple[tuple[str, Need], ...], rows: range) -> tuple[Band, Costs]:
    """Returns a band and its costs; runs in a worker process."""
    simulation = _prepared(source, needs)
    simulation.effects.forget_costs()
    return simulation.band(rows), simulation.effects.costs


@lru_cache(1)
def _prepared(source: SceneSource, needs: tuple[tuple[str, Need], ...]) -> "_Simulation":
    simulation = _Simulation(source.read(), dict(needs))
    simulation.prepare()
    return simulation


class _Simulation:
    """State collected over the bands."""

    def __init__(self, scene: Scene, needs: dict[str, Need], tolerance: float = BLUR_TOLERANCE) -> None:
        self.start = time.process_time(), time.perf_counter()
        self.needs, self.effects = needs, EffectsOn(needs)
        self.straight = scene
        self.scene = self.effects.call("distortion", "distorted", scene) if "distortion" in self.effects else scene
        pixels, raster = scene.camera.pixels, (scene.projector.height, scene.projector.width)
        blur = Blur(raster, scene.camera.width, tolerance) if tolerance else None
        self.near = NearLight((pixels, scene.projector.pixels), scene.threshold, scene.name, blur)
        self.ambient = np.zeros((pixels, 3))
        self.seen, self.lit, self.elsewhere_s = False, False, 0.0
        self.mixing, self.weight = np.zeros((pixels, 9)), np.zeros(pixels)
        self.primaries: list[tuple[Scene, FloatArray | None]] = [(self.scene, None)]
        if "lateral_colour" in self.effects:
            self.primaries = self.effects.call("lateral_colour", "primaries", self.scene)
        if "halo" in self.effects:
            cells = self.effects.call("halo", "halo_cells", self.scene).cells
            self.halo = NearLight((pixels, cells), 0.0, scene.name)
        self.maps: list[dict[str, Any]] = []
        self.exchange: Any = None

    def prepare(self) -> None:
        """Prepare the data that all bands share: light maps and the exchange of the far light."""
        scene, effects, scenes = self.scene, self.effects, [each for each, _ in self.primaries]
        names = effects.having("light_map")
        self.maps = [{name: effects.call(name, "light_map", each, effects) for name in names} for each in scenes]
        if "inter_reflection" in effects:
            self.exchange = effects.call("inter_reflection", "prepare", scene, self._deposits())
            self.far = NearLight((scene.camera.pixels, self.exchange.cells), 0.0, scene.name)

    def run(self, elsewhere: Elsewhere | None) -> Simulated:
        scene, effects = self.scene, self.effects
        self.prepare()
        height = max(1, BAND_RAYS // (scene.camera.width * scene.samples**2))
        starts = range(0, scene.camera.height, height)
        bands = [range(top, min(top + height, scene.camera.height)) for top in starts]
        if elsewhere is None:
            for rows in track(bands, "tracing light paths"):
                self._take(rows, self.band(rows))
        else:
            self._take_all(bands, elsewhere)
        if not self.seen:
            raise InputError(f"{scene.name}: the camera sees no surface; move it or point look_at at one")
        if not self.lit and "direct" in effects:
            raise InputError(f"{scene.name}: no surface that the camera sees is lit by the projector; point it at one")
        return self._finished()

    def _deposits(self) -> Iterator[Deposits]:
        for (scene, own), maps in zip(self.primaries, self.maps, strict=True):
            found = [partial(deposits, scene, self.effects)]
            found += [partial(self.effects.timed, name, light_map.deposits) for name, light_map in maps.items()]
            for each in found:
                yield from each() if own is None else (replace(part, flux=part.flux * own) for part in each())

    def _take_all(self, bands: list[range], elsewhere: Elsewhere) -> None:
        """Take bands in picture order, not in order of completion: the order decides how rows are shortened."""
        needs, waiting, next_one = tuple(self.needs.items()), dict[int, Band](), 0
        jobs = [partial(trace_band, elsewhere.source, needs, rows) for rows in bands]
        for number, (band, costs) in track(elsewhere.workers.completed(jobs), "tracing light paths", len(jobs)):
            waiting[number] = band
            self.effects.add(costs)
            self.elsewhere_s += sum(costs.seconds.values())
            while next_one in waiting:
                self._take(bands[next_one], waiting.pop(next_one))
                next_one += 1

    def _take(self, rows: range, band: Band) -> None:
        """Add a band to the room."""
        width, done = self.scene.camera.width, rows.stop / self.scene.camera.height
        here = slice(rows.start * width, rows.stop * width)
        self.near.add(band.near, done)
        if band.far is not None:
            self.far.add(band.far, done)
        if band.halo is not None:
            self.halo.add(band.halo, done)
        self.ambient[here], self.mixing[here], self.weight[here] = band.ambient, band.mixing, band.weight
        self.seen, self.lit = self.seen or band.seen, self.lit or band.lit

    def band(self, rows: range) -> Band:
        """Trace some rows of the camera picture."""
        width, columns = self.scene.camera.width, self.scene.projector.pixels
        first, count = rows.start * width, len(rows) * width
        self.sharp: list[IntArray] = []
        near: dict[str, list[Entries]] = {}
        far: list[Entries] = []
        for batch in camera_samples(self.scene, rows, self.effects):
            self.seen = True
            for start in range(0, batch.pixel.size, SAMPLES_AT_ONCE):
                self._light(batch.at(slice(start, start + SAMPLES_AT_ONCE)), near, far)
        reduced, halo = [], near.pop("halo", [])
        for effect, entries in near.items():
            pixel, column, weights = _joined(entries)
            place, weights = summed((pixel - first) * columns + column, weights)
            fringes = int(np.sum(weights[:, 1] == 0)) if effect == "direct" and len(self.primaries) > 1 else 0
            own = place.size - fringes
            blurred = own - np.unique(np.concatenate(self.sharp)).size if effect == "direct" and self.sharp else 0
            self.effects.account(effect, weights.sum(), own - blurred)
            if fringes:
                self.effects.account("lateral_colour", 0.0, fringes)
            if effect in THROUGH_GLASS and "dispersion" in self.effects:
                self.effects.account("dispersion", weights.sum())
            if blurred:
                self.effects.account("projector_defocus", 0.0, blurred)
            reduced.append((place // columns + first, place % columns, weights))
        here = slice(first, first + count)
        return Band(
            self.near.band(first, count, *_joined(reduced)),
            None if self.exchange is None else self.far.band(first, count, *_joined(far)),
            self.halo.band(first, count, *_joined(halo)) if "halo" in self.effects else None,
            *(self.ambient[here], self.mixing[here], self.weight[here]),
            *(self.seen, self.lit),
        )

    def _light(self, samples: Samples, near: dict[str, list[Entries]], far: list[Entries]) -> None:
        """Add all contributions of one batch of samples."""
        paint, around = paint_of(self.scene, samples), 1 / np.pi
        matt = samples.throughput * albedo_of(self.scene, samples, paint, self.effects) * around
        for number in range(len(self.primaries)):
            if number:
                self.effects.whole("lateral_colour", self._light_of, number, samples, paint, near)
            else:
                self._light_of(number, samples, paint, near)
        if "halo" in self.effects:
            for found in self.effects.call("halo", "arrivals", self.scene, samples):
                self._add(self.scene, samples, paint, found, near)
        if "ambient_light" in self.effects:
            added = self.effects.call("ambient_light", "radiance", self.scene, matt)
            self.effects.account("ambient_light", added.sum())
            for i in range(3):
                self.ambient[:, i] += np.bincount(samples.pixel, added[:, i], len(self.ambient))
        if "crosstalk" in self.effects:
            self._mix(samples, matt @ np.ones(3))
        if self.exchange is not None:
            far += self.effects.call("inter_reflection", "seen_by_camera", self.scene, self.exchange, samples, matt)

    def _light_of(self, number: int, samples: Samples, paint: FloatArray, near: dict[str, list[Entries]]) -> None:
        """Add the light of a primary, or of all of them if their pictures coincide."""
        scene, own = self.primaries[number]
        for found in self._arrivals(scene, self.maps[number], samples):
            sent = found if own is None else replace(found, irradiance=found.irradiance * own)
            self._add(scene, samples, paint, sent, near)

    def _add(
        self, scene: Scene, samples: Samples, paint: FloatArray, found: Arrivals, near: dict[str, list[Entries]]
    ) -> None:
        """Add the light of arrivals to the entries of their effect."""
        weights = self._seen_light(scene, samples, paint, found)
        effect = samples.effect if samples.effect != "direct" and found.effect != "halo" else found.effect
        lit = weights @ np.ones(3) > 0  # a product is much faster than any() over three columns
        if lit.any():
            self.lit = True
            entries = samples.pixel[found.sample[lit]], found.pixel[lit], weights[lit]
            near.setdefault(effect, []).append(self._merged(*entries) if lit.size > MANY else entries)

    def _mix(self, samples: Samples, weight: FloatArray) -> None:
        """Add the primaries that samples see to the sums of their pixels."""
        found = self.effects.call("crosstalk", "of_samples", self.scene, samples).reshape(-1, 9)
        for i in range(9):
            self.mixing[:, i] += np.bincount(samples.pixel, weight * found[:, i], len(self.mixing))
        self.weight += np.bincount(samples.pixel, weight, len(self.weight))

    def _merged(self, pixel: IntArray, column: IntArray, weights: FloatArray) -> Entries:
        """Sum the entries of several samples of one pixel."""
        columns = int(column.max(initial=0)) + 1
        place, weights = summed(pixel * columns + column, weights)
        return place // columns, place % columns, weights

    def _arrivals(self, scene: Scene, maps: dict[str, Any], samples: Samples) -> Iterator[Arrivals]:
        yield from arrivals(scene, samples, self.effects)
        for name, light_map in maps.items():
            yield from self.effects.timed(name, light_map.arrivals, samples)

    def _seen_light(self, scene: Scene, samples: Samples, paint: FloatArray, found: Arrivals) -> FloatArray:
        """Returns the radiance (n, 3) that arrivals cause in the camera's pixels, after shadows and lens losses.

        scene : the scene with the projector of these arrivals.
        """
        effects, straight = self.effects, found.effect == "direct"
        reflectance = paint[found.sample] / np.pi
        if found.effect not in ("direct", "halo") and not effects.having("reflectance"):  # most arrivals of a light map
            return np.asarray(samples.throughput[found.sample] * reflectance * found.irradiance)
        there = samples.at(found.sample)
        for name in effects.having("reflectance"):
            to_light = found.origin - there.point
            to_light /= np.linalg.norm(to_light, axis=1, keepdims=True)
            reflectance = effects.call(name, "reflectance", scene, there, to_light, reflectance)
        weights = there.throughput * reflectance * found.irradiance
        if found.effect in ("direct", "halo") and "shadows" in effects:
            dark = effects.call("shadows", "shaded", scene, there.point, found.origin)
            effects.account("shadows", weights[dark].sum())
            weights[dark] = 0
        if straight and "vignetting" in effects and scene.projector.vignetting:
            passed = weights * effects.call("vignetting", "transmission", scene.projector)[found.pixel, None]
            effects.account("vignetting", weights.sum() - passed.sum())
            weights = passed
        if straight and samples.effect == "direct":
            self._account_moves(scene, there, found, weights)
        return weights

    def _account_moves(self, scene: Scene, there: Samples, found: Arrivals, weights: FloatArray) -> None:
        """Account light whose pixels differ from the pixels of pinholes without distortion or lateral colour."""
        if "distortion" in self.effects:
            ends = ((self.straight.projector, found.pixel), (self.straight.camera, there.pixel))
            same = [device.pixel_at(*device.project(there.point)[:2]) == pixel for device, pixel in ends]
            self.effects.account("distortion", weights[~(same[0] & same[1])].sum())
        if "lateral_colour" in self.effects:
            moved = self.scene.projector.pixel_at(*self.scene.projector.project(there.point)[:2]) != found.pixel
            self.effects.account("lateral_colour", weights[moved].sum())
        projector, camera = scene.projector, scene.camera
        if "projector_defocus" in self.effects:
            moved = projector.pixel_at(*projector.project(there.point)[:2]) != found.pixel
            self.effects.account("projector_defocus", weights[moved].sum())
            if scene is self.primaries[len(self.primaries) // 2][0]:  # green, or all primaries
                self.sharp.append(np.unique((there.pixel * projector.pixels + found.pixel)[~moved]))
        if "camera_defocus" in self.effects:
            moved = camera.pixel_at(*camera.project(there.point)[:2]) != there.pixel
            self.effects.account("camera_defocus", weights[moved].sum())

    def _finished(self) -> Simulated:
        scene, effects = self.scene, self.effects
        camera, projector = ((device.height, device.width) for device in (scene.camera, scene.projector))
        far = None if self.exchange is None else self.exchange.far_light(self.far.rows())
        transport, ambient = Transport(self.near.rows(), far, camera, projector, self.near.blurred()), self.ambient
        if far is not None:
            lit = far.apply(np.ones((scene.projector.pixels, 3)))
            effects.account("inter_reflection", lit.sum(), _numbers(far))
        if "halo" in effects:
            dims = "vignetting" in effects and scene.projector.vignetting
            sent = effects.call("vignetting", "transmission", scene.projector) if dims else None
            moved = scene.projector.halo_share * float(transport.composition().sum())
            transport = effects.call("halo", "scattered", scene, transport, self.halo.rows(), sent)
            effects.account("halo", moved, _numbers(transport.far) - _numbers(far))
            far = transport.far
        composition = transport.composition()
        if "black_level" in effects:
            added = effects.call("black_level", "radiance", scene, composition)
            effects.account("black_level", added.sum())
            ambient = ambient + added
        total = float(np.sum(composition + ambient))
        if "vignetting" in effects and scene.camera.vignetting:
            passed = effects.call("vignetting", "transmission", scene.camera)[:, None]
            effects.account("vignetting", np.sum((composition + ambient) * (1 / passed - 1)))
        if "capture_noise" in effects:
            noise = effects.call("capture_noise", "deviation", scene.camera, composition + ambient)
            effects.account("capture_noise", noise.sum())
        if "blooming" in effects:
            transport, ambient, moved = effects.call("blooming", "bloom", scene, transport, ambient)
            effects.account("blooming", moved * total, _numbers(transport.far) - _numbers(far))
        shape, spectral = (scene.camera.height, scene.camera.width), None
        if "crosstalk" in effects:
            X = effects.call("crosstalk", "of_pixels", scene, self.mixing.reshape(-1, 3, 3), self.weight)
            seen, ambient, F, elsewhere = effects.call("crosstalk", "photographed", X, transport, ambient)
            spectral = Spectral(transport, X.reshape(*shape, 3, 3), F.reshape(3, *shape, 3).astype(np.float32))
            effects.account("crosstalk", elsewhere)
            transport = seen
        if "colour_filters" in effects:
            transport, ambient, spectral = self._through_filters(transport, ambient, spectral)
        for name in ("colour_processing", "flicker", "wander", "camera_curve"):
            if name in effects:
                effects.account(name, effects.call(name, "deviation", scene) * float(composition.sum()))
        picture = ambient.reshape(*shape, 3).astype(np.float32)
        spent = time.process_time() - self.start[0] + self.elsewhere_s, time.perf_counter() - self.start[1]
        return Simulated(transport, picture, self._reports(total), *spent, spectral, self.near.blurring())

    def _through_filters(
        self, transport: Transport, ambient: FloatArray, spectral: Spectral | None
    ) -> tuple[Transport, FloatArray, Spectral | None]:
        """Apply the camera's colour filters to T, e and the floodlights."""
        effects, mosaic = self.effects, self.scene.camera.mosaic
        filtered, ambient, moved = effects.call("colour_filters", "filtered", mosaic, transport, ambient)
        effects.account("colour_filters", moved, filtered.entries - transport.entries)
        if spectral is not None:
            lights = [effects.call("colour_filters", "interpolated", mosaic, light) for light in spectral.primaries]
            spectral = replace(spectral, primaries=np.stack(lights).astype(np.float32))
        return filtered, ambient, spectral

    def _reports(self, total: float) -> tuple[EffectReport, ...]:
        effects = self.effects
        return tuple(
            EffectReport(need, effects.seconds[name], effects.entries[name], effects.energy[name] / total)
            if name in effects
            else EffectReport(need)
            for name, need in self.needs.items()
        )


def _numbers(far: FarLight | None) -> int:
    """Return the number of nonzeros in D and U, plus all of M."""
    if far is None:
        return 0
    return far.mix.matrices.size + sum(int(np.count_nonzero(part.weights)) for part in (far.gather, far.scatter))


def _joined(entries: list[Entries]) -> Entries:
    if not entries:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3))
    pixels, columns, weights = zip(*entries, strict=True)
    return np.concatenate(pixels), np.concatenate(columns), np.concatenate(weights)


def _check(scene: Scene, needs: dict[str, Need]) -> None:
    """Raises InputError for a device inside a solid, and for a scene that would not fit in memory."""
    for name, device in (("camera", scene.camera), ("projector", scene.projector)):
        solid = inside_of(scene, device.position)
        if solid is not None:
            raise InputError(f"{scene.name}: [{name}], position: is inside the solid '{solid.name}'; move it out")
    far = needs["inter_reflection"].on
    cells, beams = (scene.cells, scene.projector.pixels) if far else (0, 0)
    rays = scene.camera.pixels * scene.samples**2
    needed = rays * BYTES_A_RAY + beams * BYTES_A_BEAM + cells**2 * 8 * 12
    if needed > MAX_BYTES:
        raise InputError(
            f"{scene.name}: {rays} camera rays, {beams} projector pixels and {cells} cells need about "
            f"{needed >> 30} GiB, at most {MAX_BYTES >> 30} are used; {ADVICE}"
        )
