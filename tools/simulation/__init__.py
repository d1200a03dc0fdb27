"""Simulated rooms: a scene file (TOML) becomes a light transport T and ambient light e, by the effects it calls for.

**Light paths.** A path runs from a projector pixel to a camera pixel and meets at least one matt point. Seen from there
it has two sides, and T is their product, put together band by band of camera rows:

- *Camera's side* (camera_side.py): `Rays` start at the camera; a ray that ends on a matt surface becomes a row of
  `Samples`: camera pixel, point, direction to the viewer, throughput (radiance in the pixel per radiance that leaves).
- *Projector's side* (projector_side.py): `Arrivals` say which projector pixels light a sample, with which irradiance
  and from where; `Deposits` are the same light traced forwards to where it lands (the far light's cells need that).
- T's entry = throughput · reflectance · irradiance. Light that goes on between matt surfaces is far light, U M D.

**Effects** are modules of effects/, one each, imported only if needs.py says that the scene calls for them. Those with
a fixed place are called by name in simulate.py. Optical effects of materials plug in by defining any of these
functions; each returns lists or arrays, not generators, so that its time can be told:

    scatter(scene, rays, hits, effects) -> list[Rays]
        where rays go on from the surfaces that they met (reflected, refracted); every row of hits is a hit
    forward(scene, rays, hits, effects) -> list[Rays]
        the same for the projector's rays, which carry flux; one batch for each way that light can take
    spread(scene, samples) -> list[Samples]
        the batch with some samples replaced by the points where their light entered (subsurface scattering)
    reflectance(scene, samples, to_light, reflectance) -> (n, 3)
        the BRDF towards the viewer for light from unit directions to_light; given is the paint's, albedo / π
    albedo(scene, samples, albedo) -> (n, 3)
        what is left of the paint's albedo for light from all sides
    light_map(scene, effects) -> object with arrivals(samples) -> list[Arrivals] and deposits() -> list[Deposits]
        made once; projector light that comes by way of mirrors or clear solids (caustics)

A batch of rays, samples or arrivals carries the name of the effect that made it (`effect`, "direct" for straight
light); its entries and energy are counted there. Straight light is blocked by everything, clear solids too: what passes
them comes through a light map. Rules for these effects, and their order, are in optics_needs.py. Materials (gloss,
dielectric, translucency) are data in materials.py; scene.py's text is the file format.

May import numpy, scipy, cv2, embreex (shapes/triangles.py), player and counterlight.tools.{blurring,transport}.
Read next: scene.py, simulate.py.
"""
