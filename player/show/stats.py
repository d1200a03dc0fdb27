"""Counting and timing frames: what `i` shows and `--stats FILE` writes."""

import json
import math
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from counterlight.pipeline import laps
from counterlight.writing.replacing import replacing_file

RECENT = 10_000  # frames whose times are kept: minutes of playback, a fixed amount of memory
MOST_NOTICES, LATEST_NOTICES = 1000, 20
STAGES = ("decode", "upload", "gpu", "present")
DRAWING = (*(stage for stage in laps.STAGES if stage != "steps"), "step")  # of "gpu"; a step, not all of them
CHANGE = 3  # frames that a change of media may delay
PERCENTILES = {"median": 50, "p95": 95, "p99": 99, "max": 100}
RECENT_S = 10  # that the remote's figures are of
FEW = 120  # the frames that the rate is measured over
LATE_EDGES_MS = (1, 2, 4, 8, 16, 32, 64)
LATE_LABELS = ("<1 ms", "1-2", "2-4", "4-8", "8-16", "16-32", "32-64", ">64")


class Stats:
    """Frames shown and dropped, when they were shown, and milliseconds per stage of the most recent frames.

    late : how long after its time each frame stood on the screen.
    change : the same of each medium's first CHANGE frames, whose time counts from the end of the medium before.
    stalled_s : how long the show's time stood still, since the decoder could not keep up.
    judder : how much the interval between two frames on the screen differed from that between their times.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.dropped = 0
        self.stalled_s = 0.0
        self.notices: list[str] = []
        self.facts: dict[str, Any] = {}
        self._stages: dict[str, deque[float]] = {}
        self._late_counts = [0] * len(LATE_LABELS)
        self._last_late_s: float | None = None
        self._changing = 0  # frames of CHANGE that are still to come
        self._shown_at: deque[float] = deque(maxlen=FEW)
        self._recent: deque[tuple[float, dict[str, int]]] = (
            deque()
        )  # clock time, and frames shown, late and dropped then
        self._events: deque[tuple[float, str]] = deque(maxlen=LATEST_NOTICES)

    def add(self, stage: str, seconds: float) -> None:
        self._stages.setdefault(stage, deque(maxlen=RECENT)).append(1000 * seconds)

    def add_stages(self, stage_s: Mapping[str, float], steps: int) -> None:
        """Of a frame whose stages were timed (pipeline/laps.py); `step` is one of its steps."""
        for stage, seconds in stage_s.items():
            if stage != "steps":
                self.add(stage, seconds)
            elif steps:
                self.add("step", seconds / steps)

    def take_times(self, other: "Stats") -> None:
        """The stages that were timed elsewhere."""
        for stage, values in other._stages.items():
            self._stages.setdefault(stage, deque(maxlen=RECENT)).extend(values)

    def notice(self, text: str) -> None:
        """Something went wrong without stopping the show; the most recent lines are kept."""
        self.notices.append(text)
        self._events.append((time.time(), text))
        del self.notices[:-MOST_NOTICES]

    def latest_notices(self) -> list[str]:
        return self.notices[-LATEST_NOTICES:]

    def events(self) -> list[dict[str, Any]]:
        """The latest notices with their times, seconds since 1970."""
        return [{"time": round(at, 3), "text": text} for at, text in self._events]

    def drop(self, frames: int, at_s: float) -> None:
        """Frames were left out, up to clock time `at_s`."""
        self.dropped += frames
        self._recall(at_s, dropped=frames)

    def recent(self, now_s: float) -> dict[str, Any]:
        """Frames shown, late and dropped in the last RECENT_S; a frame is late once the next one is due."""
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
        """A frame stands on the screen at clock time `at_s`, due at `due_s`; the next one is due `duration_s` later."""
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
        """The next frame follows the last one of another medium."""
        self._changing = CHANGE

    def interrupted(self) -> None:
        """Pause, a seek or another medium: the next frame's interval is not the one before's."""
        self._last_late_s = None
        self._shown_at.clear()

    @property
    def late_counts(self) -> tuple[int, ...]:
        """Frames by how late they were: below, between and above LATE_EDGES_MS."""
        return tuple(self._late_counts)

    @property
    def frames_per_second(self) -> float:
        """The rate at which the last frames came to the screen; 0 before the second."""
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
        """Counts, facts, and PERCENTILES of every stage in milliseconds."""
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
