"""A localhost S3 server with a dataset, behind a proxy that delays every request.

Two processes: moto's server, and a proxy that counts what passes. Starting it prints one JSON line
with the URL of the proxy; ``GET /-/counts`` of it gives requests and bytes so far::

    python benchmarks/remote_server.py FOLDER --latency 0.02
"""

import argparse
import asyncio
import json
import signal
import subprocess
import sys
import threading
import urllib.request
from pathlib import Path

BUCKET = "datasets"


class Proxy:
    """Passes HTTP requests on after a delay, and answers as they come.

    Parameters
    ----------
    port : int
        Of the server on this machine.
    latency_s : float
    """

    def __init__(self, port: int, latency_s: float) -> None:
        self._port = port
        self._latency_s = latency_s
        self.requests = 0
        self.bytes = 0

    async def serve(self) -> None:
        """Listen on a free port, and say which."""
        server = await asyncio.start_server(self._connection, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        print(json.dumps({"url": f"http://127.0.0.1:{port}"}), flush=True)
        async with server:
            await server.serve_forever()

    async def _connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        upstream: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        try:
            while True:
                head = await reader.readuntil(b"\r\n\r\n")
                if head.startswith(b"GET /-/counts"):
                    await _answer(writer, {"requests": self.requests, "bytes": self.bytes})
                    continue
                self.requests += 1
                await asyncio.sleep(self._latency_s)
                upstream = upstream or await asyncio.open_connection("127.0.0.1", self._port)
                upstream[1].write(head)
                length = await _pass_on(upstream[0], writer)
                self.bytes += length
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            writer.close()
            if upstream is not None:
                upstream[1].close()


async def _answer(writer: asyncio.StreamWriter, document: dict[str, int]) -> None:
    body = json.dumps(document).encode()
    writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(body) + body)
    await writer.drain()


async def _pass_on(source: asyncio.StreamReader, target: asyncio.StreamWriter) -> int:
    """Pass one answer on; return the length of its body."""
    head = await source.readuntil(b"\r\n\r\n")
    fields = [line.partition(b":") for line in head.lower().split(b"\r\n")]
    length = next(int(value) for name, _, value in fields if name == b"content-length")
    target.write(head)
    rest = length
    while rest:
        part = await source.read(min(rest, 1 << 18))
        if not part:
            raise ConnectionResetError
        target.write(part)
        await target.drain()
        rest -= len(part)
    return length


def _upload(folder: Path, url: str) -> None:
    """Put the files of a folder into the bucket."""
    urllib.request.urlopen(urllib.request.Request(f"{url}/{BUCKET}", method="PUT"))  # noqa: S310  # our own server
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            key = f"{folder.name}/{path.relative_to(folder).as_posix()}"
            request = urllib.request.Request(  # noqa: S310  # our own server
                f"{url}/{BUCKET}/{key}",
                data=path.read_bytes(),
                method="PUT",
                headers={"Content-Type": "application/octet-stream"},  # or moto parses a form
            )
            urllib.request.urlopen(request)  # noqa: S310  # our own server


def _serve_s3(folder: Path) -> None:
    """Run moto's server with a folder in it until stdin ends."""
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    server.start()
    _, port = server.get_host_and_port()
    _upload(folder, f"http://127.0.0.1:{port}")
    print(port, flush=True)
    threading.Event().wait()


def main() -> None:
    """Serve until killed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--latency", type=float, default=0.02, help="seconds for each request")
    parser.add_argument("--s3-only", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.s3_only:
        _serve_s3(arguments.folder)
        return
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # so that the other process ends, too
    command = [sys.executable, __file__, str(arguments.folder), "--s3-only"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as s3:
        try:
            assert s3.stdout is not None  # noqa: S101  # a pipe
            port = int(s3.stdout.readline())
            asyncio.run(Proxy(port, arguments.latency).serve())
        finally:
            s3.kill()


if __name__ == "__main__":
    main()
