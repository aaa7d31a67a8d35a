"""Problems are told once when they begin, and once when they are over."""

from types import SimpleNamespace

import pytest

from exumi_recorders.recording.status import Problem
from exumi_recorders.session import problems
from exumi_recorders.session.messages import Message
from exumi_recorders.session.problems import ProblemTeller

SILENT = Problem("pose", "no_samples", "No sample has come for 0.6 s.")
STILL_SILENT = Problem("pose", "no_samples", "No sample has come for 1.9 s.")
MAGNET = Problem("encoder", "device", "The encoder sees no magnet.")
GAIN = Problem("encoder", "device", "The encoder's gain is 12, 64 is best.")


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(problems, "time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def test_once_when_it_begins_and_once_when_it_is_over(clock: list[float]) -> None:
    said: list[Message] = []
    teller = ProblemTeller(said.append)
    assert teller.tell([SILENT]) == 1
    assert teller.tell([STILL_SILENT]) == 0
    assert [(one.level, one.code) for one in said] == [("warning", "no_samples")]
    assert said[0].text == "pose: No sample has come for 0.6 s."
    # It comes and goes.
    for _ in range(5):
        clock[0] += 1.9
        assert teller.tell([]) == 0
        clock[0] += 0.1
        assert teller.tell([SILENT]) == 0
    assert len(said) == 1
    clock[0] += 2.1
    teller.tell([])
    assert [(one.level, one.code) for one in said[1:]] == [("info", "no_samples_over")]
    assert teller.tell([SILENT]) == 1


def test_several_of_one_device(clock: list[float]) -> None:
    said: list[Message] = []
    teller = ProblemTeller(said.append)
    assert teller.tell([MAGNET]) == 1
    assert teller.tell([GAIN, MAGNET]) == 1
    assert "12" in said[-1].text
