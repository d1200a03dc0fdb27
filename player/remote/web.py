"""The page and its WebSocket: one port, four paths, and a token that every WebSocket needs.

The page contains no secret. The token follows the # of the page's address, which browsers do not send. The WebSocket
carries the token as a proposed subprotocol.
"""

import asyncio
import hmac
import http
import socket
from importlib.resources import files

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from counterlight.command import tell
from counterlight.remote.addresses import comes_from, is_loopback, names_this_machine
from counterlight.remote.link import Answer, Link
from counterlight.remote.visitor import PATIENCE_S, Pictures, Visitor

PROTOCOL = Subprotocol("counterlight")
MOST_VISITORS = 32
LONGEST_MESSAGE = 8 << 10  # most bytes of a request; as ASCII JSON, it still fits the show's limit for a line
HANDSHAKE_S = 5.0
SOCKET = "/socket"
PAGE = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/remote.css": ("remote.css", "text/css; charset=utf-8"),
    "/remote.js": ("remote.js", "text/javascript; charset=utf-8"),
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; "
    "connect-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Web:
    """Serves browsers at a listening socket."""

    def __init__(self, listener: socket.socket, token: str, link: Link) -> None:
        self._listener, self._token, self._link = listener, token.encode(), link
        self._local = is_loopback(listener)
        self._pictures = Pictures(link)
        self._visitors: set[Visitor] = set()
        self._watching, self._observed = asyncio.Lock(), False
        self._pages = {
            path: (files("counterlight.remote.page") / name).read_bytes() for path, (name, _) in PAGE.items()
        }

    async def begin(self) -> Server:
        return await serve(
            self._serve,
            sock=self._listener,
            process_request=self._look,
            subprotocols=[PROTOCOL],
            compression=None,
            open_timeout=HANDSHAKE_S,
            ping_timeout=PATIENCE_S,
            close_timeout=1,
            max_size=LONGEST_MESSAGE,
            max_queue=4,
            server_header=None,
        )

    def hear(self, heard: Answer) -> None:
        """Pass an event of the show on to all browsers."""
        for visitor in self._visitors:
            visitor.hear(heard)

    async def _serve(self, connection: ServerConnection) -> None:
        visitor = Visitor(connection, self._link, self._pictures)
        self._visitors.add(visitor)
        try:
            await self._watch()
            await visitor.serve()
        except Exception as error:  # an internal error affects only this visitor
            tell(f"remote: a visitor was sent away: {error!r}")
        finally:
            self._visitors.discard(visitor)
            await self._watch()

    async def _watch(self) -> None:
        """Observe the show's properties as long as a browser is connected."""
        async with self._watching:
            wanted = bool(self._visitors)
            if wanted != self._observed:
                self._observed = wanted
                await (self._link.observe() if wanted else self._link.look_away())

    def _look(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to a request, None to accept a WebSocket."""
        host, path = ",".join(request.headers.get_all("Host")), request.path.partition("?")[0]
        if not names_this_machine(host, local=self._local):
            return _refusal(http.HTTPStatus.MISDIRECTED_REQUEST, "name this machine by its number, or by its own name")
        if path in PAGE:
            headers = Headers({"Content-Type": PAGE[path][1], **HEADERS})
            headers["Content-Length"] = str(len(self._pages[path]))
            return Response(200, "OK", headers, self._pages[path])
        if path != SOCKET:
            return _refusal(http.HTTPStatus.NOT_FOUND, "nothing is here")
        return self._refuse(request, host)

    def _refuse(self, request: Request, host: str) -> Response | None:
        """Return why a WebSocket is refused, None if it is accepted."""
        if not all(comes_from(origin, host) for origin in request.headers.get_all("Origin")):
            return _refusal(http.HTTPStatus.FORBIDDEN, "another site's page")
        proposed = ",".join(request.headers.get_all("Sec-WebSocket-Protocol")).split(",")
        if not any(hmac.compare_digest(self._token, word.strip().encode()) for word in proposed):
            return _refusal(http.HTTPStatus.UNAUTHORIZED, "not the token")
        if len(self._visitors) >= MOST_VISITORS:
            return _refusal(http.HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_VISITORS} are here already")
        return None


def _refusal(status: http.HTTPStatus, why: str) -> Response:
    body = f"{why}\n".encode()
    headers = Headers({"Content-Type": "text/plain", "Content-Length": str(len(body)), **HEADERS})
    return Response(status.value, status.phrase, headers, body)
