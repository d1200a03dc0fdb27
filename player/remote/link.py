"""The connection to the show: requests with their answers, and property values while a client watches.

All remotes share one connection, so that twenty browsers cost the show as much as one browser.
"""

import asyncio
import itertools
import json
import socket
from collections.abc import Callable, Mapping
from typing import Any

from counterlight.unattended.json_lines import encode

PATIENCE_S = 30.0  # limit for a show that is stopped or reads its maps
LONGEST_LINE = 64 << 20  # in bytes; a list of a hundred thousand media takes 8 MiB
AGAIN_S = 0.1
_OBSERVED = 1  # number that all observations share

Answer = dict[str, Any]


class Link:
    """The connection to the show.

    hear : called with each event of the show.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self.hear: Callable[[Answer], None] = lambda received: None
        self._connected, self._over = asyncio.Event(), False
        self._numbers = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[Answer]] = {}
        self.properties: Mapping[str, Answer] = {}  # description of each property, by name
        self.commands: Mapping[str, Answer] = {}
        self.values: dict[str, object] = {}  # latest values while the properties are observed

    async def run(self) -> None:
        """Receive until the show closes the connection."""
        reader, self._writer = await asyncio.open_unix_connection(sock=self._connection, limit=LONGEST_LINE)
        self._connected.set()
        try:
            while line := await reader.readline():
                self._take(json.loads(line))
        finally:
            self._writer.close()
            self._over = True
            for answer in self._waiting.values():
                if not answer.done():
                    answer.set_result(_unanswered("the show has gone"))

    async def learn(self) -> None:
        """Ask for the lists of commands and properties. A show that is still reading its room answers later."""
        self.commands = {each["name"]: each for each in await self._insist("get_property", "command-list")}
        self.properties = {each["name"]: each for each in await self._insist("get_property", "property-info")}

    async def ask(self, *words: object) -> Answer:
        """Send a request to the control socket, and return its answer."""
        await self._connected.wait()
        if self._over:
            return _unanswered("the show has gone")
        number, answer = next(self._numbers), asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        try:
            self._writer.write(encode({"command": words, "request_id": number}))
            async with asyncio.timeout(PATIENCE_S):
                await self._writer.drain()
                received: Answer = await answer
                return received
        except TimeoutError:
            return _unanswered(f"the show has not answered for {PATIENCE_S:.0f} s")
        finally:
            del self._waiting[number]

    async def observe(self) -> None:
        """Observe every property that the show can read without cost."""
        for name, info in self.properties.items():
            if not info["costly"]:
                await self.ask("observe_property", _OBSERVED, name)

    async def look_away(self) -> None:
        await self.ask("unobserve_property", _OBSERVED)
        self.values.clear()

    async def _insist(self, *words: object) -> list[Answer]:
        """Repeat a request until it succeeds, and return its data."""
        while (answer := await self.ask(*words))["error"] != "success":
            await asyncio.sleep(AGAIN_S)
        found: list[Answer] = answer["data"]
        return found

    def _take(self, received: Answer) -> None:
        if "event" in received:
            if received["event"] == "property-change":
                self.values[received["name"]] = received["data"]
            self.hear(received)
            return
        answer = self._waiting.get(received.get("request_id", 0))
        if answer is not None and not answer.done():
            answer.set_result(received)


def _unanswered(why: str) -> Answer:
    return {"error": "error running command", "message": why, "data": None}
