"""Bands of the camera picture that worker processes trace: their input and their result."""

from dataclasses import dataclass, field
from pathlib import Path
from uuid import uuid4

from counterlight.arrays import FloatArray
from counterlight.jobs.workers import Workers
from counterlight.maps.row_map import SparseRows
from counterlight.tools.simulation.scene import Scene, load_scene


@dataclass(frozen=True)
class SceneSource:
    """The scene file and view that a worker process loads.

    camera, projector : (height, width), or None for the scene's own size.
    run : unique per run, so that a process never reuses what it prepared for an earlier version of the scene.
    """

    path: Path
    camera: tuple[int, int] | None
    projector: tuple[int, int] | None
    view: int
    run: str = field(default_factory=lambda: uuid4().hex)

    def read(self) -> Scene:
        return load_scene(self.path).resized(self.camera, self.projector).views[self.view]


@dataclass(frozen=True)
class Elsewhere:
    """The processes that trace bands, and the scene that they load."""

    workers: Workers
    source: SceneSource


@dataclass(frozen=True)
class Band:
    """Result for some rows of the camera picture.

    near, far : T and U; far is None without far light.
    ambient : e.
    mixing, weight : sums for X, as in crosstalk.of_pixels.
    seen, lit : whether a camera ray met a matt point, and whether projector light reached such a point.
    """

    near: SparseRows
    far: SparseRows | None
    ambient: FloatArray
    mixing: FloatArray
    weight: FloatArray
    seen: bool
    lit: bool
