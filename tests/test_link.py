"""The remotes' connection to a show that answers slowly or has gone. A bare socket replaces the show."""

import asyncio
import json
import socket
import time

import pytest

from counterlight.remote import link
from counterlight.remote.link import Answer, Link
from counterlight.remote.visitor import Pictures


class Show:
    """Records the first `late` requests without an answer, and answers all later ones. Has no pictures."""

    def __init__(self, late: int) -> None:
        self.theirs, self._ours = socket.socketpair()
        self._late = late
        self.asked: list[list[str]] = []

    async def run(self) -> None:
        reader, self.writer = await asyncio.open_unix_connection(sock=self._ours)
        while line := await reader.readline():
            request = json.loads(line)
            self.asked.append(request["command"])
            if len(self.asked) > self._late:
                named = [{"name": request["command"][1]}]
                data = None if request["command"][0] == "preview" else named
                answer = {"request_id": request["request_id"], "error": "success", "data": data}
                self.writer.write(json.dumps(answer).encode() + b"\n")


def test_a_show_that_still_reads_its_room_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "PATIENCE_S", 0.05)

    async def body() -> tuple[Show, Link]:
        show = Show(late=2)
        talk = Link(show.theirs)
        tasks = [asyncio.create_task(each.run()) for each in (show, talk)]
        await talk.learn()
        show.writer.close()
        await asyncio.gather(*tasks)
        return show, talk

    show, talk = asyncio.run(body())
    assert list(talk.commands) == ["command-list"]
    assert list(talk.properties) == ["property-info"]
    assert show.asked == [["get_property", "command-list"]] * 3 + [["get_property", "property-info"]]


def test_a_show_is_asked_for_a_picture_at_most_five_times_per_second() -> None:
    async def seconds_for_four_requests() -> float:
        show = Show(late=0)
        talk = Link(show.theirs)
        tasks = [asyncio.create_task(each.run()) for each in (show, talk)]
        pictures, begun_s = Pictures(talk), time.monotonic()
        while len(show.asked) < 4:
            assert (await pictures.take("screen", -1))["data"] is None
            await asyncio.sleep(0.001)
        took_s = time.monotonic() - begun_s
        show.writer.close()
        await asyncio.gather(*tasks)
        return took_s

    assert asyncio.run(seconds_for_four_requests()) >= 3 / 5


def test_a_show_that_goes_leaves_nobody_waiting() -> None:
    async def body() -> tuple[Answer, Answer, Answer]:
        show = Show(late=10)
        talk = Link(show.theirs)
        tasks = [asyncio.create_task(each.run()) for each in (show, talk)]
        asking = [asyncio.create_task(talk.ask("get_property", name)) for name in ("pause", "view")]
        while len(show.asked) < 2:
            await asyncio.sleep(0.01)
        show.writer.close()
        first, second = await asyncio.gather(*asking)
        await asyncio.gather(*tasks)
        return first, second, await talk.ask("quit")

    for answer in asyncio.run(body()):
        assert answer["message"] == "the show has gone"
