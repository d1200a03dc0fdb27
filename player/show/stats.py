"""Counts and times frames, for the page of key `i` and for `--stats FILE`."""

import json
import math
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from counterlight.pipeline import stage_times
from counterlight.writing.replacing import replacing_file

RECENT = 10_000  # frames whose times are kept: minutes of playback in a fixed amount of memory
MOST_NOTICES, LATEST_NOTICES = 1000, 20
STAGES = ("decode", "upload", "gpu", "present")
# stages of "gpu"; "step" is a single step, not all steps
DRAWING = (*(stage for stage in stage_times.STAGES if stage != "steps"), "step")
CHANGE = 3  # first frames of a medium, which opening the medium may delay
PERCENTILES = {"median": 50, "p95": 95, "p99": 99, "max": 100}
RECENT_S = 10  # seconds that the remote's figures cover
FEW = 120  # frames over which the rate is measured
LATE_EDGES_MS = (1, 2, 4, 8, 16, 32, 64)
LATE_LABELS = ("<1 ms", "1-2", "2-4", "4-8", "8-16", "16-32", "32-64", ">64")


class Stats:
    """Counts of shown and dropped frames, display times, and milliseconds per stage of the most recent frames.

    late : how long after its due time each frame was on the screen.
    change : the same delay for each medium's first CHANGE frames, whose due time counts from the end of the previous
        medium.
    stalled_s : how long the show's time stood still because the decoder was too slow.
    judder : difference between the interval of two frames on the screen and the interval of their due times.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.dropped = 0
        self.stalled_s = 0.0
        self.notices: list[str] = []
        self.noticed = 0  # number of all notices
        self.facts: dict[str, Any] = {}
        self._stages: dict[str, deque[float]] = {}
        self._late_counts = [0] * len(LATE_LABELS)
        self._last_late_s: float | None = None
        self._changing = 0  # how many of the CHANGE frames are still to come
        self._shown_at: deque[float] = deque(maxlen=FEW)
        self._recent: deque[tuple[float, dict[str, int]]] = (
            deque()
        )  # clock time, and frames shown, late and dropped at that time
        self._events: deque[tuple[float, str]] = deque(maxlen=LATEST_NOTICES)

    def add(self, stage: str, seconds: float) -> None:
        self._stages.setdefault(stage, deque(maxlen=RECENT)).append(1000 * seconds)

    def add_stages(self, stage_s: Mapping[str, float], steps: int) -> None:
        """Add the times of one frame's stages (pipeline/stage_times.py). The entry `step` is the time per step."""
        for stage, seconds in stage_s.items():
            if stage != "steps":
                self.add(stage, seconds)
            elif steps:
                self.add("step", seconds / steps)

    def take_times(self, other: "Stats") -> None:
        """Add the stage times that another process measured."""
        for stage, values in other._stages.items():
            self._stages.setdefault(stage, deque(maxlen=RECENT)).extend(values)

    def notice(self, text: str) -> None:
        """Record an error that did not stop the show. Only the most recent lines are kept."""
        self.notices.append(text)
        self.noticed += 1
        self._events.append((time.time(), text))
        del self.notices[:-MOST_NOTICES]

    def latest_notices(self) -> list[str]:
        return self.notices[-LATEST_NOTICES:]

    def events(self) -> list[dict[str, Any]]:
        """Return the latest notices with their times, in seconds since 1970."""
        return [{"time": round(at, 3), "text": text} for at, text in self._events]

    def drop(self, frames: int, at_s: float) -> None:
        """Count frames dropped before clock time `at_s`."""
        self.dropped += frames
        self._recall(at_s, dropped=frames)

    def recent(self, now_s: float) -> dict[str, Any]:
        """Return the frames shown, late and dropped in the last RECENT_S.

        A frame is late if the next frame was already due.
        """
        self._forget(now_s)
        sums = {name: sum(counts[name] for _, counts in self._recent) for name in ("shown", "late", "dropped")}
        return {"seconds": RECENT_S, **sums}

    def _recall(self, at_s: float, **counts: int) -> None:
        self._recent.append((at_s, {"shown": 0, "late": 0, "dropped": 0} | counts))
        self._forget(at_s)

    def _forget(self, now_s: float) -> None:
        while self._recent and self._recent[0][0] < now_s - RECENT_S:
            self._recent.popleft()

    def shown(self, at_s: float, due_s: float, duration_s: float = math.inf) -> None:
        """Count a frame on the screen.

        at_s : clock time at which it was on the screen.
        due_s : clock time at which it was due.
        duration_s : time until the next frame is due.
        """
        self._recall(at_s, shown=1, late=int(at_s - due_s > duration_s))
        late_s = at_s - due_s
        self.add("change" if self._changing else "late", late_s)
        self._changing = max(self._changing - 1, 0)
        self._late_counts[int(np.searchsorted(LATE_EDGES_MS, 1000 * late_s, side="right"))] += 1
        if self._last_late_s is not None:
            self.add("judder", abs(late_s - self._last_late_s))
        self._last_late_s = late_s
        self._shown_at.append(at_s)

    def changed(self) -> None:
        """Record that the next frame begins another medium."""
        self._changing = CHANGE

    def interrupted(self) -> None:
        """Record a pause, a seek or a new medium, so that the next interval is not counted."""
        self._last_late_s = None
        self._shown_at.clear()

    @property
    def late_counts(self) -> tuple[int, ...]:
        """Numbers of frames by lateness: below, between and above LATE_EDGES_MS."""
        return tuple(self._late_counts)

    @property
    def frames_per_second(self) -> float:
        """Rate of the last frames on the screen; 0 before the second frame."""
        span = self._shown_at[-1] - self._shown_at[0] if len(self._shown_at) > 1 else 0.0
        return (len(self._shown_at) - 1) / span if span else 0.0

    def has(self, stage: str) -> bool:
        """Whether the stage has been timed."""
        return stage in self._stages

    def median_ms(self, stage: str) -> float:
        return self.percentile_ms(stage, 50)

    def percentile_ms(self, stage: str, percent: float) -> float:
        return float(np.percentile(self._stages[stage], percent)) if stage in self._stages else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return counts, facts, and PERCENTILES of every stage in milliseconds."""
        stages = {
            f"{stage}_ms": {name: self.percentile_ms(stage, percent) for name, percent in PERCENTILES.items()}
            for stage in self._stages
        }
        late = {"late_frames": dict(zip(LATE_LABELS, self._late_counts, strict=True))} if self._shown_at else {}
        counts = {"frames": self.frames, "dropped": self.dropped, "stalled_s": round(self.stalled_s, 3)}
        return {**counts, **self.facts, **stages, **late, "notices": self.notices}

    def write(self, path: Path) -> None:
        with replacing_file(path) as temporary:
            temporary.write_text(json.dumps(self.to_dict(), indent=2) + "\n", encoding="utf-8")
