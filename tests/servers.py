"""Real servers on localhost that hold a folder: S3 (moto), and web servers good and bad."""

import base64
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import obstore
from moto.server import ThreadedMotoServer
from obstore.store import S3Store

from exumi_data.catalog import build_catalog, write_catalog
from exumi_data.store.pack import pack

BUCKET = "datasets"
S3_ENVIRONMENT = {
    "AWS_ACCESS_KEY_ID": "test-key",
    "AWS_SECRET_ACCESS_KEY": "test-secret",
    "AWS_REGION": "us-east-1",
}


def pack_dataset(source: Path, target: Path) -> Path:
    """Copy a dataset with every episode packed."""
    for episode in sorted(source.glob("episodes/*/*.zarr")):
        packed = target / f"{episode.relative_to(source)}.zip"
        packed.parent.mkdir(parents=True, exist_ok=True)
        pack(episode, packed)
    (target / "dataset.json").write_bytes((source / "dataset.json").read_bytes())
    table, failed = build_catalog(target)
    assert not failed
    write_catalog(target, table)
    return target


class S3:
    """A bucket on a server of moto's, in this process."""

    def __init__(self) -> None:
        self._server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
        self._server.start()
        _, self._port = self._server.get_host_and_port()
        self.endpoint = f"http://127.0.0.1:{self._port}"
        self._put_empty(f"/{BUCKET}")
        self._store = S3Store(
            BUCKET,
            endpoint=self.endpoint,
            access_key_id=S3_ENVIRONMENT["AWS_ACCESS_KEY_ID"],
            secret_access_key=S3_ENVIRONMENT["AWS_SECRET_ACCESS_KEY"],
            region="us-east-1",
            client_options={"allow_http": True},
        )

    def put(self, key: str, data: bytes) -> None:
        obstore.put(self._store, key, data)

    def put_marker(self, key: str) -> None:
        """Put an empty object whose name ends with a slash, which obstore would take off."""
        self._put_empty(f"/{BUCKET}/{key}")

    def _put_empty(self, path: str) -> None:
        connection = HTTPConnection("127.0.0.1", self._port)
        connection.request("PUT", path)
        assert connection.getresponse().status == 200
        connection.close()

    def remove(self, key: str) -> None:
        obstore.delete(self._store, key)

    def upload(self, folder: Path, prefix: str) -> str:
        """Upload a folder; return its URL."""
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                self.put(f"{prefix}/{path.relative_to(folder).as_posix()}", path.read_bytes())
        return f"s3://{BUCKET}/{prefix}"

    def stop(self) -> None:
        self._server.stop()


class Web(ThreadingHTTPServer):
    """A web server of a folder that can be told to misbehave.

    Attributes
    ----------
    mode : str
        Empty, or what it does wrong.
    user : str
        ``user:password`` that it asks for.
    query : str
        That it asks for, as signed URLs have one.
    log : list of (method, path, range)
    """

    daemon_threads = True

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.folder = folder
        self.mode = self.user = self.query = ""
        self.tags: dict[str, str] = {}
        self.log: list[tuple[str, str, str | None]] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: clients that hang up are what is tested."""


_REFUSALS = {"denied": 403, "circle": 302, "down": 503}


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Web

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002  # as the base has it
        """Say nothing."""

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        server, parts = self.server, urlsplit(self.path)
        server.log.append((self.command, parts.path, self.headers.get("Range")))
        wanted = f"Basic {base64.b64encode(server.user.encode()).decode()}"
        if server.user and self.headers.get("Authorization") != wanted:
            return self._send(401, b"who are you?")
        refused = _REFUSALS.get("denied" if parts.query != server.query else server.mode)
        if refused is not None:
            return self._send(refused, b"no", {"Location": self.path})
        if server.mode == "hang_up":
            self.close_connection = True
            self.connection.shutdown(socket.SHUT_RDWR)
            return None
        if server.mode == "slow":
            time.sleep(1.5)
        if server.mode == "silent":
            time.sleep(60)
        path = server.folder / unquote(parts.path).lstrip("/")
        if not path.is_file():
            return self._send(404, b"nothing")
        data, tag = path.read_bytes(), server.tags.get(parts.path, "one")
        return self._send_part(data, tag)

    def _send_part(self, data: bytes, tag: str) -> None:
        mode, asked = self.server.mode, self.headers.get("Range")
        if mode == "no_ends" and (asked or "").startswith("bytes=-"):
            return self._send(400, b"bytes from where?")
        headers = {} if mode in ("no_tag", "no_version") else {"ETag": f'"{tag}"'}
        if mode == "no_tag":
            headers["Last-Modified"] = "Sun, 22 Nov 2026 10:00:00 GMT"
        if mode == "compressed":
            headers["Content-Encoding"] = "gzip"
        if asked is None or mode == "no_ranges":
            return self._send(200, data, headers)
        found = re.fullmatch(r"bytes=(\d*)-(\d*)", asked)
        assert found
        if not found[1]:
            start, stop = max(0, len(data) - int(found[2])), len(data)
        else:
            start = int(found[1])
            stop = min(int(found[2]) + 1, len(data)) if found[2] else len(data)
        shown = start + 1 if mode == "other_range" else start
        headers["Content-Range"] = f"bytes {shown}-{stop - 1}/{len(data)}"
        part = data[start : stop - 100 if mode == "short" else stop]
        return self._send(206, part, headers)

    def _send(self, status: int, body: bytes, headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        much = self.server.mode == "much" and status < 400
        self.send_header("Content-Length", str(len(body) + much * (1 << 40)))
        for name, value in (headers or {}).items():
            self.send_header(name, value)
        self.end_headers()
        if self.command == "HEAD":
            return
        if self.server.mode == "cut_short" and status < 400:
            self.wfile.write(body[: len(body) // 2])
            self.close_connection = True
            return
        self.wfile.write(body)
        if much:
            self.close_connection = True
            with suppress(OSError):
                while True:
                    self.wfile.write(bytes(1 << 16))


@contextmanager
def web(folder: Path) -> Iterator[Web]:
    """Serve a folder."""
    with Web(folder) as server:
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        try:
            yield server
        finally:
            server.shutdown()
