"""A real browser for tests: headless Chromium, spoken to through its own protocol over two pipes.

No driver, no port, no package: with `--remote-debugging-pipe` it reads JSON from descriptor 3 and
writes it to descriptor 4, each message ended by a zero byte.
"""

import base64
import fcntl
import json
import os
import select
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

__all__ = [
    "Browser",
    "Tab",
    "chromium_dom",
    "chromium_path",
    "chromium_screenshot",
    "open_browser",
]

_FLAGS = (
    "--headless",
    "--no-sandbox",  # as root there is none
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
    "--remote-debugging-pipe",
)
_TIMEOUT_S = 60.0
_SETTLED_S = 0.3
Size = tuple[int, int]


def chromium_path() -> str:
    """Where Chromium is; the test is skipped without, but for where the browser is required."""
    for name in ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"):
        found = shutil.which(name)
        if found:
            return found
    if os.environ.get("EXUMI_REQUIRE_BROWSER"):
        pytest.fail("EXUMI_REQUIRE_BROWSER is set, and there is no Chromium")
    pytest.skip("there is no Chromium (Debian: apt-get install chromium)")


class Browser:
    """A running Chromium."""

    def __init__(self, read: int, write: int) -> None:
        self._read, self._write = read, write
        self._buffer = b""
        self._number = 0
        self.events: list[dict[str, Any]] = []

    def call(self, method: str, session: str | None = None, **params: Any) -> dict[str, Any]:
        """Ask for something; return the answer. Events that come meanwhile are kept."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if session is not None:
            message["sessionId"] = session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._write, data) :]
        deadline = time.monotonic() + _TIMEOUT_S
        while True:
            answer = self._receive(deadline - time.monotonic())
            if answer is None:
                raise TimeoutError(f"Chromium did not answer {method}")
            if answer.get("id") != self._number:
                self.events.append(answer)
                continue
            if "error" in answer:
                raise RuntimeError(f"{method}: {answer['error']}")
            return dict(answer["result"])

    def listen(self, seconds: float) -> None:
        """Keep the events that come within a while."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            event = self._receive(left)
            if event is not None:
                self.events.append(event)

    def wait_for(self, method: str, session: str) -> dict[str, Any]:
        """Wait until an event has come; return its parameters."""
        deadline = time.monotonic() + _TIMEOUT_S
        seen = 0
        while True:
            for event in self.events[seen:]:
                if event.get("method") == method and event.get("sessionId") == session:
                    return dict(event["params"])
            seen = len(self.events)
            more = self._receive(deadline - time.monotonic())
            if more is None:
                raise TimeoutError(f"no event {method}")
            self.events.append(more)

    def _receive(self, seconds: float) -> dict[str, Any] | None:
        deadline = time.monotonic() + seconds
        while b"\0" not in self._buffer:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self._read], [], [], left)[0]:
                return None
            more = os.read(self._read, 1 << 20)
            if not more:
                raise ConnectionError("Chromium ended")
            self._buffer += more
        message, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(message))

    @contextmanager
    def tab(
        self, address: str | Path, size: Size = (1280, 900), *, dark: bool = False
    ) -> Iterator["Tab"]:
        """Open a page in a window of its own and wait until it is loaded."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        tab = Tab(self, session)
        try:
            for domain in ("Page", "Runtime", "Network", "Log"):
                tab.call(f"{domain}.enable")
            tab.resize(size)
            tab.media(dark=dark)
            url = address.resolve().as_uri() if isinstance(address, Path) else address
            tab.call("Page.navigate", url=url)
            self.wait_for("Page.loadEventFired", session)
            self.listen(_SETTLED_S)
            yield tab
        finally:
            with suppress(ConnectionError, RuntimeError):
                self.call("Target.closeTarget", targetId=target)


class Tab:
    """A page that is open."""

    def __init__(self, browser: Browser, session: str) -> None:
        self._browser, self._session = browser, session

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Ask the page for something, as the DevTools protocol names it."""
        return self._browser.call(method, self._session, **params)

    def resize(self, size: Size) -> None:
        """Give the window another size, in CSS pixels; below 500 it is a phone."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=size[0],
            height=size[1],
            deviceScaleFactor=1,
            mobile=size[0] < 500,
        )

    def media(self, *, dark: bool = False, kind: str = "screen") -> None:
        """Prefer dark or light colours; show the page as on a ``screen`` or in ``print``."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", media=kind, features=[scheme])

    def run(self, expression: str) -> Any:
        """Evaluate JavaScript in the page, whatever its policy; return its value."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(str(answer["exceptionDetails"]))
        return answer["result"].get("value")

    def screenshot(self, *, whole: bool = False) -> bytes:
        """Return a picture of the window, or of the whole page, as PNG."""
        if whole:
            height = int(self.run("document.documentElement.scrollHeight"))
            width = int(self.run("innerWidth"))
            self.resize((width, height))
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def pdf(self) -> bytes:
        """Print the page on A4, as PDF."""
        answer = self.call("Page.printToPDF", paperWidth=8.27, paperHeight=11.69)
        return base64.b64decode(answer["data"])

    def dom(self) -> str:
        """Return the document as it is now."""
        return str(self.run("document.documentElement.outerHTML"))

    @property
    def requests(self) -> list[str]:
        """Every address that the page asked for, itself included."""
        return [e["request"]["url"] for e in self._events("Network.requestWillBeSent")]

    @property
    def errors(self) -> list[str]:
        """What the console shows as errors and warnings, and exceptions."""
        logged = [e["entry"]["text"] for e in self._events("Log.entryAdded")]
        thrown = [str(e["exceptionDetails"]) for e in self._events("Runtime.exceptionThrown")]
        said = [
            str(e["args"])
            for e in self._events("Runtime.consoleAPICalled")
            if e["type"] in ("error", "warning", "assert")
        ]
        return logged + thrown + said

    def _events(self, method: str) -> list[dict[str, Any]]:
        return [
            event["params"]
            for event in self._browser.events
            if event.get("method") == method and event.get("sessionId") == self._session
        ]


@contextmanager
def open_browser(*flags: str) -> Iterator[Browser]:
    """Start Chromium with a profile of its own, and end it."""
    path = chromium_path()
    webgl = any(flag.startswith("--use-angle") for flag in flags)
    gpu = () if webgl else ("--disable-gpu",)
    with tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True) as profile:
        arguments = [path, *_FLAGS, *gpu, *flags, f"--user-data-dir={profile}", "about:blank"]
        child_read, write = os.pipe()
        read, child_write = os.pipe()
        # Above 4, so that neither is overwritten before it is put into its place.
        high = [fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 10) for fd in (child_read, child_write)]
        nowhere = os.open(os.devnull, os.O_RDWR)
        actions = [
            *((os.POSIX_SPAWN_DUP2, nowhere, number) for number in range(3)),
            (os.POSIX_SPAWN_DUP2, high[0], 3),
            (os.POSIX_SPAWN_DUP2, high[1], 4),
        ]
        process = os.posix_spawn(path, arguments, os.environ, file_actions=actions, setpgroup=0)
        for descriptor in (child_read, child_write, *high, nowhere):
            os.close(descriptor)
        try:
            yield Browser(read, write)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process, signal.SIGKILL)
            os.waitpid(process, 0)
            os.close(read)
            os.close(write)


def chromium_screenshot(
    address: str | Path,
    size: Size = (1280, 900),
    *,
    dark: bool = False,
    flags: tuple[str, ...] = (),
) -> bytes:
    """Return a picture of a page as PNG."""
    with open_browser(*flags) as browser, browser.tab(address, size, dark=dark) as tab:
        return tab.screenshot()


def chromium_dom(address: str | Path) -> str:
    """Return the document of a page, after its scripts ran."""
    with open_browser() as browser, browser.tab(address) as tab:
        return tab.dom()
