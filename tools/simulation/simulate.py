"""Run the effects that a scene calls for, and say what each cost."""

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from player.errors import InputError
from tools.simulation.needs import Need, needs_of
from tools.simulation.scene import Scene
from tools.simulation.view import CameraView
from tools.transport.transport import Csr, FarLight, Transport

FloatArray = NDArray[np.float64]
R = TypeVar("R")
BYTES_A_RAY = 40  # pixel, u, v, and the entries that rays become
BYTES_A_BEAM = 250  # a projector pixel's rays and where they land
MAX_BYTES = 8 << 30


@dataclass(frozen=True)
class EffectReport:
    """An effect, its cost and its share: seconds, entries of T or its factors, share of the floodlit room's light."""

    need: Need
    seconds: float = 0.0
    entries: int = 0
    energy_share: float = 0.0

    def __str__(self) -> str:
        if not self.need.on:
            return f"{self.need.effect:17} off  {self.need.reason}"
        cost = f"{self.seconds:.2f} s, {self.entries} entries, {100 * self.energy_share:.1f} % of the light"
        return f"{self.need.effect:17} on   {self.need.reason}; {cost}"


@dataclass(frozen=True)
class Simulated:
    """T, and e (camera height, camera width, 3), of a scene, with one report per effect."""

    transport: Transport
    ambient: NDArray[np.float32]
    reports: tuple[EffectReport, ...]


def simulate(scene: Scene) -> Simulated:
    """Simulate what a scene calls for, nothing else; InputError if projector or camera sees nothing."""
    _check_memory(scene)
    needs = needs_of(scene)
    seconds = dict.fromkeys(needs, 0.0)

    def timed(effect: str, work: Callable[[ModuleType], R]) -> R:
        start = time.perf_counter()
        result = work(importlib.import_module(f"tools.simulation.effects.{effect}"))
        seconds[effect] += time.perf_counter() - start
        return result

    view = CameraView(scene)
    if view.empty:
        raise InputError(f"{scene.name}: the camera sees no surface; move it or point look_at at one")

    def shadow(points: FloatArray) -> NDArray[np.bool_]:
        return timed("shadows", lambda module: module.shaded(scene, points))

    shadow_test = shadow if needs["shadows"].on else None
    near: tuple[Csr, ...] = timed("direct", lambda module: module.direct_transport(scene, view, shadow_test))
    if near[0].nnz == 0:
        raise InputError(f"{scene.name}: no surface that the camera sees is lit by the projector; point it at one")
    far: FarLight | None = None
    if needs["inter_reflection"].on:
        far = timed("inter_reflection", lambda module: module.far_light(scene, view))
    transport = Transport(near, far)
    composition = transport.composition()
    added: dict[str, FloatArray] = {}
    if needs["ambient_light"].on:
        added["ambient_light"] = timed("ambient_light", lambda module: module.ambient_radiance(scene, view))
    if needs["black_level"].on:
        added["black_level"] = timed("black_level", lambda module: module.black_radiance(scene, composition))
    ambient = sum(added.values(), np.zeros_like(composition))
    seconds["direct"] -= seconds["shadows"]  # the shadow test runs inside
    light = {"direct": Transport(near).composition(), **added}
    light["inter_reflection"] = composition - light["direct"]
    total = float(np.sum(composition + ambient))
    shares = {name: float(np.sum(part)) / total for name, part in light.items()}
    entries = {"direct": sum(T.nnz for T in near), "inter_reflection": _far_entries(far)}
    reports = (EffectReport(need, seconds[n], entries.get(n, 0), shares.get(n, 0.0)) for n, need in needs.items())
    shape = scene.camera.height, scene.camera.width, 3
    return Simulated(transport, ambient.reshape(shape).astype(np.float32), tuple(reports))


def _far_entries(far: FarLight | None) -> int:
    return 0 if far is None else far.mix.size + sum(part.nnz for part in (*far.gather, *far.scatter))


def _check_memory(scene: Scene) -> None:
    rays = scene.camera.width * scene.camera.height * scene.samples**2
    cells = 0 if len(scene.surfaces) == 1 else scene.cells
    beams = 0 if len(scene.surfaces) == 1 else scene.projector.width * scene.projector.height
    needed = rays * BYTES_A_RAY + beams * BYTES_A_BEAM + cells**2 * 8 * 12
    if needed > MAX_BYTES:
        raise InputError(
            f"{scene.name}: {rays} camera rays, {beams} projector pixels and {cells} cells need about "
            f"{needed >> 30} GiB, at most {MAX_BYTES >> 30} are used; lower samples, cells or the devices' sizes"
        )
