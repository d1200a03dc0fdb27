"""The control socket replaces a dead player's socket, never a living player's."""

import errno
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from counterlight.errors import InputError
from counterlight.show.control import ControlServer
from tests.programs import ROOT
from tests.test_control import Client, Lamp


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ControlServer]:
    with closing(ControlServer(tmp_path / "socket")) as server:
        yield server


def test_only_this_user_may_connect(server: ControlServer, tmp_path: Path) -> None:
    assert stat.S_IMODE((tmp_path / "socket").stat().st_mode) == 0o600


def test_a_live_socket_is_refused_and_a_stale_one_replaced(server: ControlServer, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"socket: another player is listening here; end it, or give --control"):
        ControlServer(tmp_path / "socket")
    stale = tmp_path / "stale"
    listen = "import os, pathlib\nfrom counterlight.show.control import ControlServer"
    code = f"{listen}\nControlServer(pathlib.Path({str(stale)!r}))\nos._exit(9)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 9
    assert stale.is_socket()
    second, lamp = ControlServer(stale), Lamp()
    client = Client(stale, lambda: second.poll(lamp))
    assert client.ask("client_name")["data"] == "ipc-1"
    client.socket.close()
    stale.unlink()
    third = ControlServer(stale)
    second.close()
    assert stale.is_socket()  # the path now belongs to the third server
    third.close()
    assert not stale.exists()


def test_a_socket_that_is_there_listens(tmp_path: Path) -> None:
    """A client that connects as soon as the socket file exists is never refused."""
    path, stop, refused = tmp_path / "socket", threading.Event(), []

    def connect() -> None:
        while not stop.is_set():
            if path.exists():
                with socket.socket(socket.AF_UNIX) as client:
                    client.setblocking(False)
                    code = client.connect_ex(str(path))
                    refused.extend([code] * (code == errno.ECONNREFUSED and path.exists()))

    thread = threading.Thread(target=connect)
    thread.start()
    servers = []
    for _ in range(100):
        servers.append(ControlServer(path))
        time.sleep(0.001)
        path.unlink()  # the path is removed before the socket is closed, because a closed socket refuses
    stop.set()
    thread.join()
    for server in servers:
        server.close()
    assert refused == []
    assert list(tmp_path.iterdir()) == []


def test_what_a_player_leaves_that_is_killed_before_it_listens_is_removed(tmp_path: Path) -> None:
    """Only a dead process's socket is removed: process 1 is alive, and a plain file is not a socket."""
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    names = [f".{dead.pid:x}.new", ".1.new"]
    for name in names:
        with socket.socket(socket.AF_UNIX) as unborn:
            unborn.bind(str(tmp_path / name))
    (tmp_path / ".2.new").write_text("precious")
    server = ControlServer(tmp_path / "socket")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".1.new", ".2.new", "socket"]
    server.close()


def test_places_where_no_socket_can_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("precious")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    for path, reason in (
        (tmp_path / "file", "not a socket"),
        (tmp_path / "link", "not a socket"),
        (tmp_path / "no" / "socket", "no control socket can be made here"),
        (tmp_path / ("long" * 40), "no control socket can be made here"),
        (Path("/proc/socket"), "no control socket can be made here"),
    ):
        with pytest.raises(InputError, match=reason) as refusal:
            ControlServer(path)
        assert "\n" not in str(refusal.value)
    assert (tmp_path / "file").read_text() == "precious"
