"""The heartbeats of a show so far."""

import json
from pathlib import Path


class Heart:
    """Figures of a show's heartbeats.

    longest_s : longest time between two beats.
    grown : growth of the memory since the first beat, bytes.
    resident : bytes at the last beat.
    """

    def __init__(self, log: Path) -> None:
        self._log, self._read, self._since, self._first = log, 0, 0.0, 0
        self.longest_s, self.frames, self.dropped, self.resident, self.grown = 0.0, 0, 0, 0, 0

    def look(self) -> None:
        """Read the beats since the last look."""
        with self._log.open() as lines:
            lines.seek(self._read)
            text = lines.read()
        whole = text[: text.rfind("\n") + 1]
        self._read += len(whole.encode())
        for line in whole.splitlines():
            beat = json.loads(line)
            self._first = self._first or beat["rss_bytes"]
            self.resident = beat["rss_bytes"]
            self.grown = max(self.grown, self.resident - self._first)
            self.longest_s = max(self.longest_s, beat["time"] - self._since if self._since else 0.0)
            self._since, self.frames, self.dropped = beat["time"], beat["frames"], beat["dropped"]
