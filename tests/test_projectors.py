"""Projectors on the network, and a show's hours, with a server that follows the PJLink specification."""

import socket
import time
from datetime import date, datetime, timedelta
from pathlib import Path

import pytest

from counterlight.errors import InputError
from counterlight.show.schedule_file import ScheduleFile, read_schedule
from counterlight.unattended import hours, pjlink
from counterlight.unattended.hours import Hours, Keeper, Schedule, days_of
from counterlight.unattended.pjlink import Lamps, Projector, Status, status_of, switch
from tests.pjlink_projector import COOLING, OFF, ON, WARMING, Lamp, projector
from tests.programs import PATIENCE_S, command, fail, succeed

EVERY_DAY = frozenset(range(7))


def of(lamp: Lamp, password: str = "") -> Projector:
    return Projector("127.0.0.1", lamp.port, password)


@pytest.mark.parametrize("password", ["", "JBMIAProjectorLink", "pässword"])
def test_a_projector_is_asked_and_switched(password: str) -> None:
    with projector(password=password, slow=1, erst="010200") as lamp:
        lamp.hours = [1234, 56]
        there = of(lamp, password)
        assert status_of(there) == Status("off", (1234, 56), ("lamp: warning", "cover: error"))
        switch(there, on=True)
        assert lamp.power == WARMING
        assert [status_of(there).power for _ in range(2)] == ["warming up", "on"]
        switch(there, on=False)
        assert lamp.power == COOLING
        assert str(status_of(there)) == "cooling, 1234 h of lamp, 56 h of lamp, lamp: warning, cover: error"


def test_the_digest_is_that_of_the_specification() -> None:
    """The example of PJLink 1.04, section 5.2: 498e4a67 and JBMIAProjectorLink."""
    with projector() as lamp:
        lamp.greeting = "PJLINK 1 498e4a67"
        with pytest.raises(InputError):  # this projector does not know the digest
            status_of(of(lamp, "JBMIAProjectorLink"))
        assert lamp.lines == ["5d8409bc1c3fa39749434aa3a5c38682%1POWR ?"]


@pytest.mark.parametrize(
    ("kind", "password", "message"),
    [
        ({"password": "right"}, "wrong", "the password is wrong; correct it"),
        ({"password": "right"}, "", "it asks for a password; give it one"),
        ({"power": WARMING, "slow": 9}, "", "POWR 1: not now: it warms up or cools down; look at the projector"),
        ({"answers": {"POWR": "ERR4"}}, "", "POWR 1: the projector has failed"),
        ({"answers": {"POWR": "???"}}, "", "POWR 1: it answers '[?]{3}'"),
        ({"greeting": "SSH-2.0-OpenSSH_9.2"}, "", "no PJLink projector .'SSH-2.0-OpenSSH_9.2'.; check its address"),
        ({"greeting": "x" * 100_000}, "", "no PJLink projector"),
        ({"greeting": "PJLINK 1"}, "", "no PJLink projector"),
    ],
)
def test_what_a_projector_refuses_is_told_in_a_line(kind: dict[str, object], password: str, message: str) -> None:
    made = {name: kind.pop(name) for name in ("password", "power", "slow") if name in kind}
    with projector(**made) as lamp:
        vars(lamp).update(kind)
        with pytest.raises(InputError, match=f"^projector 127.0.0.1:{lamp.port}: {message}") as refusal:
            switch(of(lamp, password), on=True)
        assert "\n" not in str(refusal.value)
        assert len(str(refusal.value)) < 300


def test_one_that_is_not_there_or_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pjlink, "ANSWER_S", 0.2)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        port = silent.getsockname()[1]
        with pytest.raises(InputError, match=f"projector 127.0.0.1:{port}: Connection refused; check its address"):
            status_of(Projector("127.0.0.1", port))
        silent.listen()
        with pytest.raises(InputError, match="no answer; check its address"):
            status_of(Projector("127.0.0.1", port))
    with pytest.raises(InputError, match=r"projector no\.such\.invalid:4352: .*; check its address"):
        status_of(Projector("no.such.invalid"))


@pytest.mark.parametrize("answers", [{"LAMP": "ERR1", "ERST": "ERR1"}, {"LAMP": "1 2 3", "ERST": "00000x"}])
def test_what_one_does_not_know_of_itself_is_left_out(answers: dict[str, str]) -> None:
    with projector(power=ON) as lamp:
        lamp.answers = answers
        assert status_of(of(lamp)) == Status("on")


def test_the_verb_switches_all_that_it_is_given(tmp_path: Path) -> None:
    (tmp_path / "password").write_text("secret\n")
    with projector(password="secret") as first, projector(password="secret", power=ON) as second:
        hosts = [f"127.0.0.1:{lamp.port}" for lamp in (first, second)]
        options = *hosts, "--password-file", tmp_path / "password"
        assert succeed("projector", "on", *options).splitlines() == [
            f"projector {hosts[0]}: on, 1234 h of lamp",
            f"projector {hosts[1]}: on, 1234 h of lamp",
            "2 of 2 projectors obeyed; next: counterlight play ROOM MEDIA --fullscreen",
        ]
        assert first.power == second.power == ON
        second.password = "changed"
        told = command("projector", "status", *options)
        assert told.returncode == 2
        assert told.stderr == f"error: projector {hosts[1]}: the password is wrong; correct it\n"
        assert told.stdout.splitlines() == [
            f"projector {hosts[0]}: on, 1234 h of lamp",
            "1 of 2 projectors answered; next: counterlight projector on HOST",
        ]
    assert "names no projector; add a HOST, or --schedule FILE" in fail("projector", "status")
    assert "expected HOST[:PORT], found 'x:y'" in fail("projector", "status", "x:y")


# Hours.


def at(text: str) -> datetime:
    """Return a time in November 2026. The 23rd is a Monday."""
    return datetime.strptime(f"2026-11-{text}", "%Y-%m-%d %H:%M:%S")


def hours_of(begin: str, end: str, days: frozenset[int] = EVERY_DAY) -> Hours:
    times = (datetime.strptime(text, "%H:%M").time() for text in (begin, end))
    return Hours(days, *times)


@pytest.mark.parametrize(
    ("schedule", "open_at", "closed_at"),
    [
        (Schedule((hours_of("10:00", "18:00"),)), ["23 10:00:00", "23 17:59:59"], ["23 09:59:59", "23 18:00:00"]),
        (
            Schedule((hours_of("22:00", "02:00", days_of(["fri"])),)),
            ["27 22:00:00", "28 01:59:59"],
            ["28 02:00:00", "28 22:00:00", "27 01:00:00"],
        ),
        (Schedule((hours_of("00:00", "00:00"),)), ["23 00:00:00", "23 23:59:59", "24 00:00:00"], []),
        (
            Schedule((hours_of("10:00", "12:00"), hours_of("14:00", "15:00", days_of(["mon"])))),
            ["23 14:30:00", "24 11:00:00"],
            ["23 13:00:00", "24 14:30:00"],
        ),
        (
            Schedule((hours_of("22:00", "02:00"),), frozenset([date(2026, 11, 24)])),
            ["24 01:00:00", "25 22:00:00"],
            ["24 23:00:00", "25 01:00:00"],
        ),
        (Schedule(()), [], ["23 12:00:00"]),
    ],
)
def test_when_a_show_plays(schedule: Schedule, open_at: list[str], closed_at: list[str]) -> None:
    assert [text for text in open_at if not schedule.plays(at(text))] == []
    assert [text for text in closed_at if schedule.plays(at(text))] == []


def test_projectors_are_lit_ahead_and_not_behind() -> None:
    schedule = Schedule((hours_of("10:00", "18:00"),), ahead=timedelta(minutes=3))
    assert [schedule.lit(at(f"23 {clock}")) for clock in ("09:56:59", "09:57:00", "17:59:00", "18:00:00")] == [
        False,
        True,
        True,
        False,
    ]


def until(condition: object, what: str) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < until_s, what
        time.sleep(0.01)


def test_a_keeper_switches_projectors_and_leaves_them_alone_then(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The keeper switches on before the show and off afterwards, but not in between.

    One projector is slow, and one does not answer.
    """
    monkeypatch.setattr(hours, "AGAIN_S", 0.02)
    now = [at("23 09:00:00")]
    with projector(slow=3, erst="000010") as slow, projector(power=ON) as lit:
        projectors = of(slow), of(lit), Projector("127.0.0.1", 1)
        schedule = Schedule((hours_of("10:00", "18:00"),), projectors=projectors)
        keeper = Keeper(lambda: schedule, lambda: now[0])
        until(lambda: lit.power != ON and slow.count("POWR ?") > 0, "off before the show")
        now[0] = at("23 09:58:30")
        until(lambda: slow.power == lit.power == ON, "on for the show")
        until(lambda: slow.count("POWR 1") == lit.count("POWR 1") == 1, "told once")
        lit.power = OFF  # switched off by hand
        now[0] = at("23 12:00:00")
        looks = lit.count("POWR ?")
        until(lambda: lit.count("POWR ?") > looks, "looked at again")
        assert lit.power == OFF
        now[0] = at("23 18:00:00")
        until(lambda: slow.power in (OFF, COOLING), "off behind the show")
        keeper.close()
        for thread in keeper._threads:
            thread.join(PATIENCE_S)
    told = capfd.readouterr().err
    assert f"projector 127.0.0.1:{slow.port}: off, 1234 h of lamp, filter: warning" in told
    assert told.count("Connection refused") == 1  # reported once, not at every poll


def test_hours_that_end_while_a_projector_warms_up_switch_it_off_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The projector obeys off and then on. The test ends the warm-up, and the keeper switches off."""
    monkeypatch.setattr(hours, "AGAIN_S", 0.2)
    now = [at("23 09:00:00")]
    with projector(slow=10**6) as lamp:
        keeper = Keeper(lambda: Schedule((hours_of("10:00", "18:00"),), projectors=(of(lamp),)), lambda: now[0])
        until(lambda: lamp.count("POWR ?") > 0, "asked")
        now[0] = at("23 10:00:00")
        until(lambda: lamp.power == WARMING, "the order")
        now[0] = at("23 18:00:00")
        lamp.power = ON
        until(lambda: lamp.power == COOLING, "off again")
        keeper.close()


def test_a_changed_schedule_does_not_wait_for_the_next_query(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hours, "AGAIN_S", 10 * PATIENCE_S)
    now = [at("23 10:00:00")]
    with projector() as lamp:
        keeper = Keeper(lambda: Schedule((hours_of("10:00", "18:00"),), projectors=(of(lamp),)), lambda: now[0])
        until(lambda: lamp.power == WARMING, "the order")
        lamp.power = ON
        now[0] = at("23 18:00:00")
        until(lambda: lamp.power == COOLING, "the order of the changed schedule")
        keeper.close()


def test_lamps_are_switched_and_told_of_without_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """One projector warms up slowly, one refuses the password. First one projector is switched, then all of them."""
    monkeypatch.setattr(pjlink, "AGAIN_S", 0.02)
    with projector(slow=3, erst="000010") as slow, projector(password="right") as locked, projector() as other:
        asked = Lamps([of(slow), of(locked, "wrong"), of(other)])
        until(lambda: asked.told()[0]["power"] == "off", "asked")
        until(lambda: asked.told()[1]["trouble"] is not None, "refused")
        asked.switch(0, on=True)
        until(lambda: asked.told()[0]["power"] == "warming up", "told while it warms up")
        until(lambda: asked.told()[0]["power"] == "on", "looked at again")
        assert (slow.count("POWR 1"), other.power) == (1, OFF)
        asked.switch(None, on=True)
        until(lambda: other.power == ON, "all")
        asked.switch(None, on=False)
        until(lambda: asked.told()[0]["power"] == asked.told()[2]["power"] == "off", "all off")
        told = asked.told()  # read before the projectors close, because a question may then remain unanswered
        asked.close()
    assert told[0] == {
        "address": f"127.0.0.1:{slow.port}",
        "power": "off",
        "lamp-hours": [1234],
        "faults": ["filter: warning"],
        "trouble": None,
    }
    assert (told[1]["power"], told[1]["lamp-hours"]) == (None, [])
    assert "the password is wrong" in told[1]["trouble"]
    assert (slow.count("POWR 1"), slow.count("POWR 0")) == (1, 1)


FILE = """format = 1
minutes-ahead = 3
closed = [2026-12-24, "2026-12-25"]
[[projectors]]
address = "10.0.0.21"
password = "secret"
[[projectors]]
address = "left.local:4000"
[[hours]]
days = ["mon", "fri"]
from = "10:00"
to = 18:30:00
[[hours]]
from = "20:00:30"
to = "01:00"
"""


def test_a_schedule_is_read(tmp_path: Path) -> None:
    (tmp_path / "hours.toml").write_text(FILE)
    found = read_schedule(tmp_path / "hours.toml")
    assert found.projectors == (Projector("10.0.0.21", 4352, "secret"), Projector("left.local", 4000))
    assert found.closed == {date(2026, 12, 24), date(2026, 12, 25)}
    assert found.ahead == timedelta(minutes=3)
    assert [each.days for each in found.hours] == [{0, 4}, EVERY_DAY]
    assert found.plays(at("23 18:29:59"))
    assert found.plays(at("24 00:59:59"))
    assert not found.plays(at("23 20:00:29"))
    assert found.opens(at("26 20:00:31")) == at("27 10:00:00")
    assert found.opens(datetime(2026, 12, 23, 21)) == datetime(2026, 12, 26, 20, 0, 30)  # the 24th and 25th are closed
    (tmp_path / "hours.toml").write_text('format = 1\n[[projectors]]\naddress = "10.0.0.21"\n')
    assert read_schedule(tmp_path / "hours.toml").plays(at("23 20:00:29"))  # no hours: the show always plays


@pytest.mark.parametrize(
    ("was", "now", "message"),
    [
        ("format = 1", "format = 2", "format 2, this version reads 1"),
        ('"mon"', '"monday"', "days: found .*, expected a list of mon, tue"),
        ('["mon", "fri"]', "[]", "days: found .*, expected a list of mon, tue"),
        ('"10:00"', '"10"', "from: found '10', expected a time such as \"20:00\""),
        ('"10:00"', "10", "from: found 10, expected a time"),
        ("18:30:00", "2026-11-22", "to: found .*, expected a time"),
        ('"2026-12-25"', '"christmas"', "closed: found 'christmas', expected a day such as 2026-12-24"),
        ('"left.local:4000"', '"left.local:x"', "address: found 'left.local:x', expected HOST or HOST:PORT"),
        ("minutes-ahead = 3", "minutes-ahead = 500", "minutes-ahead: .*expected a number from 0 to 120"),
        ("minutes-ahead", "minutes_ahead", "unknown key 'minutes_ahead'; did you mean 'minutes-ahead'"),
        ('password = "secret"', "passwort = 1", "unknown key 'passwort'; did you mean 'password'"),
        ("[[hours]]", "[[days]]", "unknown key 'days'"),
    ],
)
def test_a_wrong_schedule_is_told_in_a_line(was: str, now: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "hours.toml"
    path.write_text(FILE.replace(was, now))
    with pytest.raises(InputError, match=message) as refusal:
        read_schedule(path)
    assert str(refusal.value).startswith(f"{path}")


def test_a_schedule_is_read_again_when_it_changes(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "hours.toml"
    path.write_text(FILE)
    path.chmod(0o644)
    schedule = ScheduleFile(path)
    assert capfd.readouterr().err == f"{path}: other users can read its passwords; restrict it: chmod 600 {path}\n"
    path.chmod(0o600)
    ScheduleFile(path)
    first = schedule()
    path.write_text("damaged")
    assert schedule() is first
    path.unlink()
    assert schedule() is first
    path.write_text(FILE.replace("10:00", "11:00"))
    assert not schedule().plays(at("23 10:30:00"))
    told = capfd.readouterr().err.splitlines()
    assert told[0].endswith("; the hours stay as they were")
    assert told[1:] == [f"{path}: read again"]


def test_a_schedule_needs_a_supervisor(tmp_path: Path) -> None:
    assert "add --supervise" in fail("play", "room", "clip.mkv", "--schedule", tmp_path / "hours.toml")
    line = fail("play", "room", "clip.mkv", "--supervise", "--schedule", tmp_path / "hours.toml")
    assert "hours.toml: missing" in line
