"""Bands of the camera's picture that other processes trace: what they are told, and what they give back."""

from dataclasses import dataclass, field
from pathlib import Path
from uuid import uuid4

from counterlight.arrays import FloatArray
from counterlight.jobs.workers import Workers
from counterlight.maps.row_map import SparseRows
from counterlight.tools.simulation.scene import Scene, load_scene


@dataclass(frozen=True)
class SceneSource:
    """Where a process finds a view of a scene.  camera, projector : (height, width), None for the scene's own.

    run : no other run's, so that no process takes what it has prepared for another one, of a scene that has changed.
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
    """Who traces bands of a scene, and where they find it."""

    workers: Workers
    source: SceneSource


@dataclass(frozen=True)
class Band:
    """Of some rows of the camera's picture: T, U, e, what is seen of the primaries; what was found."""

    near: SparseRows
    far: SparseRows | None
    ambient: FloatArray
    mixing: FloatArray
    weight: FloatArray
    seen: bool
    lit: bool
