"""One browser: answers its requests in order, and sends it the latest property values and small pictures.

    in    {"command": ["set_property", "pause", true], "request_id": 7}       as at the control socket
    out   {"request_id": 7, "error": "success", "data": null}
    out   {"event": "properties", "values": {"pause": true, "time-pos": 3.2}}  changed values
    out   {"event": "known", "commands": {…}, "properties": {…}}               at first

If a browser does not read its answers, the process stops reading from it, and later disconnects it. Too many
requests are delayed.
"""

import asyncio
import json
import math
import time
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from counterlight.remote.link import Answer, Link
from counterlight.unattended.json_lines import encode

PICTURE_INTERVAL_S = 0.2  # least seconds between two requests to the show for a picture


class Pictures:
    def __init__(self, link: Link) -> None:
        self._link = link
        self._kept: dict[str, Answer] = {}
        self._asked_at: dict[str, float] = {}
        self._lock = asyncio.Lock()

    async def take(self, name: str, serial: object) -> Answer:
        """Return the answer to `preview NAME SERIAL`. Asks the show for a picture at most five times per second."""
        async with self._lock:
            if time.monotonic() - self._asked_at.get(name, -math.inf) >= PICTURE_INTERVAL_S:
                answer = await self._link.ask("preview", name, self._kept.get(name, {}).get("serial", -1))
                if answer["error"] != "success":
                    return answer
                self._asked_at[name] = time.monotonic()
                if answer["data"] is not None:
                    self._kept[name] = answer["data"]
        kept = self._kept.get(name)
        return {"error": "success", "data": None if kept is None or kept["serial"] == serial else kept}


INTERVAL_S = 0.1  # seconds between two messages about changes
PATIENCE_S = 15.0  # longest wait for a browser that does not read
MOST_EVENTS = 3  # most events kept for a browser that does not read
A_SECOND, AT_ONCE = 30.0, 60.0  # requests per second, and most requests in a burst
# allowed besides the commands; a visitor may not change the shared observations
REQUESTS = ("get_property", "set_property")


class Visitor:
    def __init__(self, connection: ServerConnection, link: Link, pictures: Pictures) -> None:
        self._connection, self._link, self._pictures = connection, link, pictures
        self._news: dict[str, object] = dict(link.values)
        known: Answer = {"commands": dict(link.commands), "properties": dict(link.properties)}
        self._events: list[Answer] = [{"event": "known"} | known]
        self._awake = asyncio.Event()
        self._pace = Pace(A_SECOND, AT_ONCE)
        self._awake.set()

    async def serve(self) -> None:
        """Serve until the browser disconnects or stops reading."""
        telling = asyncio.create_task(self._tell())
        try:
            async for message in self._connection:
                await asyncio.sleep(self._pace.wait_s())
                await self._send(await self._answer(message))
        except (ConnectionClosed, TimeoutError):
            pass
        finally:
            telling.cancel()
            self._connection.transport.abort()  # unread data is discarded

    def hear(self, heard: Answer) -> None:
        """Queue an event of the show. It is sent once the browser has read the earlier messages."""
        if heard["event"] == "property-change":
            self._news[heard["name"]] = heard["data"]
        else:
            self._events = [*self._events[-MOST_EVENTS:], heard]
        self._awake.set()

    async def _tell(self) -> None:
        while True:
            await self._awake.wait()
            self._awake.clear()
            events, self._events = self._events, []
            news, self._news = self._news, {}
            try:
                for heard in [*events, *([{"event": "properties", "values": news}] if news else [])]:
                    await self._send(heard)
            except (ConnectionClosed, TimeoutError):
                self._connection.transport.abort()
                return
            await asyncio.sleep(INTERVAL_S)

    async def _send(self, heard: Answer) -> None:
        async with asyncio.timeout(PATIENCE_S):
            await self._connection.send(encode(heard).decode())

    async def _answer(self, message: str | bytes) -> Answer:
        try:
            request: Any = json.loads(message)
            number = request.get("request_id", 0)
            name, *arguments = request["command"]
        except (ValueError, RecursionError, AttributeError, KeyError, TypeError):
            return _refused(0, 'expected {"command": [NAME, ...], "request_id": N}')
        number = number if isinstance(number, int) else 0
        if name not in REQUESTS and not (isinstance(name, str) and name in self._link.commands):
            return _refused(number, f"{str(name)[:80]}: no such command; get_property command-list names them")
        if name == "preview" and len(arguments) == 2 and isinstance(arguments[0], str):
            answer = await self._pictures.take(*arguments)
        else:
            answer = await self._link.ask(name, *arguments)
        return answer | {"request_id": number}


class Pace:
    """Limits the rate of requests: `a_second` per second, and at most `at_once` in a burst."""

    def __init__(self, a_second: float, at_once: float) -> None:
        self._a_second, self._at_once = a_second, at_once
        self._left, self._looked = at_once, time.monotonic()

    def wait_s(self) -> float:
        """Count a request, and return the seconds to wait before it."""
        now = time.monotonic()
        self._left = min(self._left + (now - self._looked) * self._a_second, self._at_once) - 1
        self._looked = now
        return max(-self._left / self._a_second, 0.0)


def _refused(number: int, message: str) -> Answer:
    return {"request_id": number, "error": "invalid parameter", "message": message}
