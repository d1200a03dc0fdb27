"""The page of --remote in a real browser: it shows the show, its controls work, and it reconnects to the player."""

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.browser import Page, browser
from tests.pjlink_projector import OFF, ON, projector
from tests.programs import PATIENCE_S, wait_until
from tests.web_remote import Place, Visitor, child, show_with_remote

DESKTOP, PHONE = (1280, 900), (390, 844)
HANDLES, SLIDERS, BOXES = (
    f"[...document.querySelectorAll('{what}')].map(each => each.getBoundingClientRect())"
    for what in ("#handles i", ".number input", "button, input, select, #handles i")
)


@pytest.fixture(scope="module")
def tabs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[], Page]]:
    with browser(tmp_path_factory.mktemp("browser")) as tab:
        yield tab


@pytest.fixture
def page(tabs: Callable[[], Page], shared_show: tuple[Any, Place], visitor: Visitor) -> Iterator[Page]:
    """Page of the shared show."""
    page = opened(tabs, shared_show[1])
    yield page
    page.open("about:blank")


def opened(tabs: Callable[[], Page], place: Place) -> Page:
    """Return the page once it has a picture."""
    page = tabs()
    page.size(*DESKTOP)
    page.open(place.address)
    page.wait("document.querySelector('#preview').naturalWidth > 10")
    return page


def test_a_show_is_seen_and_commanded(page: Page, visitor: Visitor, shared_show: tuple[Any, Place]) -> None:
    process, _ = shared_show
    assert page.ask("document.title") == "clip.mkv"
    assert page.ask(
        "[...document.querySelectorAll('#playlist button:not(.remove)')].map(each => each.textContent)"
    ) == ["clip.mkv"]
    assert page.ask("document.querySelector('#preview').naturalWidth") == 40  # the page shows the camera's view
    page.click("[data-preview=screen]")
    page.wait("document.querySelector('#preview').naturalWidth === 36")

    page.click("#pause")
    wait_until(lambda: visitor.get("pause") is True, "pause", process)
    page.wait("document.body.classList.contains('paused')")
    page.click("[data-flag=blackout]")
    wait_until(lambda: visitor.get("blackout") is True, "black", process)
    page.wait("document.querySelector('#veil').textContent === 'the screen is black'")
    choose = "(e => { e.value = 'split'; e.onchange(); })(document.querySelector('#set-view'))"
    page.ask(choose)
    wait_until(lambda: visitor.get("view") == "split", "the view", process)
    page.slide("#set-brightness", 1 / 4)
    wait_until(lambda: 30 < visitor.get("brightness") < 70, "half of the way to the end", process)
    page.click("#seek")
    wait_until(lambda: abs(visitor.get("time-pos") - 2.5) < 0.3, "the middle of five seconds", process)

    visitor.ask("set_property", "contrast", -20)
    page.wait("document.querySelector('#set-contrast').value === '-20'")
    page.ask("document.querySelector('#path').value = 'no such film.mkv'")
    page.click("#load button[value=append]")
    page.wait("document.querySelector('#message').textContent.includes('no such film.mkv')")
    page.click("#measure")
    page.wait("/dB|Not known/.test(document.querySelector('#message').textContent)")
    page.click("#check")
    page.wait("document.querySelector('#message').textContent.includes('--check-with')")
    assert page.complaints == []


def test_a_list_is_edited_by_hand(
    page: Page, visitor: Visitor, shared_show: tuple[Any, Place], shared_folder: Path
) -> None:
    """A file from the folder is added, dragged to the front, and removed."""
    process, _ = shared_show
    shutil.copy(shared_folder / "clip.mkv", shared_folder / "other.mkv")

    def listed(*names: str) -> None:
        wait_until(lambda: [Path(path).name for path in visitor.get("playlist")] == [*names], str(names), process)
        shown = "[...document.querySelectorAll('#playlist button:not(.remove)')].map(each => each.textContent).join()"
        page.wait(f"{shown} === '{','.join(names)}'")

    page.click("#browse")
    page.wait("document.querySelector('#files li button') !== null")
    page.click("#files li button")
    page.wait("document.querySelector('#files [title$=\"other.mkv\"]') !== null")
    page.ask("document.querySelector('#files li:has([title$=\"other.mkv\"])').lastChild.click()")
    page.click("#close-browser")
    listed("clip.mkv", "other.mkv")
    x, y = page.middle("#playlist li:last-child .grip")
    page.drag((x, y), (x, y - 10), (x, page.middle("#playlist li .grip")[1] - 12))
    listed("other.mkv", "clip.mkv")
    page.click("#playlist .remove")
    listed("clip.mkv")
    assert page.complaints == []


def test_what_fingers_touch_is_large_enough(page: Page) -> None:
    page.size(*PHONE, phone=True)
    page.click("[data-run=place]")
    page.wait("document.querySelector('#frame').classList.contains('placing')")
    assert page.ask(f"{BOXES}.filter(box => box.width && Math.min(box.width, box.height) < 43.9).length") == 0
    assert page.ask(f"{HANDLES}.filter(box => box.left < 0 || box.right > innerWidth).length") == 0
    assert page.ask(f"{SLIDERS}.filter(box => box.width && box.width < 200).length") == 0
    page.click("[data-run=place-cancel]")
    page.wait("!document.body.classList.contains('placing-now')")


def test_projectors_are_switched(tabs: Callable[[], Page], xvfb: str, small_room: Path, folder: Path) -> None:
    hours = folder / "hours.toml"
    with projector(power=ON, erst="000010") as left, projector(power=ON) as right:
        addresses = [f"127.0.0.1:{lamp.port}" for lamp in (left, right)]
        hours.write_text("format = 1\n" + "".join(f'[[projectors]]\naddress = "{each}"\n' for each in addresses))
        words = small_room, "clip.mkv", "--loop", "--supervise", "--schedule", hours
        with show_with_remote(xvfb, folder, *words) as (process, place), place.visit() as visitor:
            page = opened(tabs, place)
            said = "[...document.querySelectorAll('#projectors dd')].map(each => each.firstChild.textContent)"
            page.wait(f"{said}.join('; ') === 'on, 1234 h of lamp, filter: warning; on, 1234 h of lamp'")
            page.ask("window.confirm = () => true")
            page.click("#projectors dd:last-child button")
            wait_until(lambda: right.power == OFF, "one alone", process)
            assert left.power == ON
            page.wait(f"{said}[1].startsWith('off')")
            page.click("[data-run='projector off']")
            wait_until(lambda: left.power == OFF, "all", process)
            page.click("#projectors dd:last-child button")
            wait_until(lambda: right.power == ON, "on again", process)
            line = visitor.ask("projector", "on", 2)["message"]
            assert line.startswith("projector: expected")
            assert page.complaints == []


def test_a_corner_is_dragged_on_the_preview(page: Page, visitor: Visitor, shared_show: tuple[Any, Place]) -> None:
    process, _ = shared_show
    visitor.ask("set_property", "pause", True)
    page.click("[data-run=place]")
    page.wait("document.querySelector('#frame').classList.contains('placing')")
    before = np.array(visitor.get("corners"))
    page.ask("scrollTo(0, 0)")
    left, top, width, height = page.ask(
        "(b => [b.left, b.top, b.width, b.height])(document.querySelector('#frame').getBoundingClientRect())"
    )
    # a finger is never exactly on the handle
    start = np.array([left, top]) + before[2].clip(0.01, 0.99) * (width, height)
    moves = [start + share * np.array([-0.2 * width, -0.1 * height]) for share in (0, 0.3, 0.6, 1)]
    page.drag(*((float(x), float(y)) for x, y in moves))
    expected = before + np.array([[0, 0], [0, 0], [-0.2, -0.1], [0, 0]])

    def arrived() -> bool:
        return np.allclose(visitor.get("corners"), expected, atol=1 / min(width, height))  # a pixel of the page

    wait_until(arrived, "the corner", process)
    page.click("[data-run=place-undo]")
    wait_until(lambda: np.allclose(visitor.get("corners"), before), "one drag is one change", process)
    page.click("[data-run=place-cancel]")
    page.wait("!document.body.classList.contains('placing-now')")
    assert page.complaints == []


def test_nothing_is_cut_off(page: Page, visitor: Visitor, shared_folder: Path) -> None:
    long = shared_folder / ("a name without an end " * 8 + ".mkv")
    shutil.copy(shared_folder / "clip.mkv", long)
    assert visitor.ask("loadfile", long.name)["error"] == "success"
    page.wait(f"document.title === {long.name!r}")
    page.wait("values['late-frames']")
    for size in (DESKTOP, (1024, 700), PHONE, (320, 600)):
        page.size(*size, phone=size[0] < 500)
        wide = page.ask("[document.documentElement.scrollWidth, innerWidth]")
        assert wide[0] <= wide[1], size
        too_small = page.ask(
            "[...document.querySelectorAll('button')].filter(b => b.offsetHeight && b.offsetHeight < 32).length"
        )
        assert too_small == 0, size  # large enough for a finger


def test_it_finds_the_next_player_and_asks_for_a_token_that_is_wrong(
    tabs: Callable[[], Page], xvfb: str, small_room: Path, folder: Path
) -> None:
    with show_with_remote(xvfb, folder, small_room, "clip.mkv", "--loop", "--supervise") as (process, place):
        page = opened(tabs, place)
        os.kill(child(process.pid, "counterlight.app"), signal.SIGKILL)
        page.wait("document.body.classList.contains('away')")
        page.wait("!document.body.classList.contains('away') && values.frames > 0")
        stranger = tabs()
        stranger.open(place.address.partition("#")[0])
        stranger.wait("document.querySelector('#door').open")
        stranger.open(f"{place.address[:-1]}.")
        stranger.wait("document.querySelector('#why').textContent.includes('does not take this token')")
        stranger.ask(f"document.querySelector('#token').value = {place.token!r}")
        stranger.click("#door button")
        stranger.wait("document.title === 'clip.mkv'")
        with place.visit() as visitor:
            visitor.ask("quit")
        page.wait("document.querySelector('#health').textContent === 'ended'")
        assert process.wait(PATIENCE_S) == 0


def test_a_player_that_starts_between_two_requests_is_no_refusal(
    tabs: Callable[[], Page], shared_show: tuple[Any, Place]
) -> None:
    """A socket fails, and the page is served a moment later."""
    page = opened(tabs, shared_show[1])
    page.ask(
        "(Real => { let tries = 0; window.WebSocket = class extends Real "
        "{ constructor(url, words) { super(tries++ ? url : url + '-absent', words) } } })(WebSocket)"
    )
    page.ask("socket.close()")
    page.wait("document.body.classList.contains('away')")
    page.wait("!document.body.classList.contains('away') || document.querySelector('#door').open")
    assert not page.ask("document.querySelector('#door').open")
