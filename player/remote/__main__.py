"""The process that serves a show's remotes: `python -m counterlight.remote`, started only by the player.

Its standard input holds one line of JSON. `link` is the file descriptor of its connection to the show. `web`, a
listening TCP socket with its `token`, and `osc`, a UDP socket, are optional. The process ends with the show.
"""

import asyncio
import json
import logging
import signal
import socket
import sys
from contextlib import AsyncExitStack
from typing import Any

from counterlight.remote.link import Link

GOODBYE_S = 0.25  # time to deliver the show's last messages


async def serve(services: dict[str, Any]) -> None:
    """Serve the remotes until the show closes the connection.

    services : the JSON object of standard input.
    """
    link = Link(_inherited(services["link"]))
    talking, serving = asyncio.create_task(link.run()), asyncio.create_task(_serve_others(link, services))
    await asyncio.wait([talking, serving], return_when=asyncio.FIRST_COMPLETED)
    if talking.done():
        await asyncio.sleep(GOODBYE_S)
        serving.cancel()
    await asyncio.gather(talking, serving, return_exceptions=talking.done())


async def _serve_others(link: Link, services: dict[str, Any]) -> None:
    await link.learn()
    async with AsyncExitStack() as stack:
        if "web" in services:
            from counterlight.remote.web import Web

            web = Web(_inherited(services["web"]), services["token"], link)
            link.hear = web.hear
            await stack.enter_async_context(await web.begin())
        if "osc" in services:
            from counterlight.remote.osc import Osc

            osc = Osc(link)
            receiver, loop = _inherited(services["osc"]), asyncio.get_running_loop()
            transport, _ = await loop.create_datagram_endpoint(lambda: osc, sock=receiver)
            stack.callback(transport.close)
            await osc.run()
        await asyncio.Event().wait()


def _inherited(descriptor: int) -> socket.socket:
    inherited = socket.socket(fileno=descriptor)
    inherited.setblocking(False)
    return inherited


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the show handles Ctrl-C and then closes the connection
    logging.disable()  # the packages log every bad request, which does not belong in the show's log
    asyncio.run(serve(json.loads(sys.stdin.readline())))


if __name__ == "__main__":
    main()
