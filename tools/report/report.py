"""The report on a correction map: measured figures, their pictures, one page; a folder that appears complete."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.files.picture_files import write_png
from counterlight.pipeline.operators import compensation
from counterlight.tools.inverse.build import BuiltRoom
from counterlight.tools.relighting.pictures import encoded, white_level
from counterlight.tools.report import layout, pictures, spectra
from counterlight.tools.report.advice import Advice, advise
from counterlight.tools.report.charts import bins_of
from counterlight.tools.report.impossible import Impossible, find_impossible
from counterlight.tools.report.spectra import Spectrum
from counterlight.tools.transport.transport import Csr, channel, luminance_matrix
from counterlight.tools.ways.ways import Ways, ways_of
from counterlight.writing.outputs import check_folder, is_vacant, refuse_strangers
from counterlight.writing.replacing import replacing_folder

FORMAT = 1
JSON, PAGE = "report.json", "index.html"


@dataclass(frozen=True)
class Findings:
    """Measured results: figures as in the JSON, and 8-bit pictures by file name."""

    figures: dict[str, Any]
    pictures: dict[str, NDArray[np.uint8]]


def check_report_folder(folder: Path) -> None:
    """Raises InputError if a report in `folder` would replace anything but a report; called before the long work."""
    check_folder(folder)
    if is_vacant(folder):
        return
    if not (folder / JSON).is_file():
        raise InputError(f"{folder}: exists and is no report; choose another name for --report")
    refuse_strangers(folder, (JSON, PAGE, "*.png"), "a report")


def write_page(stage: Path, figures: dict[str, Any], drawn: dict[str, NDArray[np.uint8]], page: str) -> None:
    """Write all files of a report into an empty folder."""
    for name, picture in drawn.items():
        write_png(stage / name, picture)
    (stage / JSON).write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    (stage / PAGE).write_text(page, encoding="utf-8")


def write_report(built: BuiltRoom, folder: Path) -> Path:
    """Measure, draw and write; returns the page's path. An earlier report stays until the new report is complete."""
    with replacing_folder(folder, check_report_folder) as stage:
        findings = find(built)
        write_page(stage, findings.figures, findings.pictures, layout.report_page(findings.figures))
    return folder / PAGE


def find(built: BuiltRoom) -> Findings:
    """Returns all content of the page and the JSON."""
    T = near_luminance(built)
    impossible = find_impossible(built.tier, built.maps)
    ways = ways_of(built.calibration, built.transport)
    advice = advise(built.tier, built.maps.white, impossible, ways)
    found = spectra.spectra(T, built.inverse.clusters, built.calibration.projector.shape)
    drawn, scales = _lit_pictures(built)
    drawn |= _structure_pictures(built) | {"impossible.png": impossible.picture(), "ways.png": ways.picture()}
    return Findings(_figures(built, impossible, found) | _of_ways(ways, advice) | {"picture_white": scales}, drawn)


def near_luminance(built: BuiltRoom) -> Csr:
    """Returns the luminance of the near light inside the mask, from which clusters are made."""
    return luminance_matrix(built.transport.near.inside(built.calibration.mask.ravel()))


def _lit_pictures(built: BuiltRoom) -> tuple[dict[str, NDArray[np.uint8]], dict[str, float]]:
    """Returns the four pictures of Figure 5.3, and the value that each shows as white."""
    T_pinv, calibration, mixing = compensation(built.maps), built.calibration, built.tier.mixing
    camera, projector = (np.ones((*device.shape, 3)) for device in (calibration.camera, calibration.projector))
    views = {
        "composition.png": built.tier.seen(projector),
        "dual.png": built.tier.dual(camera),
        "inverse_composition.png": np.asarray(mixing.unmixed_transpose(T_pinv.apply_transpose(projector)), np.float64),
        "inverse_dual.png": T_pinv.apply(mixing.unmixed(camera)),
    }
    scales = {name: white_level(view) for name, view in views.items()}
    scales["inverse_dual.png"] = 1 / built.maps.white  # 255 is then full drive for a white picture
    return {name: encoded(view, scales[name]) for name, view in views.items()}, scales


def _structure_pictures(built: BuiltRoom) -> dict[str, NDArray[np.uint8]]:
    clusters, calibration = built.inverse.clusters, built.calibration
    return {
        "clusters_camera.png": pictures.cluster_picture(clusters.camera, calibration.camera.shape),
        "clusters_projector.png": pictures.cluster_picture(clusters.projector, calibration.projector.shape),
        "matrix.png": pictures.transport_picture(built.transport.inside(built.calibration.mask)),
        "inverse_matrix.png": pictures.matrix_picture(channel(built.inverse.T_pinv, 1)),
        "texture.png": pictures.texture_picture(built.maps.correction),
    }


def _figures(built: BuiltRoom, impossible: Impossible, found: list[Spectrum]) -> dict[str, Any]:
    inverse, correction, calibration = built.inverse, built.maps.correction, built.calibration
    floodlight = built.tier.seen(np.ones((calibration.projector.pixels, 3)))
    lengths = correction.lookup[..., 2].ravel().astype(np.int64)
    return {
        "format": FORMAT,
        "name": calibration.name,
        "summary": built.summary,
        "colour": {"tier": built.tier.mixing.tier, "reason": built.tier.reason},
        "camera": {"width": calibration.camera.width, "height": calibration.camera.height},
        "projector": {"width": calibration.projector.width, "height": calibration.projector.height},
        "white": built.maps.white,
        "floodlight_inside_mask": _percentiles(floodlight[calibration.mask]),
        "light_outside": built.light_outside,
        "near_entries": [int(n) for n in np.count_nonzero(built.transport.near.weights, axis=0)],
        "far_cells": built.transport.far.scatter.columns if built.transport.far else 0,
        "blurred_cells": built.transport.blurred.scatter.columns if built.transport.blurred else 0,
        "clusters": {
            "count": inverse.clusters.count,
            "windowed": inverse.windowed_clusters,
            "largest_camera_pixels": int(inverse.clusters.camera_sizes.max(initial=0)),
            "largest_projector_pixels": int(inverse.clusters.projector_sizes.max(initial=0)),
            "projector_size_bins": bins_of(inverse.clusters.projector_sizes),
            "camera_size_bins": bins_of(inverse.clusters.camera_sizes),
        },
        "damping": {
            "chosen": inverse.damping,
            "candidates": [list(pair) for pair in sorted(inverse.damping_errors.items())],
        },
        "rows": {
            "entries": correction.count,
            "empty": int(np.count_nonzero(lengths == 0)),
            "median": float(np.median(lengths)),
            "longest": int(lengths.max()),
            "length_bins": bins_of(lengths),
        },
        "texture": {
            "width": int(correction.entries.shape[1]),
            "height": int(correction.entries.shape[0]),
            "fill": correction.fill,
        },
        "spectra": {"summary": spectra.summary(found), "systems": [spectrum.to_json() for spectrum in found]},
        "impossible": impossible.to_json(),
    }


def _of_ways(ways: Ways, advice: list[Advice]) -> dict[str, Any]:
    return {"ways": ways.to_json(), "advice": [each.to_json() for each in advice]}


def _percentiles(values: NDArray[np.floating]) -> dict[str, float]:
    """Returns percentiles of all values, the three channels together."""
    return {f"percentile_{q}": float(np.percentile(values, q)) for q in (1, 10, 50, 90, 99)}
