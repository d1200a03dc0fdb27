"""Headless Chromium (Debian's), driven by the DevTools protocol."""

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

# Containers lack user namespaces for Chromium's sandbox and have a small /dev/shm. Only the page under test is loaded.
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--disable-gpu",
    "--no-first-run",
    "--mute-audio",
)


WENT_AWAY = -32000  # Chromium's error code when the page is replaced during a call


class WentAwayError(Exception):
    """The page was replaced before it answered."""


class Page:
    """Browser tab."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self.complaints: list[str] = []  # errors from the browser's console
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: object) -> Any:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            reply = json.loads(self._socket.recv(timeout=PATIENCE_S))
            if reply.get("id") == number:
                if reply.get("error", {}).get("code") == WENT_AWAY:
                    raise WentAwayError(reply["error"]["message"])
                assert "error" not in reply, reply
                return reply["result"]
            self._note(reply)

    def open(self, address: str) -> None:
        self.call("Page.navigate", url=address)

    def size(self, width: int, height: int, *, phone: bool = False) -> None:
        """Set the window size in pixels.

        phone : touch input, and two screen pixels per page pixel.
        """
        scale = 2 if phone else 1
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=phone
        )

    def ask(self, expression: str) -> Any:
        """Evaluate an expression in the page and return its value; fails if the expression throws."""
        reply = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in reply, reply["exceptionDetails"]
        return reply["result"].get("value")

    def wait(self, expression: str) -> Any:
        """Wait until an expression is true and return its value; a page that is still loading counts as false."""
        deadline = time.monotonic() + PATIENCE_S
        tried = f"(() => {{ try {{ return {expression} }} catch {{ return null }} }})()"
        while True:
            with contextlib.suppress(WentAwayError):
                if value := self.ask(tried):
                    return value
            assert time.monotonic() < deadline, (expression, self.ask("document.body.innerText"), self.complaints)
            time.sleep(0.05)

    def middle(self, selector: str) -> tuple[float, float]:
        """Scroll an element into view and return the position of its centre."""
        box = (
            f"(e => {{ e.scrollIntoView({{block: 'center'}}); const b = e.getBoundingClientRect();"
            f" return [b.left + b.width / 2, b.top + b.height / 2]; }})(document.querySelector({json.dumps(selector)}))"
        )
        x, y = self.ask(box)
        return x, y

    def click(self, selector: str) -> None:
        self._hit(selector, "click", lambda: self.drag(self.middle(selector)))

    def slide(self, selector: str, share: float) -> None:
        """Drag from an element's centre to the right, by `share` of its width."""
        width = self.ask(f"document.querySelector({json.dumps(selector)}).getBoundingClientRect().width")

        def drag() -> None:
            x, y = self.middle(selector)
            self.drag((x, y), (x + share * width, y))

        self._hit(selector, "pointerdown", drag)

    def _hit(self, selector: str, event: str, gesture: Callable[[], None]) -> None:
        """Repeat a gesture until its event reaches the element, because the page may move or replace the element."""
        reached = f"e => {{ window.reached = e.target.closest({json.dumps(selector)}) !== null }}"
        deadline = time.monotonic() + PATIENCE_S
        while True:
            self.ask(f"window.reached = false; addEventListener('{event}', {reached}, {{capture: true, once: true}})")
            gesture()
            with contextlib.suppress(WentAwayError):  # the click is opening another page, so it has reached its element
                if self.ask("window.reached") is False:
                    assert time.monotonic() < deadline, (selector, self.complaints)
                    continue
            return

    def drag(self, *points: tuple[float, float]) -> None:
        """Press the left mouse button at the first point, move along the points and release it at the last."""
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

    def _note(self, reply: dict[str, Any]) -> None:
        if reply["method"] == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(reply["params"]["exceptionDetails"]))
        elif reply["method"] == "Log.entryAdded" and reply["params"]["entry"]["level"] == "error":
            self.complaints.append(json.dumps(reply["params"]["entry"]))


@contextmanager
def browser(folder: Path) -> Iterator[Callable[[], Page]]:
    """Start a browser and end it afterwards; the yielded function opens a tab."""
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
    """Port of the DevTools protocol, which the browser writes into its folder."""
    reply, deadline = folder / "DevToolsActivePort", time.monotonic() + PATIENCE_S
    while not (reply.exists() and "\n" in reply.read_text()):
        assert process.poll() is None, (folder / "log").read_text()
        assert time.monotonic() < deadline, (folder / "log").read_text()
        time.sleep(0.05)
    return reply.read_text().split()[0]
