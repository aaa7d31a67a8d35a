"""The preview, over real HTTP."""

import select
import socket
import threading
import time
from http.client import HTTPConnection, HTTPException
from urllib.parse import urlsplit

import pytest

from exumi_data.errors import UsageError
from exumi_recorders.session.preview import Preview, parse_address

FRAMES = [b"\xff\xd8" + bytes([number]) * 50 + b"\xff\xd9" for number in range(200)]


class Camera:
    """Makes 50 frames a second."""

    def __init__(self) -> None:
        self.began = time.monotonic()
        self.asked: list[str] = []

    def latest(self, stream: str) -> bytes | None:
        self.asked.append(stream)
        return FRAMES[int((time.monotonic() - self.began) * 50) % len(FRAMES)]


def connect(preview: Preview) -> HTTPConnection:
    address = urlsplit(preview.url)
    assert address.hostname is not None
    return HTTPConnection(address.hostname, address.port or 0, timeout=5)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        (None, ("127.0.0.1", 8642)),
        ("9000", ("127.0.0.1", 9000)),
        (":9000", ("127.0.0.1", 9000)),
        ("0.0.0.0", ("0.0.0.0", 8642)),  # noqa: S104  # what is parsed, not bound
        ("hub.local:80", ("hub.local", 80)),
        ("[::1]:80", ("::1", 80)),
    ],
)
def test_addresses(text: str | None, address: tuple[str, int]) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize(
    "text", ["host:port", "1.2.3.4:99999", ":-1", "::1", "::1:80", "hub:٣", "8642/:x"]
)
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(UsageError, match="no address"):
        parse_address(text)


@pytest.mark.parametrize("host", ["é" * 100, "256.1.1.1"])
def test_hosts_that_are_none(host: str) -> None:
    with pytest.raises(UsageError, match="cannot use"):
        Preview([], Camera().latest, (host, 0))


def test_those_who_connect_and_say_nothing_cost_little() -> None:
    before = set(threading.enumerate())  # servers of other tests may still be serving
    with Preview(["rgb"], Camera().latest, ("127.0.0.1", 0)) as preview:
        address = urlsplit(preview.url)
        silent = [
            socket.create_connection(("127.0.0.1", address.port or 0), timeout=5) for _ in range(60)
        ]
        time.sleep(0.2)
        new = set(threading.enumerate()) - before
        serving = [one for one in new if "process_request_thread" in one.name]
        assert 30 <= len(serving) <= 32
        for one in silent:
            one.close()
        end = time.monotonic() + 5
        connection = connect(preview)
        while True:
            try:
                connection.request("GET", "/rgb.jpg")
                assert connection.getresponse().read(2) == b"\xff\xd8"
                break
            except (ConnectionError, HTTPException):
                assert time.monotonic() < end
                connection.close()


def test_the_page_names_every_camera_and_is_for_this_machine_only() -> None:
    with Preview(["tactile_left", "rgb"], Camera().latest, ("127.0.0.1", 0)) as preview:
        assert not preview.is_public
        connection = connect(preview)
        connection.request("GET", "/")
        page = connection.getresponse().read().decode()
        assert 'src="/tactile_left"' in page
        assert 'src="/rgb"' in page


def test_frames_come_as_they_are_and_at_most_five_a_second() -> None:
    with Preview(["rgb"], Camera().latest, ("127.0.0.1", 0)) as preview:
        connection = connect(preview)
        connection.request("GET", "/rgb")
        answer = connection.getresponse()
        assert "multipart/x-mixed-replace" in answer.headers["Content-Type"]
        began = time.monotonic()
        seen = []
        for _ in range(4):
            while not (line := answer.readline()).startswith(b"Content-Length"):
                assert line
            answer.readline()
            seen.append(answer.read(int(line.split(b":")[1])))
        assert set(seen) <= set(FRAMES)
        assert len(set(seen)) == 4
        assert time.monotonic() - began > 0.55


def test_other_names_are_not_found_and_not_asked_for() -> None:
    camera = Camera()
    with Preview(["rgb"], camera.latest, ("127.0.0.1", 0)) as preview:
        for path in ("/width", "/../etc/passwd", "/%2e%2e/x.jpg"):
            connection = connect(preview)
            connection.request("GET", path)
            assert connection.getresponse().status == 404
    assert camera.asked == []


def test_a_still_picture() -> None:
    with Preview(["rgb"], lambda _: FRAMES[3], ("127.0.0.1", 0)) as preview:
        connection = connect(preview)
        connection.request("GET", "/rgb.jpg")
        assert connection.getresponse().read() == FRAMES[3]


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:8642", 200),
        ("localhost", 200),
        ("LOCALHOST:8642", 200),
        ("[::1]:8642", 200),
        ("192.168.1.7", 200),
        ("[fe80::1]", 200),
        (f"{socket.gethostname()}:8642", 200),
        ("evil.example:8642", 403),
        ("localhost.evil.example", 403),
        ("127.0.0.1.evil.example", 403),
        ("", 403),
    ],
)
def test_who_asks_for_another_machine_is_not_answered(host: str, status: int) -> None:
    camera = Camera()
    with Preview(["rgb"], camera.latest, ("127.0.0.1", 0)) as preview:
        connection = connect(preview)
        connection.request("GET", "/rgb.jpg", headers={"Host": host})
        answer = connection.getresponse()
        assert answer.status == status
        assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert len(camera.asked) == (status == 200)


def test_who_only_connects_takes_no_more_than_a_share() -> None:
    with Preview(["rgb"], Camera().latest, ("127.0.0.1", 0)) as preview:
        address = urlsplit(preview.url)
        before = threading.active_count()
        idle = [
            socket.create_connection((address.hostname, address.port), timeout=5) for _ in range(80)
        ]
        while len(let_go := select.select(idle, [], [], 5)[0]) < 48:
            assert let_go
        assert threading.active_count() - before <= 32
        for each in idle:
            each.close()
        until = time.monotonic() + 5
        while threading.active_count() > before and time.monotonic() < until:
            time.sleep(0.01)
        connection = connect(preview)
        connection.request("GET", "/")
        assert connection.getresponse().status == 200


def test_ending_does_not_wait_for_viewers() -> None:
    with Preview(["rgb"], Camera().latest, ("127.0.0.1", 0)) as preview:
        connection = connect(preview)
        connection.request("GET", "/rgb")
        connection.getresponse().readline()
        began = time.monotonic()
    assert time.monotonic() - began < 2
    assert "preview" not in {thread.name for thread in threading.enumerate()}


def test_an_address_that_is_taken() -> None:
    with Preview(["rgb"], Camera().latest, ("127.0.0.1", 0)) as preview:
        port = urlsplit(preview.url).port or 0
        with pytest.raises(UsageError, match="cannot use"):
            Preview(["rgb"], Camera().latest, ("127.0.0.1", port))
