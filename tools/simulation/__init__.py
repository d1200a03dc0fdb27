"""Simulated rooms: a scene file (TOML) becomes a light transport T and ambient light e.

**Light paths.** A path runs from a projector pixel to a camera pixel and meets at least one matt point. That point
divides the path into two sides, and T is the product of both. T is assembled in bands of camera rows:

- *Camera side* (bands.py): `Rays` start at the camera. A ray that ends on a matt surface becomes a row of
  `Samples`: camera pixel, point, direction to the viewer, throughput (radiance in the pixel per radiance that leaves).
- *Projector side* (projector_side.py): `Arrivals` state which projector pixels light a sample, with which irradiance
  and from where. `Deposits` are the same light traced forwards to where it lands; the cells of the far light need them.
- T's entry = throughput · reflectance · irradiance. Light that continues between matt surfaces is far light, U M D.

**Effects** are modules of effects/, imported only if needs.py finds that the scene calls for them.
simulate.py calls effects with a fixed place by name. Optical effects of materials plug in by defining any of these
functions. Each function returns lists or arrays, not generators, so that its time can be measured:

    scatter(scene, rays, hits, effects) -> list[Rays]
        rays that continue from the surfaces that `rays` met (reflected, refracted); every row of hits is a hit
    forward(scene, rays, hits, effects) -> list[Rays]
        the same for the projector's rays, which carry flux; one batch per way that light can take
    spread(scene, samples) -> list[Samples]
        the batch with some samples replaced by the points where their light entered (subsurface scattering)
    reflectance(scene, samples, to_light, reflectance) -> (n, 3)
        the BRDF towards the viewer for light from unit directions to_light; the argument is the paint's, albedo / π
    albedo(scene, samples, albedo) -> (n, 3)
        the remaining part of the paint's albedo for light from all sides
    light_map(scene, effects) -> object with arrivals(samples) -> list[Arrivals] and deposits() -> list[Deposits]
        made once; projector light that arrives by mirrors or clear solids (caustics)

A batch of rays, samples or arrivals carries the name of the effect that made it (`effect`; straight light: "direct").
Its entries and energy are counted under that name. Every surface blocks straight light, clear solids too; light through
clear solids arrives by a light map. needs.py holds the rules and the order of these effects. materials.py holds
materials (gloss, dielectric, translucency) as data. The docstring of scene.py defines the file format.

May import numpy, scipy, cv2, embreex (shapes/triangles.py), player and counterlight.tools.{blurring,transport}.
Read next: scene.py, simulate.py.
"""
