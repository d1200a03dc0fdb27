"""OSC: a fader's number sets a property, answers are encoded, and no packet does harm."""

import numpy as np
import pytest
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from counterlight.remote.osc import LONGEST_TEXT, UnreadError, messages_of, reply, share_of, value_of
from tests.stage import Stage

INFO = {name: Stage().commands.info(name) for name in Stage().commands.properties()}


@pytest.mark.parametrize(
    ("name", "argument", "value"),
    [
        ("brightness", 12, 12),
        ("brightness", 12.4, 12),  # a fader's number for an integer property
        ("black-level", float(np.float32(0.1)), 0.1),  # OSC sends 32-bit floats
        ("pause", 1.0, True),
        ("pause", 0, False),
        ("pause", 127, True),  # a MIDI button
        ("pause", True, True),
        ("pause", "no", "no"),
        ("view", "camera", "camera"),
        ("refine", "auto", "auto"),
        ("brightness", float("nan"), float("nan")),  # the show reports the error
    ],
)
def test_numbers_are_taken_as_a_property_wants_them(name: str, argument: object, value: object) -> None:
    np.testing.assert_equal(value_of(INFO[name], argument), value)


@pytest.mark.parametrize(
    ("name", "share", "value"),
    [
        ("brightness", 0.0, -100),
        ("brightness", 0.5, 0),
        ("brightness", 0.756, 51),
        ("black-level", 0.5, 0.25),
        ("pause", 0.5, True),
        ("pause", 0.49, False),
        ("view", 1.0, "impossible"),
        ("view", 0.0, "projector"),
        ("refine", 1, 256),
    ],
)
def test_a_share_of_what_a_property_can_be(name: str, share: float, value: object) -> None:
    assert share_of(INFO[name], share) == value


@pytest.mark.parametrize(
    ("name", "share", "complaint"),
    [
        ("brightness", 1.5, "a share from 0 to 1, found 1.5"),
        ("brightness", float("nan"), "a share from 0 to 1"),
        ("brightness", "half", "found 'half'"),
        ("brightness", b"\0", "expected numbers, text"),
        ("time-pos", 0.5, "no range"),
        ("corners", 0.5, "no range"),
    ],
)
def test_what_is_no_share(name: str, share: object, complaint: str) -> None:
    with pytest.raises(UnreadError, match=complaint):
        share_of(INFO[name], share)


@pytest.mark.parametrize(
    ("value", "read"),
    [
        (True, [1]),
        (7, [7]),
        (2**40, [float(2**40)]),
        (0.5, [0.5]),
        (None, []),
        ("räum\0.mp4", ["räum.mp4"]),
        ("\udc80", ["?"]),
        ([1, [2]], ["[1, [2]]"]),
        ("ä" * 5000, ["ä" * (LONGEST_TEXT // 2)]),
    ],
)
def test_an_answer_is_one_value_of_a_packet(value: object, read: list[object]) -> None:
    packet = reply("/counterlight/gap", value)
    assert len(packet) < 1400  # below the datagram limit of any network
    message = OscMessage(packet)
    assert (message.address, message.params) == ("/counterlight/gap", read)


def test_random_and_damaged_packets_are_no_messages_or_some(rng: np.random.Generator) -> None:
    builder = OscMessageBuilder("/counterlight/set/brightness")
    builder.add_arg(0.5, "f")
    good = bytes(builder.build().dgram)
    assert [message.params for message in messages_of(good)] == [[0.5]]
    nested = good
    for _ in range(400):  # bundles are nested
        nested = b"#bundle\0" + bytes(7) + b"\1" + len(nested).to_bytes(4, "big") + nested
    assert messages_of(nested) in ([], messages_of(good)) or len(messages_of(nested)) == 1
    for index in range(5000):
        damaged = bytearray(good if index % 2 else b"#bundle\0" + bytes(8) + len(good).to_bytes(4, "big") + good)
        for _ in range(int(rng.integers(1, 4))):
            damaged[rng.integers(len(damaged))] = rng.integers(256)
        for packet in (bytes(damaged), bytes(damaged[: rng.integers(len(damaged))]), rng.bytes(int(rng.integers(64)))):
            for message in messages_of(packet):
                assert isinstance(message.address, str)
