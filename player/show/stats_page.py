"""What a session says of itself: the page that `i` shows, and the facts of the heartbeat."""

from pathlib import Path
from typing import Any

from counterlight.overlay.osd import Histogram, Page
from counterlight.pipeline.refinement import Certificate
from counterlight.show.session import Session
from counterlight.show.stats import LATE_LABELS

STAGES = ("decode", "upload", "gpu", "present")


def stats_page(session: Session, message: str) -> Page:
    """Medium, position, rates, the milliseconds of each stage, refinement, and how late frames were."""
    stats, playback = session.stats, session.playback
    assert playback is not None
    info = playback.reader.info
    size = f"{info.format.width}x{info.format.height}"
    certificate = session.certificate()
    compensation = "on" if session.compensation else "off"
    lines = [
        f"medium\t{Path(info.path).name}, {size}, {info.codec}, {info.frames_per_second:.3g} fps",
        f"position\t{position(session)}, medium {session.programme.on + 1} of {len(session.playlist.media)}",
        f"view\t{session.view}, compensation {compensation}, monitor {session.display.monitor}",
        f"frames\t{stats.frames} shown at {stats.frames_per_second:.1f} fps, {stats.dropped} dropped"
        + (f", {stats.stalled_s:.1f} s stood still for the decoder" if stats.stalled_s else ""),
        "time\t" + ", ".join(f"{stage} {stats.median_ms(stage):.1f} ms" for stage in STAGES),
        f"GPU path\t{session.renderer.path}",
        f"refinement\t{session.steps} steps" + (f", {certificate}" if certificate is not None else ""),
        *_outside(certificate),
        f"judder\tmedian {stats.median_ms('judder'):.1f} ms, 95 % below {stats.percentile_ms('judder', 95):.1f} ms",
        *([message] if message else []),
        "frames by how late they were shown:",
    ]
    return Page(tuple(lines), Histogram((*stats.late_counts, stats.dropped), (*LATE_LABELS, "dropped")))


def _outside(certificate: Certificate | None) -> list[str]:
    if certificate is None or certificate.outside is None:
        return []
    return [f"light outside\t{100 * certificate.outside:.0f} % of what the picture throws there without compensation"]


def position(session: Session) -> str:
    """`0:00:05 / 0:01:30 (6 %)`."""
    playback = session.playback
    assert playback is not None
    duration_s = playback.reader.info.duration_s
    total = f" / {_clock(duration_s)} ({100 * playback.position_s / duration_s:.0f} %)" if duration_s else ""
    return _clock(playback.position_s) + total + (" paused" if playback.paused else "")


def status_line(session: Session) -> str:
    """What a terminal says while a medium plays."""
    stats = session.stats
    listed = f"[{session.programme.on + 1}/{len(session.playlist.media)}] " if len(session.playlist.media) > 1 else ""
    refined = f", {session.steps} steps" if session.compensation and session.steps else ""
    dropped = f", {stats.dropped} dropped" if stats.dropped else ""
    return f"{listed}{position(session)}, {stats.frames_per_second:.1f} fps{refined}{dropped}"


def facts(session: Session) -> dict[str, Any]:
    """JSON-able: what somebody far away wants to know of the show. Costs a step of refinement, for the gap."""
    stats, playback = session.stats, session.playback
    certificate = session.certificate()
    gap = {} if certificate is None else certificate.to_dict()
    return {
        "playlist_pos": session.programme.on,
        "path": None if playback is None else str(playback.reader.info.path),
        "time_pos": round(session.position_s, 3),
        "paused": session.manner.paused,
        "fps": round(stats.frames_per_second, 2),
        "frames": stats.frames,
        "dropped": stats.dropped,
        "gpu_ms": round(stats.median_ms("gpu"), 2),
        "late_ms": round(stats.median_ms("late"), 2),
        "refine": session.steps,
        "gap": gap.get("relative_gap"),
        "gap_db": gap.get("below_optimum_db"),
        "light_outside": gap.get("light_outside"),
        "drift": session.room.drifted,
        "in_step": stats.facts.get("in_step"),
    }


def _clock(seconds: float) -> str:
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"
