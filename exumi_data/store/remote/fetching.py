"""Requests in parallel; in a forked process, through a helper process.

obstore's threads do not survive a fork: its calls would wait for them for ever, and what they wait
on is shared with the program that was forked, which would crash. Workers of a DataLoader are
forked. Such a process starts a fresh interpreter that sends its requests, whoever used obstore
before the fork.
"""

import json
import multiprocessing
import os
import struct
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import IO

from exumi_data import errors
from exumi_data.store.remote.address import Address
from exumi_data.store.remote.requests import Answer, Request, perform
from exumi_data.store.remote.threads import DaemonThreads

__all__ = ["Fetcher", "Outcome", "perform_all", "serve"]

Outcome = Answer | Exception
"""What became of a request: FileNotFoundError or ExumiError, if it failed."""

_PARALLEL = 32
_HEADER = struct.Struct("<IQ")

_is_fork = "obstore" in sys.modules and multiprocessing.parent_process() is not None
"""Whether obstore was loaded before this process was forked: a fact of the whole process.

Where this module is loaded after the fork, a process of `multiprocessing` is taken for one.
"""


def _after_fork() -> None:
    global _is_fork  # noqa: PLW0603  # see above
    _is_fork = "obstore" in sys.modules


os.register_at_fork(after_in_child=_after_fork)


class Fetcher:
    """Sends requests, many at a time. One for each process.

    Attributes
    ----------
    requests : int
        How many were sent.
    """

    def __init__(self) -> None:
        self.requests = 0
        self._threads: DaemonThreads | None = None
        self._helper: _Helper | None = None
        self._lock = threading.Lock()

    def fetch(self, requests: Sequence[Request]) -> list[Outcome]:
        """Send requests in parallel; return what became of each, in their order."""
        with self._lock:
            self.requests += len(requests)
            if _is_fork:
                return self._through_helper(requests)
            if self._threads is None:
                self._threads = DaemonThreads(_PARALLEL, "exumi-remote")
        return perform_all(requests, self._threads)

    def _through_helper(self, requests: Sequence[Request]) -> list[Outcome]:
        helper = self._helper = self._helper or _Helper()
        try:
            return helper.fetch(requests)
        except BaseException:  # after Ctrl-C, the answers that are left would be taken for others
            self._helper = None
            helper.stop()
            raise


def perform_all(requests: Sequence[Request], threads: DaemonThreads) -> list[Outcome]:
    """Send requests, several at a time.

    Even one goes through a thread: obstore does not hear Ctrl-C while it waits for a server.
    """
    coming = [threads.submit(_outcome, request) for request in requests]
    try:
        return [future.result() for future in coming]
    finally:
        for future in coming:  # those that were not sent yet, where this was interrupted
            future.cancel()


def _outcome(request: Request) -> Outcome:
    try:
        return perform(request)
    except (FileNotFoundError, errors.ExumiError) as error:
        return error


class _Helper:
    """A fresh process that sends requests for this one; it ends when this one does."""

    def __init__(self) -> None:
        # Its modules are where ours are, however we found them; and nothing in the current folder,
        # which may be somebody's data, is a module (-P).
        path = os.pathsep.join(entry for entry in sys.path if entry)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "exumi_data.store.remote.helper"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": path},
        )

    def stop(self) -> None:
        """End it now."""
        self._process.kill()
        with suppress(OSError), self._process:  # which closes its pipes, and waits for its end
            pass

    def fetch(self, requests: Sequence[Request]) -> list[Outcome]:
        """Send requests through the helper."""
        sender, answers = self._process.stdin, self._process.stdout
        assert sender is not None  # noqa: S101  # both are pipes
        assert answers is not None  # noqa: S101
        words = [(r.kind, *_words(r.address), r.start, r.length) for r in requests]
        try:
            sender.write(json.dumps(words).encode() + b"\n")
            sender.flush()
            return [_receive(answers) for _ in requests]
        except (OSError, struct.error) as error:
            raise errors.UnreachableError(
                f"the process that reads remote data ended ({error})", fix="Try again."
            ) from None


def _words(address: Address) -> tuple[str, str, str, str]:
    return address.root, address.key, address.query, address.user


def serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer batches of requests until there are no more: what the helper does.

    Parameters
    ----------
    requests : binary file
        A JSON list of requests a line.
    answers : binary file
        For each request lengths, a JSON list that says what became of it, and its data.
    """
    threads = DaemonThreads(_PARALLEL, "exumi-remote")
    for line in requests:
        batch = [
            Request(kind, Address(root, key, query, user), start, length)
            for kind, root, key, query, user, start, length in json.loads(line)
        ]
        for outcome in perform_all(batch, threads):
            _send(answers, outcome)
        answers.flush()


def _send(answers: IO[bytes], outcome: Outcome) -> None:
    data = b""
    if isinstance(outcome, Answer):
        data, words = outcome.data, ["", outcome.size, outcome.tag, None]
    elif isinstance(outcome, errors.ExumiError):
        words = [type(outcome).__name__, outcome.what, outcome.where, outcome.fix]
    else:
        words = ["FileNotFoundError", str(outcome), None, None]
    header = json.dumps(words).encode()
    answers.write(_HEADER.pack(len(header), len(data)) + header + data)


def _receive(answers: IO[bytes]) -> Outcome:
    header, length = _HEADER.unpack(answers.read(_HEADER.size))
    name, first, second, third = json.loads(answers.read(header))
    if not name:
        return Answer(answers.read(length), first, second)
    if name == "FileNotFoundError":
        return FileNotFoundError(first)
    kind: type[errors.ExumiError] = getattr(errors, name)
    return kind(first, where=second, fix=third)
