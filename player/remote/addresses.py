"""Decides who may connect: parses HOST:PORT, opens sockets, refuses foreign pages, keeps the browser's token.

A foreign page in a browser can reach every address that the browser's machine can reach: by a form, a WebSocket, or a
host name whose owner redirects it after the page has loaded (DNS rebinding). Therefore a request must name this machine
by an IP address or another name of it, and a WebSocket must come from this page.
"""

import argparse
import ipaddress
import os
import re
import secrets
import socket
import stat
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from counterlight.errors import InputError

LOOPBACK, PAGE_PORT = "127.0.0.1", 8642  # the usual address of the page
BACKLOG = 64
_DOCUMENTATION = "192.0.2.1", 9  # an unused address; nothing is sent, only the route is looked up


@dataclass(frozen=True)
class Address:
    """A host and a port.

    host : a name, or an IP address as `ipaddress` accepts it.
    """

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def listen(self, option: str) -> socket.socket:
        """Return a TCP socket that listens here. Raises InputError if the system refuses."""
        listener = self._bound(option, socket.SOCK_STREAM)
        listener.listen(BACKLOG)
        return listener

    def receive(self, option: str) -> socket.socket:
        """Return a UDP socket bound here. Raises InputError if the system refuses."""
        return self._bound(option, socket.SOCK_DGRAM)

    def _bound(self, option: str, kind: socket.SocketKind) -> socket.socket:
        try:
            family, _, _, _, place = socket.getaddrinfo(self.host, self.port, type=kind, flags=socket.AI_PASSIVE)[0]
            bound = socket.socket(family, kind)
        except OSError as error:
            raise InputError(f"{option} {self}: {error.strerror}; name an address of this machine") from None
        try:
            if kind == socket.SOCK_STREAM:  # a restarted player need not wait until old connections end
                bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.bind(place)
        except OSError as error:
            bound.close()
            reason = os.strerror(error.errno) if error.errno else str(error)
            raise InputError(f"{option} {self}: {reason}; give another port, or an address of this machine") from None
        bound.setblocking(False)
        return bound


def parse_address(text: str, port: int | None = None) -> Address:
    """Parse `HOST:PORT`, `PORT` or, with a default port, `HOST`. Without a host, only this machine can connect.

    Raises ArgumentTypeError for other text.
    """
    host, colon, number = text.rpartition(":")
    if not colon and text.isdecimal():
        host, number = "", text
    elif port is not None and (not colon or text.endswith("]") or (text.count(":") > 1 and not text.startswith("["))):
        host, number = text, str(port)
    host = host.removeprefix("[").removesuffix("]") or LOOPBACK
    if not (text and number.isdecimal() and len(number) <= 5 and 0 < int(number) < 1 << 16) or not _could_be_host(host):
        expected = "HOST:PORT" if port is None else "HOST, PORT or HOST:PORT"
        raise argparse.ArgumentTypeError(
            f"expected {'[HOST:]PORT' if port is None else expected}, such as 0.0.0.0:8642, found {text!r}"
        )
    return Address(host, int(number))


def is_loopback(bound: socket.socket) -> bool:
    """Whether only this machine can reach a socket."""
    return ipaddress.ip_address(bound.getsockname()[0].partition("%")[0]).is_loopback


def reachable(bound: socket.socket) -> Address:
    """Return the address for other machines: the socket's address, or this machine's if it listens on all addresses."""
    host, port = bound.getsockname()[:2]
    if ipaddress.ip_address(host.partition("%")[0]).is_unspecified:
        host = _own_address() or socket.gethostname()
    return Address(host, port)


def names_this_machine(host: str, *, local: bool) -> bool:
    """Whether the Host header of a request is an IP address, or a name that no other machine can redirect.

    local : whether only loopback addresses and `localhost` are accepted.
    """
    name = host.rpartition(":")[0] if host.rpartition(":")[2].isdecimal() and not host.endswith("]") else host
    name = name.removeprefix("[").removesuffix("]").rstrip(".").lower()
    try:
        number = ipaddress.ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        return name == "localhost" or (not local and name in (own, f"{own}.local"))
    return number.is_loopback or not local


def comes_from(origin: str, host: str) -> bool:
    """Whether the page of a request's Origin header was loaded from `host`."""
    return origin in (f"http://{host}", f"https://{host}")


def _own_address() -> str | None:
    """Return this machine's address on its default route, None without a route."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(_DOCUMENTATION)
        except OSError:
            return None
        return str(probe.getsockname()[0])


def _could_be_host(host: str) -> bool:
    return all(character.isalnum() or character in ".-:%_" for character in host)


BYTES = 16  # random bytes of a token, too many to guess
LONGEST = 1000  # most bytes read from the token's file
_WORD = re.compile(r"[\w-]{20,200}", re.ASCII)


def default_path(environment: Mapping[str, str], home: Path) -> Path:
    """Return the path of the token by the XDG Base Directory Specification."""
    return Path(environment.get("XDG_STATE_HOME") or home / ".local" / "state") / "counterlight" / "remote-token"


def token_at(path: Path) -> str:
    """Return the token stored at `path`. Creates it if there is none.

    Raises InputError if another user could have read or written the file.
    """
    try:
        try:
            return _read(path)
        except FileNotFoundError:
            _make(path)
            return _read(path)
    except OSError as error:
        raise InputError(
            f"{path}: the remote's token cannot be kept here ({error.strerror}); set XDG_STATE_HOME to your own folder"
        ) from None


def _make(path: Path) -> None:
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    unborn = path.with_name(f".{path.name}.{os.getpid():x}")
    descriptor = os.open(unborn, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        with os.fdopen(descriptor, "w") as file:
            file.write(secrets.token_urlsafe(BYTES))
        with suppress(FileExistsError):  # another player has just created it
            os.link(unborn, path)  # unlike a rename, a link never replaces another file
    finally:
        unborn.unlink()


def _read(path: Path) -> str:
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode) or status.st_uid != os.geteuid() or status.st_mode & 0o077:
            raise InputError(f"{path}: not a file that only this user can read; remove it, and a new token is made")
        word = os.read(descriptor, LONGEST).decode(errors="replace").strip()
    finally:
        os.close(descriptor)
    if not _WORD.fullmatch(word):
        raise InputError(f"{path}: holds no token; remove it, and a new one is made")
    return word
