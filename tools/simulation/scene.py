"""Scene files: a projector, a camera and surfaces, in TOML that a person reads and writes.

    name = "wall"
    samples = 4                        # rays per camera pixel and axis (default 4)
    cells = 600                        # cells of the far light, over all surfaces (default 600)
    threshold = 1e-4                   # drops entries of T below this fraction of their row's largest (default 1e-4)

    [projector]
    width = 256
    height = 192
    position = [0.6, 0.2, 2.2]         # metres, right-handed, y up
    look_at = [0, 0, 0]
    up = [0, 1, 0]                     # (default)
    horizontal_field_of_view_deg = 40
    aperture = 0.02                    # the lens' diameter in metres (default 0: everything is sharp)
    focus_distance = 2.2               # depth along the axis that is sharp (default: look_at's distance)
    vignetting = 0.2                   # light lost in the picture's corner, or "cos4" (default 0)
    distortion = [-0.1, 0.02, 0, 0, 0] # k1, k2, p1, p2, k3 of the lens, as in OpenCV (default 0)
    brightness = 1.0                   # radiance of a white card facing it at look_at's distance (default 1)
    black_level = 0.002                # light of a black pixel, as a share of a white one (default 0)
    response = "srgb"                  # "linear", "srgb", a gamma, a table or "FILE.toml" of counterlight
                                       # fit-response, in this folder or below (default "linear")
    flicker = { depth = 0.05, hz = 240 }   # amplitude as a share of the mean, and frequency; only in captures
                                           # (default: steady)
    vividness = [0.25, 0.2, 0.15]      # colour processing: a primary alone has this much more light than in white (also
                                       # white_segment or processing, as in calibration.toml; default: light adds up)
    lateral_colour = { shift = [[1.1, 0.4], [0, 0], [-0.9, -0.3]], scale = [1.003, 1, 0.998] }   # of the pictures of
                                       # red, green and blue: pixels right and down, and size (default: they coincide)
    halo = { share = 0.07, radius_deg = 1 }        # light that the lens scatters around each pixel (default none)

    [camera]                           # width to distortion as above, and:
    response = "srgb"                  # the curve of captures, as the projector's response (default "linear")
    wander = 0.025                     # deviation of the gain of a capture's channel (default 0)
    mosaic = "RGGB"                    # colour filters, from the upper left, and bilinear interpolation; or BGGR, GRBG,
                                       # GBRG (default: every pixel sees all colours)
    bloom = { share = 0.03, radius_deg = 0.4 }     # light that lens and sensor scatter into a halo (default none)
    sensor = { full_well_electrons = 20000, read_noise_electrons = 5, bits = 12 }   # of captures (default: noiseless);
                                       # with flicker: exposure_s = 0.0167, seconds of an exposure of 1, and
                                       # readout_s = 0.01, from the first row's exposure to the last row's (default 0)
    mixing = [[0.88, 0.08, 0.04], [0.06, 0.88, 0.06], [0.03, 0.09, 0.88]]   # what red, green and blue of the camera
                                       # see of red, green and blue light on neutral paint (default: only their own)
                                       # several cameras see one room as [[cameras]], each with the keys of [camera]

    [viewpoints]                       # the camera stands at each of these and keeps its look_at (default: one place)
    at = [[-0.5, 0], [0, 0], [0.5, 0]] # metres to the right and up of its position, at most 64: views for viewers that
                                       # move (docs/viewpoints.md)

    [ambient]
    irradiance = [0.02, 0.02, 0.02]    # on every surface from every side (default none)

    [[surfaces]]
    name = "bricks"
    shape = "plane"                    # the default; see below
    corner = [-1, -1, 0]               # a parallelogram: corner + u·edge_u + v·edge_v, u, v in 0..1
    edge_u = [2, 0, 0]
    edge_v = [0, 2, 0]
    albedo = [0.8, 0.8, 0.8]           # or: texture = "picture.png" (sRGB, seen from the camera's side: v points up;
                                       #     pictures are PNG or JPEG, in this folder or below)
                                       # or: pattern = { kind = "bricks", colours = [[..], [..]], repeat = [8, 16],
                                       #                 variation = 0.3 }   (kinds: bricks, stripes, checker)
    gloss = { reflectance = 0.04, roughness = 0.1 }      # a coat: specular reflectance at normal incidence, 0..1, and
                                                         # roughness from 0, a mirror, to 1 (default: matt)
    overlap = [[1, 0.7, 1], [0.8, 1, 1.2], [1, 1.1, 1]]  # with the camera's mixing: reflectance in the light that the
                                                         # channel (row) sees of the primary (column), as a share of
                                                         # the albedo there (default: 1)
    translucency = { mean_free_path = [0.004, 0.002, 0.001] }   # metres per channel, without gloss (default: opaque)

Shapes and their keys:

    plane      corner, edge_u, edge_v
    card       corner, fold (a vector along the fold), wings (two vectors from the fold): a folded card, two surfaces
    sphere     centre, radius
    cylinder   base, axis (a vector; its length is the height), radius; with caps
    relief     corner, edge_u, edge_v, height (metres) and figure ("statuette", "skull", "waves", "bricks") or heights
               (a grey picture, 8 or 16 bit); detail (fields along the longer edge); cut = true omits parts of height 0
    lathe      base, axis (default up), profile = [[radius, height], ...], detail: a solid of revolution, drawn from
               its bottom up the outside; closed if it begins and ends with radius 0
    mesh       file (OBJ), at (default the origin), scale (default 1)

Closed shapes (sphere, cylinder, lathe, mesh) can be clear solids, without a colour:

    dielectric = { index = 1.5, abbe = 60, absorption = [20, 5, 12] }   # per metre; abbe default: no dispersion

Any other key in the file is an error that names the nearest known key.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from counterlight.errors import InputError
from counterlight.files.reading import read_toml
from counterlight.files.tables import Table, Vector
from counterlight.screen import MOST_CAMERAS
from counterlight.tools.simulation.devices import Camera, Projector, read_camera, read_projector
from counterlight.tools.simulation.materials import read_material
from counterlight.tools.simulation.shapes.read import read_shapes
from counterlight.tools.simulation.surfaces import Surface
from counterlight.viewpoints import FARTHEST, Places

Size: TypeAlias = tuple[int, int]  # (height, width)
MAX_SAMPLES, MAX_CELLS = 16, 4000


@dataclass(frozen=True)
class Scene:
    """A whole room; the module's docstring states the units.

    camera : the camera that is simulated.
    others : further cameras, or further positions of a room with several views.
    places : positions of the views, the camera's first; None for a room that is one calibration.
    """

    name: str
    projector: Projector
    camera: Camera
    ambient_irradiance: Vector
    surfaces: tuple[Surface, ...]
    samples: int
    cells: int
    threshold: float
    others: tuple[Camera, ...] = ()
    places: Places | None = None

    @property
    def views(self) -> tuple["Scene", ...]:
        """Returns the room once per camera, each with that camera alone."""
        return tuple(replace(self, camera=each, others=(), places=None) for each in (self.camera, *self.others))

    def resized(self, camera: Size | None = None, projector: Size | None = None) -> "Scene":
        """Returns the scene with other picture sizes, (height, width), or None; fields of view stay."""
        return replace(
            self,
            camera=self.camera if camera is None else self.camera.resized(*camera),
            others=self.others if camera is None else tuple(other.resized(*camera) for other in self.others),
            projector=self.projector if projector is None else self.projector.resized(*projector),
        )


def load_scene(path: Path) -> Scene:
    """Read and check a scene file.

    Raises InputError that names file, table and key.
    """
    top = Table(read_toml(path, "the shipped scenes are in calib_data/scenes"), f"{path}")
    projector = read_projector(top.table("projector"), path.parent)
    cameras = top.tables("cameras", MOST_CAMERAS) if "cameras" in top else [top.table("camera")]
    camera, *others = (read_camera(table, path.parent) for table in cameras)
    places = _places(top)
    if places is not None:
        if others:
            raise InputError(f"{path}: [viewpoints] are of one camera, found {len(cameras)} [[cameras]]; leave one out")
        camera, *others = (camera.moved(*at) for at in places.at)
    ambient = top.table("ambient", optional=True)
    scene = Scene(
        name=top.text("name", path.stem),
        projector=projector,
        camera=camera,
        ambient_irradiance=ambient.vector("irradiance", (0.0, 0.0, 0.0), low=0.0),
        surfaces=tuple(
            surface for entry in top.tables("surfaces") for surface in _surfaces(entry, path.parent, camera.position)
        ),
        samples=top.integer("samples", 4, 1, MAX_SAMPLES),
        cells=top.integer("cells", 600, 2, MAX_CELLS),
        threshold=top.number("threshold", 1e-4, 0.0, 0.1),
        others=tuple(others),
        places=places,
    )
    for part in (top, ambient):
        part.refuse_unknown()
    return scene


def _places(top: Table) -> Places | None:
    if "viewpoints" not in top:
        return None
    table = top.table("viewpoints")
    listed = table.raw("at", None)
    many = len(listed) if isinstance(listed, list) else 0
    at = table.rows("at", max(many, 1), 2, -FARTHEST, FARTHEST)
    table.refuse_unknown()
    try:
        return Places(tuple((float(x), float(y)) for x, y in at))
    except InputError as error:
        raise table.refusal(f", {error}") from None


def _surfaces(table: Table, folder: Path, eye: Vector) -> list[Surface]:
    name = table.text("name", table.where.rpartition(": ")[2])
    shapes = read_shapes(table, folder, eye)
    material = read_material(table, folder)
    table.refuse_unknown()
    if material.dielectric is not None and not all(shape.closed for _, shape in shapes):
        raise InputError(
            f"{table.where}, dielectric: '{name}' bounds no solid; use a sphere, a cylinder, or a closed lathe or mesh"
        )
    return [Surface(name + suffix, shape, material) for suffix, shape in shapes]


def inside_of(scene: Scene, point: Vector) -> Surface | None:
    """Returns the solid that contains a point, or None: the nearest crossing along a ray meets its inner side."""
    from counterlight.tools.simulation.geometry import trace

    solids = [surface for surface in scene.surfaces if surface.shape.closed]
    direction = np.array([[0.36, 0.48, 0.8]])
    hits = trace(point, direction, solids)
    return solids[int(hits.surface[0])] if hits.surface[0] >= 0 and not hits.front[0] else None
