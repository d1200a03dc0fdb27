"""Opens the sockets for browser and OSC remotes, and runs the process that serves them (remote/)."""

import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path

from counterlight.command import tell
from counterlight.errors import InputError
from counterlight.remote.addresses import Address, default_path, is_loopback, reachable, token_at
from counterlight.show.control import Clients
from counterlight.show.registry import Commands
from counterlight.unattended.json_lines import encode

ENDING_S = 1.0
REST_S, LONGEST_REST_S = 1.0, 60.0  # first and longest pause before a process that died is started again


class RemoteProcess:
    """The process that serves remotes as a client of the show. The process is started again when it dies.

    services : listening sockets, by their names in the process.
    token : access token of the page.
    """

    def __init__(self, services: Mapping[str, socket.socket], token: str) -> None:
        self._services, self._token = dict(services), token
        self._clients = Clients()
        self._rest_s, self._died_at = REST_S, 0.0
        self._process: subprocess.Popen[bytes] | None = self._start()

    def poll(self, commands: Commands) -> None:
        """Serve the process, and start it again if it has died. Never waits."""
        self._clients.poll(commands)
        if self._process is not None and len(self._clients) == 0:
            self._bury(self._process)
        elif self._process is None and time.monotonic() - self._died_at >= self._rest_s:
            self._rest_s = min(2 * self._rest_s, LONGEST_REST_S)
            self._process = self._start()

    def close(self) -> None:
        """Tell all clients that the show has ended, and end the process."""
        self._clients.close()
        if self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(ENDING_S)
            _end(self._process)
        for service in self._services.values():
            service.close()

    def _start(self) -> subprocess.Popen[bytes] | None:
        """Start the process. Returns None if the system has no resources for it now."""
        ours, theirs = socket.socketpair()
        inherited_fds = {name: service.fileno() for name, service in self._services.items()}
        command = [sys.executable, "-P", "-m", "counterlight.remote"]
        with theirs:
            try:
                inherited = theirs.fileno(), *inherited_fds.values()
                process = subprocess.Popen(command, stdin=subprocess.PIPE, pass_fds=inherited)
            except OSError as error:
                ours.close()
                self._died_at = time.monotonic()
                tell(f"remote: {error}")
                return None
            assert process.stdin is not None
            with suppress(BrokenPipeError), process.stdin:
                process.stdin.write(encode({"link": theirs.fileno(), "token": self._token, **inherited_fds}))
        self._clients.admit(ours)
        return process

    def _bury(self, process: subprocess.Popen[bytes]) -> None:
        _end(process)
        self._process, self._died_at = None, time.monotonic()
        tell(f"remote: its process has ended with {process.returncode}; another one begins in {self._rest_s:.0f} s")


def open_remotes(web: Address | None, osc: Address | None) -> RemoteProcess:
    """Open the sockets of --remote and --osc, at least one of them, and print the addresses.

    Raises InputError if a package is missing or a socket or token cannot be created.
    """
    _need("--remote", web, "websockets", "remote")
    _need("--osc", osc, "pythonosc", "osc")
    token = "" if web is None else token_at(default_path(os.environ, Path.home()))
    with ExitStack() as stack:
        services = {}
        if web is not None:
            services["web"] = stack.enter_context(web.listen("--remote"))
        if osc is not None:
            services["osc"] = stack.enter_context(osc.receive("--osc"))
        process = RemoteProcess(services, token)
        stack.pop_all()
    if web is not None:
        _tell_where(services["web"], token)
    if osc is not None:
        tell(f"OSC: udp://{reachable(services['osc'])}", sys.stdout)
    return process


def _need(option: str, asked: object, package: str, extra: str) -> None:
    if asked is not None and importlib.util.find_spec(package) is None:
        raise InputError(f"{option}: the package {package} is missing; pip install 'counterlight[{extra}]'")


def _tell_where(listener: socket.socket, token: str) -> None:
    address = f"http://{reachable(listener)}/#{token}"
    tell(f"remote: {address}", sys.stdout)
    if sys.stdout.isatty() and not is_loopback(listener):
        for line in qr_code(address):
            tell(line, sys.stdout)


def qr_code(text: str) -> Iterator[str]:
    """Yield the lines of a QR code in half-block characters. Yields none if the package `segno` is missing."""
    with suppress(ImportError):
        import segno

        rows = [[*row] for row in segno.make(text, micro=False).matrix_iter(border=2)]
        for upper, lower in zip(rows[::2], [*rows[1::2], [0] * len(rows)], strict=False):
            yield "".join(" ▀▄█"[(not above) + 2 * (not below)] for above, below in zip(upper, lower, strict=True))


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
