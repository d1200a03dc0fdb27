"""Linear timecode: waves of the standard's, worn as cables and tapes wear them, and a show that goes where they say."""

from fractions import Fraction

import numpy as np
import pytest

from counterlight.show.chase import Chase
from counterlight.show.in_step import Follower
from counterlight.unattended.timecode import RATES, Passed, Timecode, TimecodeReader, nearest_rate, parse_timecode
from tests.programs import fail
from tests.stage import Reader, Stage
from tests.timecode import labels, wave

RATE = 48000
FILM, NTSC = Fraction(24000, 1001), Fraction(30000, 1001)


def read(samples: np.ndarray, samples_a_second: float = RATE, block: int = 512) -> list[Passed]:
    reader = TimecodeReader(samples_a_second)
    return [each for at in range(0, len(samples), block) for each in reader.feed(samples[at : at + block])]


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("samples_a_second", [44100, 48000, 96000])
def test_labels_and_where_they_end(rate: Fraction, samples_a_second: int) -> None:
    codes = labels(Timecode(23, 59, 58, 20), 3 * round(rate), round(rate))  # over midnight
    found = read(wave([*codes, *codes[:1]], float(rate), samples_a_second), samples_a_second)
    assert [each.code for each in found] == codes[1:]  # the first has nobody to vouch for it
    length = samples_a_second / float(rate)
    ends = [each.end for each in found]
    np.testing.assert_allclose(ends, length * np.arange(2, len(codes) + 1), atol=1.0)
    assert found[0].samples is None
    assert found[-1].samples is not None
    assert nearest_rate(samples_a_second / found[-1].samples, drop=False) == rate


@pytest.mark.parametrize("block", [1, 37, 480, 100_000])
def test_drop_frame_and_any_block(block: int) -> None:
    codes = labels(Timecode(0, 9, 59, 28, drop=True), 4, 30) + labels(Timecode(0, 10, 59, 27, drop=True), 45, 30)
    assert str(codes[6]) == "00:10:59;29"
    assert str(codes[7]) == "00:11:00;02"
    assert str(codes[2]) == "00:10:00;00"
    found = read(wave([*codes, *codes[:1]], float(NTSC), RATE), RATE, block)
    assert [each.code for each in found] == codes[1:4] + codes[5:]  # one vouches for the next, behind the jump too


@pytest.mark.parametrize("speed", [0.5, 0.8, 1.0, 1.25, 2.0])
@pytest.mark.parametrize("level", [0.003, 0.9])
def test_worn_waves(rng: np.random.Generator, speed: float, level: float) -> None:
    """Upside down, rounded by a cable, off the middle, with a hum and noise 25 dB below, at any speed and level."""
    codes = labels(Timecode(1, 2, 3, 4), 50, 25)
    clean = -wave([*codes, *codes[:1]], 25 * speed, RATE)
    worn = (
        np.convolve(clean, np.ones(4) / 4, "same") + 0.3 + 0.1 * np.sin(2 * np.pi * 50 / RATE * np.arange(len(clean)))
    )
    found = [each.code for each in read(level * (worn + 0.05 * rng.normal(size=len(clean))))]
    assert found == codes[-len(found) :]
    assert len(found) >= len(codes) - 3  # the level has to be found first


def test_what_is_no_timecode_says_nothing(rng: np.random.Generator) -> None:
    noise, tone = rng.normal(size=5 * RATE), np.sin(2 * np.pi * 2000 / RATE * np.arange(RATE))
    backwards = wave(labels(Timecode(0, 0, 0, 0), 25, 25), 25, RATE)[::-1]
    for samples in (np.zeros(RATE), noise, 0.1 * noise, tone, np.full(RATE, np.nan), backwards):
        assert read(samples) == []


def test_damage_makes_no_time_jump(rng: np.random.Generator) -> None:
    """Holes and clicks: what is still told is true, and it is found again within two frames."""
    codes = labels(Timecode(10, 0, 0, 0), 250, 25)
    clean = wave([*codes, *codes[:1]], 25, RATE)
    length = RATE // 25
    for at in rng.integers(0, len(clean) - 200, 40):
        clean[at : at + 200] = rng.choice([0.0, 1.0, -1.0]) * rng.normal(1, 0.1)
    found = read(clean)
    assert len(found) > 130
    for each in found:
        assert each.code == codes[round(each.end / length) - 1]
        assert each.samples is None or each.samples == pytest.approx(length, rel=1e-3)


def test_seconds() -> None:
    """Of one hour: exactly 3600 s at whole rates, 3.6 s more without dropping labels at 29.97, 3.6 ms less with."""
    hour = Timecode(1, 0, 0, 0)
    assert hour.seconds_at(Fraction(25)) == 3600
    assert hour.seconds_at(NTSC) == pytest.approx(3603.6)
    assert hour.seconds_at(FILM) == pytest.approx(3603.6)
    assert Timecode(1, 0, 0, 0, drop=True).seconds_at(NTSC) == pytest.approx(3599.9964)


@pytest.mark.parametrize(
    "text", ["1:00:00", "24:00:00", "00:60:00:00", "00:00:00:30", "00:01:00;00", "", "00:00", "٠٠:00:00"]
)
def test_what_is_no_timecode_in_words(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - what argparse asks of a type
        parse_timecode(text)


def test_timecode_in_words() -> None:
    assert parse_timecode("10:00:00") == Timecode(10, 0, 0, 0)
    assert str(parse_timecode("01:02:03;04")) == "01:02:03;04"


class Tape:
    """Timecode at a stage's sound input, block by block, as the stage's time goes on."""

    BLOCK_S = 0.02

    def __init__(self, stage: Stage, start: Timecode) -> None:
        self.stage = stage
        self.chase = Chase(RATE, start, lambda: len(stage.session.playlist.media), stage.clock)
        self._poll = Follower(stage.session, self.chase).poll

    def play(self, first: Timecode | None, seconds: float, a_second: int = 25, rate: float = 25.0) -> None:
        """From a label on; None for silence."""
        count = round(seconds * rate)
        samples = np.zeros(round(seconds * RATE)) if first is None else wave(labels(first, count, a_second), rate, RATE)
        for at in range(0, len(samples), int(RATE * self.BLOCK_S)):
            block = samples[at : at + int(RATE * self.BLOCK_S)]
            self.stage.advance(len(block) / RATE)
            self.chase.take(block, self.stage.clock.now - len(block) / RATE)
            self._poll()

    @property
    def now_s(self) -> float:
        playback = self.stage.session.playback
        assert playback is not None
        return playback.position_s if playback.now_s is None else playback.now_s


@pytest.mark.parametrize(("a_second", "rate"), [(25, 25.0), (30, float(NTSC))])
def test_a_show_goes_where_the_tape_is(a_second: int, rate: float) -> None:
    tape = Tape(Stage(Reader(count=3000)), Timecode(10, 0, 0, 0))
    tape.play(None, 1.0)
    assert tape.stage.session.playback is not None
    assert tape.stage.session.playback.paused  # on its first frame
    tape.play(Timecode(10, 0, 8, 0), 6.0, a_second, rate)
    assert not tape.stage.session.playback.paused
    assert tape.now_s == pytest.approx((14 * a_second - (0 if rate == 25 else 0.18)) / rate, abs=0.06)
    tape.play(None, 3.0)  # the tape stops: so does the show, where it was
    assert tape.stage.session.playback.paused
    assert tape.now_s == pytest.approx(14.0, abs=0.6)
    tape.play(Timecode(10, 1, 0, 0), 6.0, a_second, rate)
    assert tape.now_s == pytest.approx(66.0 * a_second / rate, abs=0.1)
    tape.play(Timecode(9, 0, 0, 0), 3.0, a_second, rate)  # before the show
    assert tape.stage.session.playback.paused
    assert tape.now_s == 0


def test_media_of_a_list_begin_on_the_hour() -> None:
    tape = Tape(Stage(*(Reader(name, count=500) for name in "abc")), Timecode(1, 0, 0, 0))
    tape.play(Timecode(3, 0, 2, 0), 8.0)
    assert tape.stage.session.programme.on == 2
    assert tape.now_s == pytest.approx(10.0, abs=0.06)


def test_wrong_use_is_said_in_a_line() -> None:
    assert "expected HH:MM:SS or HH:MM:SS:FF, found '25:00:00'" in fail(
        "play", "room", "film.mp4", "--timecode-start", "25:00:00"
    )
