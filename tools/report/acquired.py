"""The report on an acquisition: the captures, the resulting T, and the expected quality of compensation."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight import calibration as calibrations
from counterlight.calibration import Calibration, Device
from counterlight.pipeline.content import psnr, reachable_white
from counterlight.tools.acquisition.check import Check
from counterlight.tools.acquisition.preflight import Finding
from counterlight.tools.acquisition.summary import AcquisitionReport, LightOutside, ProjectorReport
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.relighting.pictures import encoded, white_level
from counterlight.tools.report import charts, pictures
from counterlight.tools.report.page import Figure, Section, page, table
from counterlight.tools.report.report import FORMAT, PAGE, check_report_folder, write_page
from counterlight.tools.solve.box import Box
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import Transport, luminance
from counterlight.writing.replacing import replacing_folder

PROMISED = ("photograph", "letters")  # the first two typical pictures
MOST_PREDICTED = 1 << 17  # largest camera, in pixels, for which the report computes the optimum
OPTIMUM_GAP, MOST_STEPS = 0.01, 300  # relative gap of the squared error; largest number of steps of projected gradient
CURVE = 65  # points of a response's curve
PRIMARY_COLOURS = "#c0392b", "#27913f", "#2f6fc0"
SMOOTH = 6  # camera pixels per picture pixel: with little detail, faults of T are visible


def write_acquisition_report(room: Path, report: AcquisitionReport, findings: list[Finding], folder: Path) -> Path:
    """Measure the stored calibration `room`, draw and write the page; returns its path."""
    with replacing_folder(folder, check_report_folder) as stage:
        stored = calibrations.read(room)
        transport, calibration = read_transport(stored), stored.calibration
        drawn, whites = _pictures(transport, calibration, report)
        figures = _figures(transport, calibration, report, findings) | {"picture_white": whites}
        write_page(stage, figures, drawn, acquisition_page(figures))
    return folder / PAGE


def predicted_quality(
    transport: Transport, calibration: Calibration, check_error: float
) -> dict[str, dict[str, float]]:
    """Returns two PSNRs in dB of the best compensation: without errors of T, and with the error that the check found.

    A relative error δ of the predicted light c adds δ² mean c² to the mean squared error. The optimum is certified to
    0.04 dB. If T is so ill-conditioned that MOST_STEPS do not suffice, the best picture so far counts. On rooms of the
    rig and shipped rooms that picture was within 0.05 dB of the optimum.
    """
    shape, mask = calibration.camera.shape, calibration.mask
    white = reachable_white(transport.floodlight(calibration.ambient), mask)
    box = Box(transport.inside(mask), tolerance=OPTIMUM_GAP, most_steps=MOST_STEPS)
    found = dict[str, dict[str, float]]()
    for detail, label in ((1, "at the camera's resolution"), (SMOOTH, "smooth")):
        small = typical_pictures(tuple(max(side // detail, 2) for side in shape))  # type: ignore[arg-type]
        for name, grey in zip(PROMISED, small, strict=False):
            picture = cv2.resize(grey, shape[::-1], interpolation=cv2.INTER_LINEAR)
            desired = white * np.repeat(picture[:, :, None], 3, axis=2)
            drive, _ = box.run(np.where(mask[..., None], desired - calibration.ambient, 0).reshape(-1, 3))
            seen = transport.apply(drive).reshape(desired.shape) + calibration.ambient
            square = float(np.mean(((seen - desired)[mask] / white) ** 2))
            doubt = check_error**2 * float(np.mean((desired[mask] / white) ** 2))
            found[f"{name}, {label}"] = {"by_transport": psnr(square), "with_check_error": psnr(square + doubt)}
    return found


def _pictures(
    transport: Transport, calibration: Calibration, report: AcquisitionReport
) -> tuple[dict[str, NDArray[np.uint8]], dict[str, float]]:
    rooms = [each.acquisition.room for each in report.projectors]
    views = {
        **dict(zip(_floodlights(len(rooms)), (room.floodlight for room in rooms), strict=True)),
        "black.png": rooms[0].black,
        "composition.png": transport.floodlight(calibration.ambient),
        "dual.png": transport.apply_transpose(np.ones((*calibration.camera.shape, 3))),
    }
    whites = {name: white_level(view) for name, view in views.items()}
    drawn = {name: encoded(view, whites[name]) for name, view in views.items()}
    sent = np.bincount(transport.near.indices, luminance(transport.near.weights), transport.shape[1])
    coverage = np.where(sent > 0, 255, 0).astype(np.uint8).reshape(calibration.projector.shape)
    mask = np.where(calibration.mask, 255, 0).astype(np.uint8)
    return drawn | {
        "coverage.png": np.repeat(coverage[..., None], 3, axis=2),
        "mask.png": np.repeat(mask[..., None], 3, axis=2),
        "clusters_camera.png": pictures.cluster_picture(report.clusters.camera, calibration.camera.shape),
        "clusters_projector.png": pictures.cluster_picture(report.clusters.projector, calibration.projector.shape),
    }, whites


def _floodlights(count: int) -> list[str]:
    """Returns the file names of the floodlights, one per projector."""
    return ["floodlight.png"] if count == 1 else [f"floodlight_{number}.png" for number in range(1, count + 1)]


def _figures(
    transport: Transport, calibration: Calibration, report: AcquisitionReport, findings: list[Finding]
) -> dict[str, Any]:
    taken = [each.acquisition for each in report.projectors]
    small = calibration.camera.pixels <= MOST_PREDICTED
    worst = max(done.check.error for done in taken)
    return {
        "format": FORMAT,
        "name": calibration.name,
        "provenance": calibration.provenance,
        "summary": str(report).splitlines(),
        "expected": None if report.expected is None else vars(report.expected) | {"words": str(report.expected)},
        "camera": {"width": calibration.camera.width, "height": calibration.camera.height},
        "projector": {"width": calibration.projector.width, "height": calibration.projector.height},
        "preflight": [{"check": f.check, "grade": f.grade, "sentence": f.sentence} for f in findings],
        "pictures": sum(done.pictures for done in taken),
        "exposures": sum(done.exposures for done in taken),
        "seconds": sum(done.seconds for done in taken),
        "projectors": [
            _of_projector(device, each) for device, each in zip(calibration.projectors, report.projectors, strict=True)
        ],
        "warnings": report.warnings,
        "coverage": report.covered,
        "light_outside": None if report.outside is None else asdict(report.outside),
        "masked_camera_pixels": report.masked,
        "near_entries": report.entries,
        "far_cells": transport.far.scatter.columns if transport.far else 0,
        "clusters": {
            "count": report.clusters.count,
            "projector_size_bins": charts.bins_of(report.clusters.projector_sizes),
        },
        "predicted_psnr": predicted_quality(transport, calibration, worst) if small else {},
    }


def acquisition_page(figures: dict[str, Any]) -> str:
    """Returns the page, from the figures in the JSON."""
    camera, projector = (f"{figures[side]['width']}x{figures[side]['height']}" for side in ("camera", "projector"))
    expected = figures["expected"]
    intro = f"<p>{expected['words']}</p>" if expected else ""
    intro += table(
        [
            ("camera, projector", f"{camera}, {projector}"),
            ("pictures shown, exposures taken", f"{figures['pictures']}, {figures['exposures']}"),
            ("seconds of the last run", f"{figures['seconds']:.0f}"),
            ("projector pixels that are seen", f"{100 * figures['coverage']:.1f} %"),
            ("camera pixels in the mask", f"{figures['masked_camera_pixels']}"),
            ("light outside", _outside(figures["light_outside"])),
            ("near light, entries a channel; far light, cells", f"{figures['near_entries']}; {figures['far_cells']}"),
        ]
    )
    sections = [_quality(figures), _captured(figures), _light(figures), _transport(figures), _clusters(figures)]
    return page(f"Acquisition: {figures['name']}", intro, [*sections, Section("Before it", [], _findings(figures))])


def _outside(light: dict[str, Any] | None) -> str:
    return "-" if light is None else f"{LightOutside(**light)}"


def _each(figures: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield a name (empty for one projector) and the figures of each projector."""
    several = len(figures["projectors"]) > 1
    for number, found in enumerate(figures["projectors"], 1):
        yield f"projector {number}: " if several else "", found


def _quality(figures: dict[str, Any]) -> Section:
    rows = []
    for name, found in _each(figures):
        rows += [
            (
                f"{name}{check['of']}: error of the prediction (noise alone)",
                f"{100 * check['error']:.1f} % ({100 * check['noise']:.1f} %)",
            )
            for check in (found["check"], found["coloured_check"])
            if check
        ]
    for name, found in figures["predicted_psnr"].items():
        both = f"{found['by_transport']:.1f} dB, {found['with_check_error']:.1f} dB"
        rows.append((f"{name}: best PSNR inside the mask by this T, and with the check's error", both))
    note = (
        " ".join(f"{words[0].upper()}{words[1:]}." for words in figures["warnings"])
        or "A picture with more detail than the projector can show has a low best PSNR whatever T is; a smooth "
        "one shows what T is worth."
    )
    return Section("Predicted quality of compensation", [], f'{table(rows)}<p class="note">{note}</p>')


def _captured(figures: dict[str, Any]) -> Section:
    white, names = figures["picture_white"], [name or "Projector " for name, _ in _each(figures)]
    return Section(
        "What was captured",
        [
            *(
                Figure("Floodlight", f"{name}white. White is {white[file]:.3g}.", file=file)
                for name, file in zip(names, _floodlights(len(names)), strict=True)
            ),
            Figure(
                "Black level",
                f"The projector black: ambient light and leakage. Brightened, white is {white['black.png']:.3g}.",
                file="black.png",
            ),
            Figure("Mask", "Camera pixels that count: clearly lit by single projector pixels.", file="mask.png"),
        ],
    )


def _checked(check: Check) -> dict[str, Any]:
    return {"error": check.error, "noise": check.noise, "of": check.of}


def _of_projector(device: Device, report: ProjectorReport) -> dict[str, Any]:
    """Returns how a projector was measured: checks, response curves, and errors of readings and primaries."""
    codes, done = np.repeat(np.linspace(0, 1, CURVE)[:, None], 3, axis=1), report.acquisition
    light = done.light
    measured = {} if light is None else {
        "off_readings": light.fitted, "noise": light.noise, "unadded": light.unadded.tolist(),
        "crosstalk": light.crosstalk,
    }  # fmt: skip
    return {
        "width": device.width,
        "height": device.height,
        "check": _checked(done.check) | {"suspect": report.suspect},
        "coloured_check": None if done.of_colours is None else _checked(done.of_colours),
        "response": {"curves": device.response.to_linear(codes).T.tolist(), **measured},
        "light": report.light,
    }  # fmt: skip


def _light(figures: dict[str, Any]) -> Section:
    curves, rows = [], []
    for name, found in _each(figures):
        caption = "Light above black of a code value, of red, green and blue."
        drawn = charts.rising(found["response"]["curves"], PRIMARY_COLOURS, "code value, 0 to 255")
        curves.append(Figure(f"{name}response".capitalize(), caption, svg=drawn))
        rows += [(f"{name}{what}", words) for what, _, words in (line.partition(": ") for line in found["light"])]
    return Section("The projector's light", curves, table(rows))


def _transport(figures: dict[str, Any]) -> Section:
    white = figures["picture_white"]
    return Section(
        "The light transport T",
        [
            Figure(
                "Composition T·1 + e",
                "The floodlit room as T predicts it: it must look like the floodlight above. "
                f"White is {white['composition.png']:.3g}.",
                file="composition.png",
            ),
            Figure(
                "Dual Tᵀ·1",
                "The room from the projector's place, lit by the camera (thesis eq. 3.12). Noise here is noise of T. "
                f"White is {white['dual.png']:.3g}.",
                file="dual.png",
            ),
            Figure(
                "Coverage", "Projector pixels that some camera pixel sees; black ones stay dark.", file="coverage.png"
            ),
        ],
    )


def _clusters(figures: dict[str, Any]) -> Section:
    found = figures["clusters"]
    return Section(
        "Clusters",
        [
            Figure("In camera space", "One colour a cluster; dark is unconnected.", file="clusters_camera.png"),
            Figure("In projector space", "The same colours.", file="clusters_projector.png"),
            Figure(
                "Sizes",
                f"{found['count']} clusters; projector pixels a cluster (bar height: square root of the count).",
                svg=charts.histogram(found["projector_size_bins"], "projector pixels a cluster"),
            ),
        ],
    )


def _findings(figures: dict[str, Any]) -> str:
    rows = [(f"{f['check']}: {f['sentence']}", f["grade"]) for f in figures["preflight"]]
    return table(rows) if rows else '<p class="note">Projector and camera were not checked.</p>'
