"""Describes a session: the page of key `i`, the status line, and the facts of the heartbeat."""

from pathlib import Path
from typing import Any

from counterlight.overlay.osd import Histogram, Page
from counterlight.pipeline.refinement import Certificate
from counterlight.show.lateness import ordinal
from counterlight.show.session import Session
from counterlight.show.stats import DRAWING, LATE_LABELS, STAGES

NAMES = {"gpu": "draw"}  # the key in --stats has the name of the usual drawing device
BARE = {"map": "the map's picture", "direct": "direct mapping"}


def stats_page(session: Session, message: str) -> Page:
    """Return the page with medium, position, rates, milliseconds per stage, refinement and a histogram of lateness."""
    stats, playback = session.stats, session.playback
    assert playback is not None
    info = playback.reader.info
    size = f"{info.format.width}x{info.format.height}"
    certificate = session.appraisal.certificate
    compensation = "on" if session.compensation else "off"
    screen = f"monitor {session.display.monitor}, {session.display.bits} bits"
    lines = [
        f"medium\t{Path(info.path).name}, {size}, {info.codec}, {info.frames_per_second:.3g} fps",
        f"position\t{position(session)}, medium {session.programme.on + 1} of {len(session.playlist.media)}",
        f"view\t{session.view}, compensation {compensation}, {screen}",
        f"frames\t{stats.frames} shown at {_rates(session)}, {stats.dropped} dropped"
        + (f", {stats.stalled_s:.1f} s stood still for the decoder" if stats.stalled_s else ""),
        "time\t" + ", ".join(f"{NAMES.get(stage, stage)} {stats.median_ms(stage):.1f} ms" for stage in STAGES),
        *_drawing(session),
        f"GPU path\t{session.renderer.path}",
        *_refinement(session, certificate),
        *_outside(certificate),
        f"judder\tmedian {stats.median_ms('judder'):.1f} ms, 95 % below {stats.percentile_ms('judder', 95):.1f} ms",
        *([message] if message else []),
        "frames by how late they were shown:",
    ]
    return Page(tuple(lines), Histogram((*stats.late_counts, stats.dropped), (*LATE_LABELS, "dropped")))


def _drawing(session: Session) -> list[str]:
    """Return the line with the stages of drawing, including the time per step."""
    stats = session.stats
    stages = [f"{stage} {stats.median_ms(stage):.1f} ms" for stage in DRAWING if stats.has(stage)]
    return ["drawing\t" + ", ".join(stages)] if stages else []


def _refinement(session: Session, certificate: Certificate | None) -> list[str]:
    """Return the lines about steps, their result, and the gain and cost of as many steps again."""
    governor, found = session.governor, session.appraisal.shortfall
    wanted = {"budget": governor.budget, "within": governor.within}
    limits = "".join(f", {name} {value:g}" for name, value in wanted.items() if value != "no")
    steps = (
        f"{session.steps_made} steps from {governor.start}" if session.steps_made else f"no step, {BARE[governor.bare]}"
    )
    lines = [f"refinement\t{steps}{limits}"]
    if found is not None:
        took_ms = governor.took_ms(found.further)
        cost = "" if took_ms is None else f", {took_ms:.1f} ms"
        more = f"{found.further} step{'s' * (found.further > 1)} more"
        lines += [f"picture\t{found}", f"{more}\t{found.doubling:.2g} dB nearer{cost}"]
    return lines if certificate is None else [*lines, f"bound\t{certificate}"]


def _outside(certificate: Certificate | None) -> list[str]:
    if certificate is None or certificate.outside is None:
        return []
    return [f"light outside\t{100 * certificate.outside:.0f} % of what the picture throws there without compensation"]


def position(session: Session) -> str:
    """Return the position in the form `0:00:05 / 0:01:30 (6 %)`."""
    playback = session.playback
    assert playback is not None
    duration_s = playback.reader.info.duration_s
    total = f" / {_clock(duration_s)} ({100 * playback.position_s / duration_s:.0f} %)" if duration_s else ""
    return _clock(playback.position_s) + total + (" paused" if playback.paused else "")


def status_line(session: Session) -> str:
    """Return the line that a terminal shows while a medium plays."""
    stats = session.stats
    listed = f"[{session.programme.on + 1}/{len(session.playlist.media)}] " if len(session.playlist.media) > 1 else ""
    refined = f", {session.steps_made} steps" if session.steps_made else ""
    dropped = f", {stats.dropped} dropped" if stats.dropped else ""
    return f"{listed}{position(session)}, {_rates(session)}{refined}{dropped}"


def _rates(session: Session) -> str:
    """Return `24.8 of 25 fps`, or `8.3 of 25 fps, every 3rd frame`."""
    requested, shown = session.rates
    evenly = f", every {ordinal(session.every)} frame" if session.every > 1 else ""
    return f"{shown:.1f} of {requested:.3g} fps{evenly}"


def facts(session: Session) -> dict[str, Any]:
    """Return the state of the show for a remote observer, as JSON values. Costs a step of refinement, for the gap."""
    stats, playback = session.stats, session.playback
    certificate = session.certificate()
    gap = {} if certificate is None else certificate.to_dict()
    found = session.appraisal.shortfall
    return {
        "playlist_pos": session.programme.on,
        "path": None if playback is None else str(playback.reader.info.path),
        "time_pos": round(session.position_s, 3),
        "paused": session.manner.paused,
        "media": len(session.playlist.media),
        "skipped": session.programme.skipped,
        "notices": stats.noticed,
        "fps": round(stats.frames_per_second, 2),
        "frames": stats.frames,
        "dropped": stats.dropped,
        "gpu_ms": round(stats.median_ms("gpu"), 2),
        "late_ms": round(stats.median_ms("late"), 2),
        "refine": session.steps,
        "gap": gap.get("relative_gap"),
        "gap_db": gap.get("certified_db"),
        "below_optimum_db": None if found is None else round(found.decibels, 5),
        "light_outside": gap.get("light_outside"),
        "drift": session.room.drifted,
        "in_step": stats.facts.get("in_step"),
        "watch": stats.facts.get("watch"),
    }


def _clock(seconds: float) -> str:
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"
