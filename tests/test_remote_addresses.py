"""The address of a remote, the names that may reach it, and the token."""

import argparse
import os
import socket
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.remote.addresses import (
    Address,
    comes_from,
    default_path,
    is_loopback,
    names_this_machine,
    parse_address,
    reachable,
    token_at,
)
from counterlight.show.remotes import qr_code

PORT = 8642


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("9000", "127.0.0.1", 9000),
        (":9000", "127.0.0.1", 9000),
        ("0.0.0.0", "0.0.0.0", PORT),
        ("0.0.0.0:9000", "0.0.0.0", 9000),
        ("stage-left.local:1", "stage-left.local", 1),
        ("::1", "::1", PORT),
        ("[::1]", "::1", PORT),
        ("[::]:65535", "::", 65535),
    ],
)
def test_what_an_address_may_be(text: str, host: str, port: int) -> None:
    assert parse_address(text, PORT) == Address(host, port)


@pytest.mark.parametrize(
    "text", ["", ":", "0", "65536", "localhost:", "a b:9000", "room/film.mp4", "99999999999", "1:-2"]
)
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=r"expected HOST, PORT or HOST:PORT, such as .* found"):
        parse_address(text, PORT)


def test_without_a_usual_port_one_must_be_said() -> None:
    assert parse_address("9001") == Address("127.0.0.1", 9001)
    with pytest.raises(argparse.ArgumentTypeError, match=r"expected \[HOST:\]PORT"):
        parse_address("localhost")


def test_a_port_that_is_taken_and_a_host_that_is_elsewhere_are_said() -> None:
    with Address("127.0.0.1", 0).listen("--remote") as first:
        assert is_loopback(first)
        taken = Address("127.0.0.1", first.getsockname()[1])
        with pytest.raises(
            InputError, match=rf"--remote 127\.0\.0\.1:{taken.port}: Address already in use; give another"
        ):
            taken.listen("--remote")
    with pytest.raises(InputError, match=r"--osc 192\.0\.2\.7:9000: .*; give another port, or an address of this"):
        Address("192.0.2.7", 9000).receive("--osc")
    with pytest.raises(InputError, match=r"--remote no\.such\.invalid:9000: .*; name an address of this machine"):
        Address("no.such.invalid", 9000).listen("--remote")


def test_all_addresses_are_reported_as_one_that_others_can_use() -> None:
    with Address("0.0.0.0", 0).listen("--remote") as everywhere:
        assert not is_loopback(everywhere)
        address = reachable(everywhere)
        assert address.port == everywhere.getsockname()[1]
        assert address.host not in ("0.0.0.0", "::", "")


@pytest.mark.parametrize(
    ("host", "here", "network"),
    [
        ("127.0.0.1:8642", True, True),
        ("localhost", True, True),
        ("LOCALHOST.:80", True, True),
        ("[::1]:8642", True, True),
        ("192.168.1.20:8642", False, True),
        ("[fe80::1]", False, True),
        (f"{socket.gethostname()}:8642", False, True),
        (f"{socket.gethostname()}.local", False, True),
        ("evil.example:8642", False, False),
        ("127.0.0.1.evil.example", False, False),
        ("localhost.evil.example:8642", False, False),
        ("127.0.0.1, evil.example", False, False),
        ("", False, False),
        ("[::1", False, False),
    ],
)
def test_only_numbers_and_own_names_name_this_machine(host: str, here: bool, network: bool) -> None:
    """A foreign host name can be pointed at this machine after its page was loaded."""
    assert names_this_machine(host, local=True) == here
    assert names_this_machine(host, local=False) == network


def test_only_this_page_may_open_a_socket() -> None:
    assert comes_from("http://127.0.0.1:8642", "127.0.0.1:8642")
    assert comes_from("https://stage.local", "stage.local")  # the page was loaded through an encrypting proxy
    for origin in ("null", "", "http://evil.example", "http://127.0.0.1", "http://127.0.0.1:8642.evil.example"):
        assert not comes_from(origin, "127.0.0.1:8642")


def test_a_phone_reads_the_address_from_a_terminal() -> None:
    address = "http://192.168.1.20:8642/#72kc9HcH86deJ3sKzLmN3A"
    halves = {" ": (0, 0), "▀": (1, 0), "▄": (0, 1), "█": (1, 1)}  # light blocks on a dark terminal
    lines = [np.array([halves[each] for each in line]).T for line in qr_code(address)]
    picture = np.kron(np.concatenate(lines), np.ones((6, 6))).astype(np.uint8) * 255
    assert cv2.QRCodeDetector().detectAndDecode(np.pad(picture, 24, constant_values=255))[0] == address


def test_a_token_is_made_once_and_nobody_else_can_read_it(tmp_path: Path) -> None:
    path = tmp_path / "state" / "counterlight" / "remote-token"
    token = token_at(path)
    assert len(token) >= 22  # the token has 128 bits in base64
    assert token_at(path) == token
    assert path.stat().st_mode & 0o777 == 0o600
    assert sorted(path.parent.iterdir()) == [path]
    path.unlink()
    assert token_at(path) != token
    assert default_path({"XDG_STATE_HOME": "/s"}, Path("/h")) == Path("/s/counterlight/remote-token")
    assert default_path({}, Path("/h")) == Path("/h/.local/state/counterlight/remote-token")


@pytest.mark.parametrize("trap", ["readable", "short", "empty", "binary", "pipe", "folder"])
def test_a_token_that_others_could_know_or_that_is_none_is_refused(tmp_path: Path, trap: str) -> None:
    path = tmp_path / "remote-token"
    if trap == "pipe":
        os.mkfifo(path)
    elif trap == "folder":
        path.mkdir()
    else:
        path.write_bytes({"readable": b"x" * 22, "short": b"x", "empty": b"", "binary": b"\0\xff" * 20}[trap])
        path.chmod(0o644 if trap == "readable" else 0o600)
    with pytest.raises(InputError, match=r"remote-token: .*remove it, and a new"):
        token_at(path)


def test_a_token_is_not_read_through_a_link_and_not_made_where_nothing_can_be(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_text("x" * 22)
    (tmp_path / "remote-token").symlink_to("elsewhere")
    for path in (tmp_path / "remote-token", tmp_path / "elsewhere" / "remote-token"):
        with pytest.raises(InputError, match=r"cannot be kept here .*; set XDG_STATE_HOME"):
            token_at(path)
