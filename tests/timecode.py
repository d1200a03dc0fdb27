"""Linear timecode as SMPTE ST 12-1 has it: labels -> a wave."""

from collections.abc import Iterable

import numpy as np

from counterlight.unattended.timecode import Timecode

SYNC = (0, 0, *[1] * 12, 0, 1)


def labels(first: Timecode, count: int, a_second: int) -> list[Timecode]:
    """The first and those behind it, one by one, as a clock counts."""
    h, m, s, f = first.hours, first.minutes, first.seconds, first.frames
    found = []
    for _ in range(count):
        found.append(Timecode(h, m, s, f, first.drop))
        f += 1
        s, f = (s + 1, 0) if f == a_second else (s, f)
        m, s = (m + 1, 0) if s == 60 else (m, s)
        h, m = ((h + 1) % 24, 0) if m == 60 else (h, m)
        if first.drop and (s, f) == (0, 0) and m % 10:
            f = 2
    return found


def wave(codes: Iterable[Timecode], frames_a_second: float, samples_a_second: float) -> np.ndarray:
    """±1."""
    bits = np.concatenate([_bits(code) for code in codes])
    length = samples_a_second / (80 * frames_a_second)
    begins = np.arange(len(bits)) * length
    changes = np.sort(np.concatenate([begins, begins[bits == 1] + length / 2]))
    return np.where(np.searchsorted(changes, np.arange(int(len(bits) * length)), side="right") % 2, 1.0, -1.0)


def _bits(code: Timecode) -> np.ndarray:
    word = np.zeros(80, int)
    for at, count, value in (
        *((0, 4, code.frames % 10), (8, 2, code.frames // 10), (16, 4, code.seconds % 10), (24, 3, code.seconds // 10)),
        *((32, 4, code.minutes % 10), (40, 3, code.minutes // 10), (48, 4, code.hours % 10), (56, 2, code.hours // 10)),
        (10, 1, int(code.drop)),
    ):
        word[at : at + count] = [value >> bit & 1 for bit in range(count)]
    word[64:] = SYNC
    return word
