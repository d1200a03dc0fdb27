"""Small pictures of the show, shared by all browsers: each picture is requested once and kept for later requests."""

import asyncio
import time

from counterlight.remote.link import Answer, Link

INTERVAL_S = 0.2


class Pictures:
    def __init__(self, link: Link) -> None:
        self._link = link
        self._kept: dict[str, Answer] = {}
        self._asked_at: dict[str, float] = {}
        self._lock = asyncio.Lock()

    async def take(self, name: str, serial: object) -> Answer:
        """Return the answer to `preview NAME SERIAL`. Asks the show for a picture at most five times per second."""
        async with self._lock:
            if time.monotonic() - self._asked_at.get(name, -INTERVAL_S) >= INTERVAL_S:
                answer = await self._link.ask("preview", name, self._kept.get(name, {}).get("serial", -1))
                if answer["error"] != "success":
                    return answer
                self._asked_at[name] = time.monotonic()
                if answer["data"] is not None:
                    self._kept[name] = answer["data"]
        kept = self._kept.get(name)
        return {"error": "success", "data": None if kept is None or kept["serial"] == serial else kept}
