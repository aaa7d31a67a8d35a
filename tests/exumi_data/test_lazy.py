"""Cached properties hold no lock while they are worked out."""

import os
import threading
from functools import cached_property

import pytest

from exumi_data.dataset import Dataset
from exumi_data.episode import Episode, StreamView
from exumi_data.lazy import unlocked
from exumi_data.store.images import EncodedFrames, VideoStreamFrames
from exumi_data.store.remote.stores import RemoteFolderStore, RemoteZipStore


@unlocked
class Slow:
    """What waits, as for a server, unless it is told not to."""

    def __init__(self, answer: threading.Event) -> None:
        self.answer = answer
        self.began = threading.Event()

    @cached_property
    def value(self) -> int:
        self.began.set()
        self.answer.wait(20)
        return 7


@pytest.fixture
def waiting() -> "threading.Event":
    """Let a thread wait in the property until the event is set."""
    answer = threading.Event()
    slow = Slow(answer)
    threading.Thread(target=lambda: slow.value, daemon=True).start()
    assert slow.began.wait(5)
    return answer


def at_once() -> int:
    answered = threading.Event()
    answered.set()
    return Slow(answered).value


def test_threads_do_not_wait_for_each_other(waiting: threading.Event) -> None:
    found: list[int] = []
    thread = threading.Thread(target=lambda: found.append(at_once()), daemon=True)
    thread.start()
    thread.join(5)
    waiting.set()
    assert found == [7]


def test_a_fork_does_not_wait_for_a_thread_that_it_has_not(waiting: threading.Event) -> None:
    process = os.fork()
    if process == 0:
        threading.Timer(5, os._exit, [1]).start()
        os._exit(at_once())
    _, status = os.waitpid(process, 0)
    waiting.set()
    assert os.waitstatus_to_exitcode(status) == 7


def test_it_is_worked_out_once() -> None:
    answered = threading.Event()
    answered.set()
    slow = Slow(answered)
    assert slow.value == 7
    slow.began.clear()
    assert slow.value == 7
    assert not slow.began.is_set()


@pytest.mark.parametrize(
    "cls",
    [
        Dataset,
        Episode,
        StreamView,
        EncodedFrames,
        VideoStreamFrames,
        RemoteZipStore,
        RemoteFolderStore,
    ],
)
def test_what_reads_from_servers_holds_none(cls: type) -> None:
    found = [one for one in vars(cls).values() if isinstance(one, cached_property)]
    assert found
    # From Python 3.12 on there is no lock at all.
    assert not any(hasattr(getattr(one, "lock", None), "acquire") for one in found)
