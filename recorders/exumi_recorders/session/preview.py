"""What the cameras see, as MJPEG over HTTP: on request, and on this machine only unless told.

The frames are those that the cameras sent, at most five a second; nothing is decoded. A viewer that
is too slow misses frames, and nothing waits for it. Only who asks for this machine by its address
or its own name is answered: a page of somebody else's, whose name leads here, sees nothing.
"""

import html
import ipaddress
import re
import threading
import time
from collections.abc import Callable, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import AF_INET, AF_INET6, gethostname
from typing import Any, Self
from urllib.parse import unquote

from exumi_data.errors import UsageError

__all__ = ["Latest", "Preview", "parse_address"]

Latest = Callable[[str], bytes | None]
"""Returns the newest JPEG file of a stream, or None when there is none yet."""

DEFAULT_ADDRESS = ("127.0.0.1", 8642)

_LEAST_PERIOD_S = 0.2
_MOST_VIEWERS = 8
_MOST_CONNECTIONS = 32
_NUMBER = re.compile(r"[0-9]{1,9}")
_QUIET_S = 10.0
_BOUNDARY = "exumi-frame"
_PORT = re.compile(r":[0-9]*$")


def parse_address(text: str | None) -> tuple[str, int]:
    """Return host and port of ``HOST:PORT``, ``HOST``, ``:PORT`` or ``PORT``.

    Parameters
    ----------
    text : str, optional
        What is left out comes from 127.0.0.1:8642.

    Raises
    ------
    UsageError
        It is no such thing.
    """
    if not text:
        return DEFAULT_ADDRESS
    host, colon, port = text.rpartition(":")
    if not colon and not _NUMBER.fullmatch(text):
        host, port = text, ""
    bare = host.removeprefix("[").removesuffix("]")
    number = int(port) if _NUMBER.fullmatch(port) else (DEFAULT_ADDRESS[1] if not port else -1)
    if not 0 <= number <= 65535 or (":" in bare and host != f"[{bare}]"):
        raise UsageError(f"{text!r} is no address", fix="Write HOST:PORT, such as 0.0.0.0:8642.")
    return bare or DEFAULT_ADDRESS[0], number


class Preview:
    """A web page with all cameras, while the block runs.

    Parameters
    ----------
    streams : sequence of str
        Names of the image streams.
    latest : callable
        Gives the newest file of a stream.
    address : (str, int)
        Host and port; port 0 takes a free one.

    Attributes
    ----------
    url : str
        Where to look.

    Raises
    ------
    UsageError
        The address cannot be had.
    """

    def __init__(
        self, streams: Sequence[str], latest: Latest, address: tuple[str, int] = DEFAULT_ADDRESS
    ) -> None:
        try:
            self._server = _Server(address, tuple(streams), latest)
        except (OSError, UnicodeError, TypeError) as error:  # of a host that is no name
            why = error.strerror if isinstance(error, OSError) else "no name of a machine"
            raise UsageError(
                f"the preview cannot use {address[0]}:{address[1]} ({why})",
                fix="Name another one with --preview HOST:PORT.",
            ) from None
        host = f"[{address[0]}]" if ":" in address[0] else address[0]
        self.url = f"http://{host}:{self._server.server_port}/"
        self._host = address[0]
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="preview", daemon=True
        )

    @property
    def is_public(self) -> bool:
        """Whether other machines can look."""
        if _is_address(self._host):
            return not ipaddress.ip_address(self._host).is_loopback
        return self._host != "localhost"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.ending.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _own_names() -> set[str]:
    name = gethostname().lower()
    return {name, f"{name.partition('.')[0]}.local"}


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = _MOST_CONNECTIONS

    def __init__(self, address: tuple[str, int], streams: tuple[str, ...], latest: Latest) -> None:
        self.address_family = AF_INET6 if ":" in address[0] else AF_INET
        self.streams = streams
        self.latest = latest
        self.names = {address[0].lower(), "localhost", *_own_names()}
        self.viewers = threading.Semaphore(_MOST_VIEWERS)
        self.connections = threading.Semaphore(_MOST_CONNECTIONS)
        self.ending = threading.Event()
        super().__init__(address, _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own; of too many at once, some are let go unheard."""
        if not self.connections.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and make room for another."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.connections.release()

    def is_meant(self, host: str | None) -> bool:
        """Whether the ``Host`` of a request is this machine, by an address or a name of its own."""
        if host is None:
            return True  # no browser: these always say
        name = _PORT.sub("", host.strip().lower()).removeprefix("[").removesuffix("]")
        return name in self.names or _is_address(name)

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing: a viewer that went away is no problem of the recording."""


class _Handler(BaseHTTPRequestHandler):
    timeout = _QUIET_S  # a viewer that does not read is let go
    server: _Server

    def do_GET(self) -> None:  # the base class's name
        """Answer ``/`` with a page, ``/NAME`` with its moving picture, ``/NAME.jpg`` with one."""
        name = unquote(self.path.partition("?")[0]).removeprefix("/")
        if not self.server.is_meant(self.headers.get("Host")):
            self.send_error(403, "ask for this machine by its address")
        elif not name:
            self._page()
        elif name.removesuffix(".jpg") not in self.server.streams:
            self.send_error(404, "there is no such stream")
        elif name.endswith(".jpg"):
            self._still(name.removesuffix(".jpg"))
        elif self.server.viewers.acquire(blocking=False):
            try:
                self._moving(name)
            finally:
                self.server.viewers.release()
        else:
            self.send_error(503, "too many viewers")

    def end_headers(self) -> None:
        """Say with every answer that it is for nobody else's pages."""
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("X-Content-Type-Options", "nosniff")
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  # the base class's name
        """Say nothing: the terminal shows the recording."""

    def _page(self) -> None:
        names = [html.escape(name) for name in self.server.streams]
        pictures = "".join(
            f'<figure><img src="/{name}" alt="{name}"><figcaption>{name}</figcaption></figure>'
            for name in names
        )
        self._send(
            "text/html; charset=utf-8",
            "<!doctype html><meta name=viewport content='width=device-width'><title>exumi</title>"
            "<style>body{margin:0;background:#111;color:#ddd;font:16px sans-serif}"
            "figure{display:inline-block;margin:4px;max-width:100%}img{max-width:100%}</style>"
            f"{pictures or 'This rig has no camera.'}".encode(),
        )

    def _still(self, name: str) -> None:
        frame = self.server.latest(name)
        if frame is None:
            self.send_error(503, "no frame yet")
        else:
            self._send("image/jpeg", frame)

    def _send(self, media_type: str, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Type", media_type)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def _moving(self, name: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        shown: bytes | None = None
        while not self.server.ending.is_set():
            began = time.monotonic()
            frame = self.server.latest(name)
            if frame is not None and frame is not shown:
                head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\n"
                self.wfile.write(f"{head}Content-Length: {len(frame)}\r\n\r\n".encode())
                self.wfile.write(frame)
                self.wfile.write(b"\r\n")
                shown = frame
            self.server.ending.wait(max(0.0, began + _LEAST_PERIOD_S - time.monotonic()))
