"""Files of other programs: MPCDI 2.0 (VESA), ST maps for compositors, .cube tables and OpenColorIO configurations."""

import json
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.calibration import Device
from counterlight.files import exr
from counterlight.files.picture_files import encode_png
from counterlight.passes.encode import Encode
from counterlight.raster import Region, side_by_side
from counterlight.response import TABLE_SIZE, RasterResponse, transfer_table
from counterlight.tools.exports.diagonal import Diagonal

GAMMA = 2.2  # exponent of the code values of alpha and beta maps
SAMPLES = 33  # size of a colour table along each axis
DATE = (1980, 1, 1, 0, 0, 0)  # date of files in the archive, so that equal rooms give equal archives


def stored_in_mpcdi(kept: Diagonal) -> Diagonal:
    """Returns the maps with the 8-bit alpha and beta values that MPCDI files hold."""
    alpha, beta = ((_codes(light) / 255) ** GAMMA for light in (kept.alpha, kept.beta))
    return replace(kept, alpha=alpha, beta=beta)


def write_mpcdi(path: Path, kept: Diagonal, regions: Sequence[Region]) -> None:
    """Write an MPCDI 2.0 archive, profile 2d: one buffer, and one region per projector.

    A region covers the whole buffer, so that places refer to the whole target picture. Rows are stored from the top;
    places count from the lower left corner, as in OpenGL.
    """
    height, width = kept.target
    root = ElementTree.Element(
        "MPCDI", version="2.0", profile="2d", geometry="1", color="1", level="1", date="1980-01-01"
    )
    display = ElementTree.SubElement(root, "display")
    buffer = ElementTree.SubElement(display, "buffer", _size(width, height) | {"id": "buffer"})
    files = ElementTree.SubElement(root, "files")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number, region in enumerate(regions, 1):
            own = f"projector{number}"
            place = {"x": "0", "y": "0", "xSize": "1", "ySize": "1", "xsize": "1", "ysize": "1"}
            ElementTree.SubElement(buffer, "region", {"id": own} | _size(region.width, region.height) | place)
            described = ElementTree.SubElement(files, "fileset", region=own)
            places = kept.places[region.part]
            warp = np.stack([places[..., 0], 1 - places[..., 1], np.zeros(places.shape[:2])], axis=-1)
            _add(described, "geometryWarpFile", f"{own}_warp.pfm", interpolation="linear")
            _put(archive, f"{own}_warp.pfm", b"PF\n%d %d\n-1\n" % warp.shape[1::-1] + warp.astype("<f4").tobytes())
            for kind, light in (("alpha", kept.alpha), ("beta", kept.beta)):
                file = f"{own}_{kind}.png"
                _add(described, f"{kind}Map", file, componentDepth="3", bitDepth="8", gammaEmbedded=str(GAMMA))
                _put(archive, file, encode_png(_codes(light[region.part])))
        _put(archive, "mpcdi.xml", ElementTree.tostring(root, "utf-8", xml_declaration=True))


def write_st_map(path: Path, kept: Diagonal) -> None:
    """Write an ST map of the projectors' raster as OpenEXR.

    R, G : x and y in the target picture, 0 to 1 from the lower left corner. A : 1 where a camera pixel sees the pixel.
    alpha.R, … and beta.R, … : factor and offset in linear light.
    """
    flat = np.zeros(kept.seen.shape)
    channels = {"R": kept.places[..., 0], "G": 1 - kept.places[..., 1], "B": flat, "A": kept.seen}
    for name, light in (("alpha", kept.alpha), ("beta", kept.beta)):
        channels |= {f"{name}.{channel}": values for channel, values in exr.rgb(light).items()}
    exr.write_channels(path, {name: values.astype(np.float32) for name, values in channels.items()})


def colour_table(projector: Device) -> FloatArray:
    """Returns a projector's code values for sRGB-encoded drives, (samples³, 3), 0 to 1; red changes fastest."""
    grid = np.linspace(0, 1, SAMPLES)
    blue, green, red = np.meshgrid(grid, grid, grid, indexing="ij")
    codes = np.stack([red, green, blue], axis=-1).reshape(1, -1, 3)
    light = np.interp(codes, np.linspace(0, 1, TABLE_SIZE), transfer_table("srgb"))
    _, regions = side_by_side([codes.shape[:2]])
    own = RasterResponse((projector.response,), regions, (projector.colour,))
    found = np.empty(light.shape, np.uint16)
    Encode(own, 1.0, "none").fill(light.astype(np.float32), 0, found)
    return np.asarray(found[0] / (2**16 - 1), np.float64)


def write_cube(path: Path, projector: Device) -> None:
    """Write a projector's colour table as .cube."""
    lines = [
        'TITLE "sRGB-encoded drive to code values of a projector"',
        f"LUT_3D_SIZE {SAMPLES}",
        "DOMAIN_MIN 0 0 0",
        "DOMAIN_MAX 1 1 1",
    ]
    lines += ["{:.6f} {:.6f} {:.6f}".format(*row) for row in colour_table(projector)]
    path.write_text("\n".join(lines) + "\n")


def ocio_config(cubes: Sequence[str]) -> str:
    """Returns an OpenColorIO 2 configuration: linear drive, sRGB, and a view per projector through its table."""
    srgb = "!<ExponentWithLinearTransform> {gamma: 2.4, offset: 0.055, direction: inverse}"
    lines = [
        "ocio_profile_version: 2",
        "search_path: .",
        "roles: {scene_linear: linear, default: linear, data: raw}",
        "displays:",
    ]
    for number, _ in enumerate(cubes, 1):
        lines += [f"  projector {number}:", f"    - !<View> {{name: drive, colorspace: projector {number}}}"]
    lines += [
        "colorspaces:",
        "  - !<ColorSpace> {name: raw, isdata: true}",
        "  - !<ColorSpace> {name: linear, encoding: scene-linear}",
        f"  - !<ColorSpace> {{name: sRGB, encoding: sdr-video, from_scene_reference: {srgb}}}",
    ]
    for number, cube in enumerate(cubes, 1):
        lines += [
            "  - !<ColorSpace>",
            f"    name: projector {number}",
            "    from_scene_reference: !<GroupTransform>",
            "      children:",
            f"        - {srgb}",
            f"        - !<FileTransform> {{src: {json.dumps(cube)}, interpolation: tetrahedral}}",
        ]
    return "\n".join(lines) + "\n"


def _codes(light: FloatArray) -> NDArray[np.uint8]:
    return np.round(255 * light ** (1 / GAMMA)).astype(np.uint8)


def _size(width: int, height: int) -> dict[str, str]:
    """Attributes in the spelling of version 2.0, and in the spelling of readers of version 1."""
    x, y = str(width), str(height)
    return {"xResolution": x, "yResolution": y, "Xresolution": x, "Yresolution": y}


def _add(described: ElementTree.Element, kind: str, path: str, **values: str) -> None:
    element = ElementTree.SubElement(described, kind)
    for name, text in {"path": path, **values}.items():
        ElementTree.SubElement(element, name).text = text


def _put(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    archive.writestr(zipfile.ZipInfo(name, DATE), content, zipfile.ZIP_DEFLATED)
