"""Joining a Ray cluster, or starting one on this machine for as long as it is needed."""

import fcntl
import logging
import os
import secrets
import shutil
import signal
import socket
import stat
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from exumi_data.engine.local import default_workers
from exumi_data.errors import MissingExtraError, UsageError

__all__ = ["access_token", "cluster", "find_cluster", "ray_module"]

_ADDRESS = "RAY_ADDRESS"
_ANSWERS_WITHIN_S = 10.0
# Only results wait in it, most of which are too small for it; Ray accepts no less.
_STORE_BYTES = 80 << 20
# Its sockets lie in it, about 65 characters deeper, and their paths have room for 107.
_LONGEST_FOLDER = 40
# What a client of HTTP/2 says first, and the settings that both sides begin with.
_SETTINGS = b"\0\0\0\4\0\0\0\0\0"
_HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + _SETTINGS
_PREFIX = "exumi-ray-"
_IN_USE = "in-use"
_JUST_MADE_S = 60.0


@contextmanager
def cluster(address: str | None, workers: int | None) -> Iterator[bool]:
    """Be part of a Ray cluster while the block runs.

    Parameters
    ----------
    address : str, optional
        ``host:port``, ``auto`` for the cluster that runs on this machine, or ``local`` for one of
        our own. Default: what RAY_ADDRESS says, else the cluster that runs on this machine, else
        one of our own.
    workers : int, optional
        Processors of a cluster of our own; default all cores.

    Yields
    ------
    bool
        Whether it is one of our own.

    Raises
    ------
    MissingExtraError
        Ray is not installed.
    UsageError
        No cluster can be joined there.
    """
    ray = ray_module()
    if ray.is_initialized():
        # A program that has joined a cluster works on that one, and leaves it when it likes.
        yield False
        return
    found = find_cluster(address)
    handler = signal.getsignal(signal.SIGTERM)
    with _own_folder(needed=found is None) as folder, _without_messages(ray):
        try:
            if folder is not None:
                _start(ray, folder, workers)
            else:
                _join(ray, str(found))
            # Ray sets one of its own, after which a program that is told to end would not tidy up.
            _set_handler(handler)
            yield folder is not None
        finally:
            with _undisturbed():
                ray.shutdown()
            _set_handler(handler)


def ray_module() -> Any:
    """Return the module `ray`.

    Raises
    ------
    MissingExtraError
        It is not installed.
    """
    try:
        import ray
    except ModuleNotFoundError:
        raise MissingExtraError(
            "Ray is not installed", fix='Say: pip install "exumi-data[ray]"'
        ) from None
    return ray


def access_token() -> dict[str, str]:
    """Return the environment of a process whose own cluster nobody else can use.

    Ray listens on all interfaces, and whoever reaches it can run programs. It reads this when it is
    imported and keeps it: only a process that works on one cluster can have it.

    Returns
    -------
    dict of str to str
        Nothing where the user has said how Ray is to guard itself.
    """
    if "RAY_AUTH_MODE" in os.environ:
        return {}
    return {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}


def find_cluster(address: str | None) -> str | None:
    """Find the cluster to join.

    Parameters
    ----------
    address : str, optional
        As of `cluster`.

    Returns
    -------
    str or None
        ``host:port`` of its head; None if there is none, and one has to be started.

    Raises
    ------
    UsageError
        Nothing answers at an address that was given.
    """
    given = address or os.environ.get(_ADDRESS) or ""
    if given == "local":
        return None
    if "://" in given:
        raise UsageError(
            f"{given} is the address of a Ray client, which sees other files than the cluster",
            fix="Run the command on a node of the cluster, and name its head as host:port.",
        )
    found, reason = given, None
    if given in ("", "auto"):
        found, reason = _running(), "none was started on this machine"
    if found:
        reason = _reason_not_to(found)
    if reason is None:
        return found
    if not given:
        return None
    raise UsageError(
        f"no Ray cluster at {given}: {reason}",
        fix="Start one with: ray start --head. Or say local: one is started on this machine for as "
        "long as the command runs.",
    )


def _running() -> str:
    """Return where ``ray start`` last started a cluster on this machine, or nothing."""
    parent = os.environ.get("RAY_TMPDIR") or os.environ.get("TMPDIR") or "/tmp"  # noqa: S108  # only read, and Ray writes it there
    try:
        return Path(parent, "ray", "ray_current_cluster").read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def _reason_not_to(address: str) -> str | None:
    """Say why a cluster cannot be joined; Ray itself would try for a minute."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        return "that is not like host:port"
    where = host.strip("[]"), int(port)
    try:
        with socket.create_connection(where, _ANSWERS_WITHIN_S) as connection:
            if os.environ.get("RAY_USE_TLS", "0") in ("", "0") and not _speaks_http2(connection):
                return "something else listens there"
    except OSError as error:
        return str(error.strerror or error)
    return None


def _speaks_http2(connection: socket.socket) -> bool:
    """Whether it is answered as by Ray's servers, whose protocol begins so."""
    connection.sendall(_HELLO)
    answer = b""
    while len(answer) < len(_SETTINGS) and (more := connection.recv(64)):
        answer += more
    return answer[3:4] == _SETTINGS[3:4]


def _join(ray: Any, address: str) -> None:
    try:
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise UsageError(
            f"the Ray cluster at {address} cannot be joined: {str(error).strip()}",
            fix="Run the command on a node of the cluster (ray start --address), with the same "
            "versions of Python and Ray.",
        ) from None


def _start(ray: Any, folder: str, workers: int | None) -> None:
    with _without_telemetry():
        ray.init(
            address="local",
            num_cpus=workers or default_workers(),
            num_gpus=0,
            include_dashboard=False,
            object_store_memory=_STORE_BYTES,
            logging_level=logging.ERROR,
            log_to_driver=False,
            _temp_dir=folder,
        )


@contextmanager
def _without_messages(ray: Any) -> Iterator[None]:
    """Keep what Ray says of workers that died from stdout, where results go."""
    worker = ray._private.worker
    name = "_worker_logs_enabled"  # no public way
    before = getattr(worker, name, True)
    setattr(worker, name, False)
    try:
        yield
    finally:
        setattr(worker, name, before)


@contextmanager
def _without_telemetry() -> Iterator[None]:
    """Tell the processes that are started meanwhile to report nothing to anybody."""
    name = "RAY_USAGE_STATS_ENABLED"
    before = os.environ.get(name)
    os.environ[name] = "0"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


@contextmanager
def _own_folder(*, needed: bool) -> Iterator[str | None]:
    """Make a folder for a cluster of our own, and remove those of programs that were killed."""
    if not needed:
        yield None
        return
    parent = tempfile.gettempdir()
    if len(parent) > _LONGEST_FOLDER - len("/exumi-ray-12345678"):
        parent = "/tmp"  # noqa: S108  # mkdtemp makes a folder in it that is ours alone
    _remove_left_behind(Path(parent))
    folder = tempfile.mkdtemp(prefix=_PREFIX, dir=parent)
    try:
        # Held as long as this process lives, however it ends; those it starts do not inherit it.
        with Path(folder, _IN_USE).open("xb") as mark:
            fcntl.flock(mark, fcntl.LOCK_EX)
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _remove_left_behind(parent: Path) -> None:
    """Remove folders of this user's whose program is gone."""
    for folder in parent.glob(f"{_PREFIX}*"):
        with suppress(OSError):
            info = folder.lstat()
            if not stat.S_ISDIR(info.st_mode) or info.st_uid != os.getuid():
                continue
            with Path(folder, _IN_USE).open("rb") as mark:
                if time.time() - os.fstat(mark.fileno()).st_mtime < _JUST_MADE_S:
                    continue  # somebody may be about to lock it
                fcntl.flock(mark, fcntl.LOCK_EX | fcntl.LOCK_NB)  # raises where one is alive
                shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Pass over a second Ctrl-C for a moment: Ray's processes would be left behind."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _set_handler(handler: Any) -> None:
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)
