"""Counting and timing frames: what `i` shows and `--stats FILE` writes."""

import json
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from player.files import replacing_file

RECENT = 10_000  # frames whose times are kept: minutes of playback, a fixed amount of memory


class Stats:
    """Frames shown and dropped, and milliseconds per stage of the most recent frames."""

    def __init__(self) -> None:
        self.frames = 0
        self.dropped = 0
        self.notices: list[str] = []
        self.facts: dict[str, Any] = {}
        self._stages: dict[str, deque[float]] = {}

    def add(self, stage: str, seconds: float) -> None:
        self._stages.setdefault(stage, deque(maxlen=RECENT)).append(1000 * seconds)

    def median_ms(self, stage: str) -> float:
        return float(np.median(self._stages[stage])) if stage in self._stages else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Counts, facts, and median and 95th percentile of every stage in milliseconds."""
        stages = {
            f"{stage}_ms": {"median": float(np.median(values)), "p95": float(np.percentile(values, 95))}
            for stage, values in self._stages.items()
        }
        return {"frames": self.frames, "dropped": self.dropped, **self.facts, **stages, "notices": self.notices}

    def write(self, path: Path) -> None:
        with replacing_file(path) as temporary:
            temporary.write_text(json.dumps(self.to_dict(), indent=2) + "\n", encoding="utf-8")
