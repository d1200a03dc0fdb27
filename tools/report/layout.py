"""Figures of the page, in order, with captions that say what to look for."""

from html import escape
from typing import Any

from counterlight.tools.report import charts
from counterlight.tools.report.impossible import REASONS, SERVED
from counterlight.tools.report.page import Figure, Section, legend, page, table
from counterlight.tools.ways.ways import DARK, STRAIGHT, WAYS


def report_page(figures: dict[str, Any]) -> str:
    """Returns the page of a report, from the figures in its JSON."""
    intro = f"<p>{escape(figures['summary'])}</p>{_overview(figures)}"
    sections = [_impossible(figures), _ways(figures), _light(figures), _inverse_light(figures), _clusters(figures)]
    return page(f"Correction map: {figures['name']}", intro, [*sections, _inversion(figures), _packing(figures)])


def _overview(figures: dict[str, Any]) -> str:
    camera, projector, flood = figures["camera"], figures["projector"], figures["floodlight_inside_mask"]
    light = " / ".join(f"{flood[f'percentile_{q}']:.3g}" for q in (1, 10, 50, 90, 99))
    return table(
        [
            ("camera", f"{camera['width']}x{camera['height']}"),
            ("projector", f"{projector['width']}x{projector['height']}"),
            ("white level (radiance that nine in ten pixels reach)", f"{figures['white']:.4g}"),
            ("floodlight inside the mask, percentiles 1 / 10 / 50 / 90 / 99", light),
            ("near light, entries a channel", f"{max(figures['near_entries'])}"),
            ("far light, cells", f"{figures['far_cells'] or 'none'}"),
        ]
    )


def _impossible(figures: dict[str, Any]) -> Section:
    counts = figures["impossible"]
    pixels = figures["camera"]["width"] * figures["camera"]["height"]
    rows = [
        (reason.colour, reason.words, counts[reason.name]["shown"], counts[reason.name]["all"])
        for reason in (SERVED, *REASONS)
    ]
    figure = Figure(
        "The impossible map",
        "Camera space. Coloured pixels cannot be corrected whatever is projected, each in the colour of its first "
        "reason in the table. Large red or orange areas: lower --white or raise the projector's light. Blue: darken "
        "the room; in a corner it is light from the other wall. Violet along edges is normal, violet areas are not.",
        file="impossible.png",
    )
    advice = "".join(f"<li>{escape(each['words'])}</li>" for each in figures["advice"])
    return Section(
        "What cannot be corrected", [figure], legend(rows, pixels) + (f"<ul>{advice}</ul>" if advice else "")
    )


def _ways(figures: dict[str, Any]) -> Section:
    counts, pixels = figures["ways"], figures["camera"]["width"] * figures["camera"]["height"]
    rows = [
        (way.colour, way.words, counts[way.name]["shown"], counts[way.name]["all"]) for way in (STRAIGHT, *WAYS, DARK)
    ]
    figure = Figure(
        "Ways",
        "Camera space, from T alone: pixels of whose light a tenth or more did not come straight from the projector, "
        "in the colour of the way that brought most of that. Footprints in T that are wide, in many spots, off the "
        "lines on which straight light lies, or strewn over everything say which.",
        file="ways.png",
    )
    return Section("How light comes", [figure], legend(rows, pixels))


def _light(figures: dict[str, Any]) -> Section:
    white = figures["picture_white"]
    return Section(
        "The light transport T",
        [
            Figure(
                "Composition T·1 + e",
                "The room in full projector light, from the camera. Dark or clipped patches limit what can be shown. "
                f"White is {white['composition.png']:.3g}.",
                file="composition.png",
            ),
            Figure(
                "Dual Tᵀ·1",
                "The room from the projector's place, lit by the camera. Holes are projector pixels that no camera "
                f"pixel sees. White is {white['dual.png']:.3g}.",
                file="dual.png",
            ),
            Figure(
                "T as a matrix",
                "Rows are camera pixels, columns projector pixels, both in reading order; brightness is the sum of a "
                "block, over four decades. A diagonal is a plain wall; blocks next to it are light that scatters, and "
                "what is grey all over is far light.",
                file="matrix.png",
            ),
        ],
    )


def _inverse_light(figures: dict[str, Any]) -> Section:
    return Section(
        "Its inverse T⁺",
        [
            Figure(
                "Inverse composition, T⁺ᵀ·1",
                "Drive that one unit of a camera pixel's radiance asks for. Bright where the surface is dark or badly "
                f"lit. White is {figures['picture_white']['inverse_composition.png']:.3g}; negative sums are black.",
                file="inverse_composition.png",
            ),
            Figure(
                "Inverse dual, T⁺·1",
                "What the projector shows for an even white picture at the white level; 255 is full drive, where it "
                "would have to show more. Speckle means that the inverse amplifies noise: more damping helps.",
                file="inverse_dual.png",
            ),
            Figure(
                "T⁺ as a matrix",
                "Rows are projector pixels, columns camera pixels; |entries| of the green channel over four decades.",
                file="inverse_matrix.png",
            ),
        ],
    )


def _clusters(figures: dict[str, Any]) -> Section:
    found = figures["clusters"]
    words = f"{found['count']} clusters, {found['windowed']} of them large enough to be inverted through windows."
    return Section(
        "Clusters",
        [
            Figure(
                "Clusters in camera space",
                "One colour a cluster; dark is unconnected. One colour everywhere: nothing separates, so the inverse "
                "works through windows.",
                file="clusters_camera.png",
            ),
            Figure("Clusters in projector space", "The same colours.", file="clusters_projector.png"),
            Figure(
                "Cluster sizes",
                "Projector pixels a cluster (bar height: square root of the count).",
                svg=charts.histogram(found["projector_size_bins"], "projector pixels a cluster"),
            ),
        ],
        f'<p class="note">{words}</p>',
    )


def _inversion(figures: dict[str, Any]) -> Section:
    damping = figures["damping"]
    shown = []
    if damping["candidates"]:
        shown.append(
            Figure(
                f"λ chosen: {damping['chosen']:g} σ₁",
                "Camera error (root mean square radiance) after the clamp for each candidate; red was taken. A choice "
                "at either end says that a value beyond might do better.",
                svg=charts.curve([(a, b) for a, b in damping["candidates"]], damping["chosen"], "λ / σ₁"),
            )
        )
    rows = [] if shown else [("λ, given by --regularize", f"{damping['chosen']:g} σ₁")]
    summary = figures["spectra"]["summary"]
    for kind, label in (("cluster", "whole clusters"), ("window", "sampled windows")):
        if kind in summary:
            found = summary[kind]
            rows += [
                (f"{label} looked at", f"{found['systems']}"),
                (f"{label}: condition, median", f"{found['condition_median']:.3g}"),
                (f"{label}: condition, largest", f"{found['condition_largest']:.3g}"),
                (f"{label}: rank-deficient", f"{found['rank_deficient']}"),
                (f"{label}: largest rank deficit", f"{found['largest_rank_deficit']}"),
            ]
    limit, side = summary["cluster_side_limit"], summary["window_side"]
    note = (
        f"Singular values of T before damping. Clusters of at most {limit} pixels a side are taken whole; of a cluster "
        f"that is inverted through windows, up to six windows of {side}×{side} projector pixels."
    )
    return Section("Inversion", shown, table(rows) + f'<p class="note">{note}</p>')


def _packing(figures: dict[str, Any]) -> Section:
    rows, texture = figures["rows"], figures["texture"]
    return Section(
        "What the graphics card reads",
        [
            Figure(
                "Row lengths",
                f"Camera pixels that a projector pixel reads: median {rows['median']:g}, longest {rows['longest']}, "
                f"{rows['empty']} rows are empty. The sum, {rows['entries']}, is the cost of a frame.",
                svg=charts.histogram(rows["length_bins"], "entries a row"),
            ),
            Figure(
                f"Entries texture, {texture['width']}x{texture['height']}, {100 * texture['fill']:.2f} % full",
                "White texels are in use. Black beyond the lower right edge is wasted memory.",
                file="texture.png",
            ),
        ],
    )
