"""A recording in the browser: viewer and data on this machine only, for as long as somebody looks.

Rerun's program serves the viewer; the recording is served here, so that it comes from the file and
is held in nobody's memory but the browser's.
"""

import re
import secrets
import shutil
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from exumi_data.errors import UsageError
from exumi_data.view.program import running_rerun
from exumi_data.view.sdk import require_rerun

if TYPE_CHECKING:
    import subprocess

__all__ = ["DEFAULT_PORT", "HOST", "Served", "served"]

HOST = "127.0.0.1"
DEFAULT_PORT = 9090

_HOSTED = re.compile(rf"web-viewer at (http://{re.escape(HOST)}:\d+)")


@dataclass(frozen=True, slots=True)
class Served:
    """A recording that is being served.

    Attributes
    ----------
    address : str
        To open in a browser.
    wait : callable
        Returns when the viewer's server has ended by itself.
    """

    address: str
    process: "subprocess.Popen[str]"

    def wait(self) -> None:
        """Wait until the viewer's server ends: until somebody interrupts this."""
        for _ in self.process.stdout or ():
            pass  # what is not read would block it one day
        self.process.wait()


@contextmanager
def served(recording: Path, *, port: int = DEFAULT_PORT) -> Iterator[Served]:
    """Serve a recording, and the viewer for it, while the block runs.

    Only programs on this machine reach them, and of web pages only the viewer's reads the data.

    Parameters
    ----------
    recording : pathlib.Path
        The ``.rrd`` file.
    port : int
        Of the viewer; 0 takes a free one.

    Yields
    ------
    Served

    Raises
    ------
    MissingExtraError
        The Rerun SDK is not installed.
    UsageError
        The port is taken.
    """
    require_rerun()
    server = _FileServer(recording)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        arguments = ("--serve-web", "--bind", HOST, "--web-viewer-port", str(port), "--port", "0")
        with (
            tempfile.TemporaryDirectory(prefix="exumi-view-") as home,
            running_rerun(*arguments, server.address, home=Path(home)) as process,
        ):
            server.viewer = _viewer_of(process, port)
            # A layout that the browser kept from another episode would take this one's place.
            query = f"url={quote(server.address, safe='')}&persist=0"
            yield Served(f"{server.viewer}/?{query}", process)
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def _viewer_of(process: "subprocess.Popen[str]", port: int) -> str:
    """Return where the viewer is, once its server says so."""
    printed = []
    for line in process.stdout or ():
        found = _HOSTED.search(line)
        if found:
            return found[1]
        printed.append(line)
    text = "".join(printed)
    if "in use" in text:
        raise UsageError(f"port {port} is taken", fix="Choose another one with --port.")
    raise UsageError(f"Rerun's web viewer did not start: {text.strip()}")


class _FileServer(ThreadingHTTPServer):
    """Serves one file to one web page."""

    daemon_threads = True

    def __init__(self, file: Path) -> None:
        super().__init__((HOST, 0), _Handler)
        self.file = file
        # Other users of this machine cannot guess it.
        self.path = f"/{secrets.token_urlsafe(16)}/view.rrd"
        self.viewer = ""

    @property
    def address(self) -> str:
        """Where the file is."""
        return f"http://{HOST}:{self.server_port}{self.path}"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that went away."""


class _Handler(BaseHTTPRequestHandler):
    server: _FileServer
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        if self._begin():
            with suppress(ConnectionError), self.server.file.open("rb") as file:
                shutil.copyfileobj(file, self.wfile, 1 << 20)

    def do_HEAD(self) -> None:
        self._begin()

    def _begin(self) -> bool:
        # Another name for this machine is the trick of a page that wants to read what is here.
        known_host = self.headers.get("Host") == f"{HOST}:{self.server.server_port}"
        if self.path != self.server.path or not known_host:
            self.send_error(404)
            return False
        self.send_response(200)
        self.send_header("Content-Type", "application/octet-stream")
        self.send_header("Content-Length", str(self.server.file.stat().st_size))
        self.send_header("Access-Control-Allow-Origin", self.server.viewer)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        return True

    def log_message(self, *_: Any) -> None:
        """Say nothing."""
