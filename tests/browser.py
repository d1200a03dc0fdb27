"""A real browser: Debian's Chromium without a window, driven by the DevTools protocol."""

import base64
import contextlib
import itertools
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

from websockets.sync.client import connect

from tests.programs import PATIENCE_S

# Containers have no user namespaces for its sandbox, and a small /dev/shm; nothing but the page under test is loaded.
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--disable-gpu",
    "--no-first-run",
    "--mute-audio",
)


WENT_AWAY = -32000  # what Chromium answers where a page gives way to another one meanwhile


class WentAwayError(Exception):
    """The page that was asked is no longer there."""


class Page:
    """One tab."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self.complaints: list[str] = []  # what the console said of errors
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: object) -> Any:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            told = json.loads(self._socket.recv(timeout=PATIENCE_S))
            if told.get("id") == number:
                if told.get("error", {}).get("code") == WENT_AWAY:
                    raise WentAwayError(told["error"]["message"])
                assert "error" not in told, told
                return told["result"]
            self._note(told)

    def open(self, address: str) -> None:
        self.call("Page.navigate", url=address)

    def size(self, width: int, height: int, *, phone: bool = False) -> None:
        """phone : with a finger, and two pixels of the screen to one of the page."""
        scale = 2 if phone else 1
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=phone
        )

    def ask(self, expression: str) -> Any:
        """The value of an expression in the page; fails where that throws."""
        told = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in told, told["exceptionDetails"]
        return told["result"].get("value")

    def wait(self, expression: str) -> Any:
        """Until an expression is true, which is then its value; a page that is not there yet has none."""
        deadline = time.monotonic() + PATIENCE_S
        tried = f"(() => {{ try {{ return {expression} }} catch {{ return null }} }})()"
        while True:
            with contextlib.suppress(WentAwayError):
                if value := self.ask(tried):
                    return value
            assert time.monotonic() < deadline, (expression, self.ask("document.body.innerText"), self.complaints)
            time.sleep(0.05)

    def middle(self, selector: str) -> tuple[float, float]:
        """Of an element, which is brought into view."""
        box = (
            f"(e => {{ e.scrollIntoView({{block: 'center'}}); const b = e.getBoundingClientRect();"
            f" return [b.left + b.width / 2, b.top + b.height / 2]; }})(document.querySelector({json.dumps(selector)}))"
        )
        x, y = self.ask(box)
        return x, y

    def click(self, selector: str) -> None:
        self._hit(selector, "click", lambda: self.drag(self.middle(selector)))

    def slide(self, selector: str, share: float) -> None:
        """From an element's middle to the right, by a share of its width."""
        width = self.ask(f"document.querySelector({json.dumps(selector)}).getBoundingClientRect().width")

        def drag() -> None:
            x, y = self.middle(selector)
            self.drag((x, y), (x + share * width, y))

        self._hit(selector, "pointerdown", drag)

    def _hit(self, selector: str, event: str, gesture: Callable[[], None]) -> None:
        """Repeat a gesture until its event reaches the element, which the page may move or replace meanwhile."""
        reached = f"e => {{ window.reached = e.target.closest({json.dumps(selector)}) !== null }}"
        deadline = time.monotonic() + PATIENCE_S
        while True:
            self.ask(f"window.reached = false; addEventListener('{event}', {reached}, {{capture: true, once: true}})")
            gesture()
            if self.ask("window.reached") is not False:  # nor of the page that it leads to
                return
            assert time.monotonic() < deadline, (selector, self.complaints)

    def drag(self, *points: tuple[float, float]) -> None:
        """The left mouse button pressed at the first point and released at the last."""
        for number, (x, y) in enumerate(points):
            self._mouse("mouseMoved", x, y, held=number > 0)
            if number == 0:
                self._mouse("mousePressed", x, y)
        self._mouse("mouseReleased", *points[-1])

    def screenshot(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def _mouse(self, kind: str, x: float, y: float, *, held: bool = True) -> None:
        button = "left" if held else "none"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=int(held), clickCount=1)

    def _note(self, told: dict[str, Any]) -> None:
        if told["method"] == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(told["params"]["exceptionDetails"]))
        elif told["method"] == "Log.entryAdded" and told["params"]["entry"]["level"] == "error":
            self.complaints.append(json.dumps(told["params"]["entry"]))


@contextmanager
def browser(folder: Path) -> Iterator[Callable[[], Page]]:
    """A browser that is ended afterwards; what is yielded opens a tab."""
    program = shutil.which("chromium")
    assert program is not None, "chromium is not installed; make test installs it, counterlight doctor says how"
    command = [program, *OPTIONS, f"--user-data-dir={folder}", "--remote-debugging-port=0", "about:blank"]
    with (folder / "log").open("wb") as log, ExitStack() as stack:
        process = stack.enter_context(subprocess.Popen(command, stdout=log, stderr=log))
        stack.callback(process.kill)
        port = _port(folder, process)

        def tab() -> Page:
            request = Request(f"http://127.0.0.1:{port}/json/new?about:blank", method="PUT")
            with urlopen(request, timeout=PATIENCE_S) as answer:
                address = json.loads(answer.read())["webSocketDebuggerUrl"]
            return Page(
                stack.enter_context(connect(address, max_size=None, close_timeout=1, ping_interval=None, proxy=None))
            )

        yield tab


def _port(folder: Path, process: subprocess.Popen[bytes]) -> str:
    """Of the DevTools protocol, which the browser writes into its folder."""
    told, deadline = folder / "DevToolsActivePort", time.monotonic() + PATIENCE_S
    while not (told.exists() and "\n" in told.read_text()):
        assert process.poll() is None, (folder / "log").read_text()
        assert time.monotonic() < deadline, (folder / "log").read_text()
        time.sleep(0.05)
    return told.read_text().split()[0]
