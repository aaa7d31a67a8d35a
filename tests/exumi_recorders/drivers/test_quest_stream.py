"""Datagrams in, samples and events out: what needs times of its own, not a network."""

import pytest

from exumi_recorders.contract import Event, Sample
from exumi_recorders.drivers.quest_options import QuestOptions
from exumi_recorders.drivers.quest_report import problems_of, readings_of
from exumi_recorders.drivers.quest_stream import QuestStream
from exumi_recorders.drivers.stamped_udp import Datagram

S = 1_000_000_000
MS = 1_000_000
HEAD = "0,1.6,0,0,0,0,1"


class Feed:
    """A stream, and a clock that runs while datagrams come."""

    def __init__(self, **options: object) -> None:
        self.replies: list[tuple[bytes, tuple[str, int]]] = []
        self.stream = QuestStream(
            QuestOptions.model_validate(options), lambda data, to: self.replies.append((data, to))
        )
        self.now_ns = 100 * S

    def __call__(
        self, *texts: str, sender: str = "10.0.0.2", wait_ns: int = 10 * MS
    ) -> list[Sample | Event]:
        found = []
        for text in texts:
            self.now_ns += wait_ns
            found += self.stream.take(Datagram(text.encode(), self.now_ns, (sender, 5000)))
        return found

    def events(self, *texts: str, **said: object) -> list[tuple[str, dict[str, object]]]:
        found = self(*texts, **said)  # type: ignore[arg-type]  # passed on
        return [(each.name, dict(each.detail)) for each in found if isinstance(each, Event)]

    def ports(self, *texts: str) -> list[str]:
        return [each.port for each in self(*texts) if isinstance(each, Sample)]

    def problems(self, after_ns: int = 0) -> list[str]:
        return problems_of(self.stream, 100 * S, self.now_ns + after_ns)


def ee(x: float, flag: str = "N") -> str:
    return f"EE,{flag},{x},1,0,0,0,0,1"


def test_silence_is_told_after_a_second() -> None:
    feed = Feed()
    assert feed.problems(999 * MS) == []
    assert "No pose has come for 1 s" in feed.problems(1001 * MS)[0]
    feed("WF,0,0,0,0,0,0,1", ee(0))
    assert feed.problems(999 * MS) == []
    assert "No pose has come" in feed.problems(1001 * MS)[0]
    assert readings_of(feed.stream, feed.now_ns + 250 * MS)["age_s"] == 0.25


def test_a_pose_is_frozen_after_half_a_second() -> None:
    feed = Feed()
    feed("WF,0,0,0,0,0,0,1", *[ee(0)] * 51)
    assert feed.problems() == []
    feed(ee(0))
    assert "pose has been the same for 0.5 s" in feed.problems()[0]
    feed(ee(0.001))
    assert feed.problems() == []


def test_a_jump_is_further_than_a_hand_moves() -> None:
    feed = Feed()
    feed("WF,0,0,0,0,0,0,1")
    assert feed.events(ee(0), ee(0.199)) == [], "20 m/s, but too short to be a jump"
    assert feed.events(ee(0.6), wait_ns=100 * MS) == [], "0.4 m in 0.1 s"
    (jump,) = feed.events(ee(1.2))
    assert jump[0] == "pose_jump"
    assert jump[1]["distance_m"] == pytest.approx(0.6)
    assert "jumped by 0.60 m" in feed.problems()[0]
    feed(ee(0.61))
    assert feed.problems() == [], "it has jumped back"
    feed(ee(2))
    assert feed.problems()
    assert feed.events("WF,0,0,0,0,0,0,1") == [], "the same as before: nothing is mended"
    assert feed.problems()
    assert feed.events("WF,1,0,0,0,0,0,1")[0][0] == "world_frame"
    assert feed.problems() == []
    assert readings_of(feed.stream, feed.now_ns)["jumps"] == 3


def test_the_flag_counts_from_its_first_datagram() -> None:
    feed = Feed()
    feed(ee(0), ee(0, "Y"), ee(0), ee(0, "Y"), ee(0, "Y"))
    first_ns = feed.now_ns - 10 * MS
    (event,) = (each for each in feed(ee(0, "Y")) if isinstance(each, Event))
    assert (event.name, event.detail, event.time_host_ns) == ("record_flag", {"on": True}, first_ns)


def test_a_flag_that_is_on_from_the_start_is_told() -> None:
    assert ("record_flag", {"on": True}) in Feed().events(*[ee(0, "Y")] * 3)


def test_commands_of_arcap() -> None:
    feed = Feed()
    pose = f"YRHand:{HEAD},{HEAD}"
    assert feed.events(f"Start:{HEAD}", pose, pose)[1:] == [("record_flag", {"on": True})]
    still = f"NRHand:{HEAD},{HEAD}"
    found = feed.events(still, "Remove", still, "Remove", still, "Remove", "Stop", "Remove")
    assert found == [("remove", {}), ("record_flag", {"on": False}), ("remove", {})]
    assert feed.events(f"RobotFrame:{HEAD}")[0][0] == "robot_frame"
    assert "world_frame" not in feed.stream.frames


def test_the_dialect_is_narrowed_down() -> None:
    feed = Feed()
    assert feed.events(ee(0)) == [("dialect", {"dialect": "b or c"})]
    assert feed.events("worldframe,0,0,0,0,0,0,1")[0] == ("dialect", {"dialect": "c"})
    assert feed.events(ee(0), "worldframe,0,0,0,0,0,0,1") == []


def test_another_dialect_is_taken_once_the_first_is_silent() -> None:
    feed = Feed()
    feed("WF,0,0,0,0,0,0,1", ee(0))
    own = f"XU,P,0,0,N,R,{HEAD},{HEAD}"
    assert feed(own) == []
    assert feed.stream.rejected["dialect"] == 1
    assert "another dialect" in feed.problems()[0]
    assert feed.events(own, wait_ns=2001 * MS)[0] == ("dialect", {"dialect": "d"})


def test_a_stated_dialect_is_kept_to() -> None:
    feed = Feed(dialect="c")
    assert feed(ee(0)) != []
    assert feed("WF,0,0,0,0,0,0,1", wait_ns=10 * S) == []
    assert feed.stream.rejected["dialect"] == 1
    assert feed.events("worldframe,0,0,0,0,0,0,1")[0][0] == "world_frame"


LEFT, RIGHT, BOTH = f"NLHand:{HEAD},{HEAD}", f"NRHand:{HEAD},{HEAD}", f"NBHand:{HEAD},{HEAD},{HEAD}"


@pytest.mark.parametrize(
    ("options", "texts", "ports"),
    [
        ({}, [LEFT, RIGHT, LEFT], ["pose", "headset", "pose", "headset"]),
        ({}, [BOTH], []),
        ({"headset": False}, [RIGHT, LEFT, RIGHT], ["pose", "pose"]),
        ({"hand": "left"}, [LEFT, RIGHT, BOTH], ["pose", "headset", "pose", "headset"]),
        ({"hand": "right", "headset": False}, [LEFT, RIGHT, BOTH], ["pose", "pose"]),
        ({"hand": "left"}, [ee(0)], ["pose"]),
        ({"hand": "both", "headset": False}, [LEFT, RIGHT], ["pose_left", "pose_right"]),
        ({"hand": "both"}, [BOTH], ["pose_left", "pose_right", "headset"]),
        ({"hand": "both"}, [ee(0)], []),
    ],
)
def test_hands(options: dict[str, object], texts: list[str], ports: list[str]) -> None:
    feed = Feed(**options)
    assert feed.ports(*texts) == ports
    samples = len(ports) // (2 if "headset" in ports else 1)
    if "pose_left" not in ports:
        assert feed.stream.rejected["hand"] == len(texts) - samples
    assert any("another hand" in problem for problem in feed.problems()) == (
        feed.stream.rejected["hand"] > 0
    )


def test_a_second_headset_is_heard_when_the_first_is_silent() -> None:
    feed = Feed()
    feed(ee(0))
    feed(ee(5), sender="10.0.0.3")
    assert feed.stream.rejected == {"sender": 1}
    assert "More than one headset" in " ".join(feed.problems())
    assert feed(ee(0), sender="10.0.0.3", wait_ns=2001 * MS) != []
    assert readings_of(feed.stream, feed.now_ns)["sender"] == "10.0.0.3"


def test_what_a_stranger_sends_keeps_no_headset_out() -> None:
    feed = Feed()
    feed("hello", sender="10.0.0.9")
    assert feed(ee(0)) != []
    assert "refused: message" in " ".join(feed.problems())
    assert not any("refused" in problem for problem in feed.problems(5001 * MS))


def test_late_poses_say_nothing_about_now() -> None:
    feed = Feed()
    far = "5,1.6,0,0,0,0,1"
    feed(*(f"XU,P,{n},{n},N,R,{HEAD},{HEAD}" for n in (0, 1, 2, 4)))
    (late, _) = feed(f"XU,P,3,3,Y,R,{far},{HEAD}")
    assert isinstance(late, Sample)
    assert late.flags == 2
    assert feed.stream.watches["pose"].jumps == 0
    assert feed(f"XU,P,3,3,Y,R,{far},{HEAD}") == []
    assert feed.stream.sequence.lost == 0


def test_an_app_that_starts_again() -> None:
    feed = Feed()
    feed(*(f"XU,P,{n},{n},N,R,{HEAD},{HEAD}" for n in range(30)))
    assert feed.events(f"XU,P,0,99,N,R,{HEAD},{HEAD}") == [("restart", {})]


def test_an_echo_is_answered_to_whom_it_came_from() -> None:
    feed = Feed()
    feed("XU,E,4,777")
    ((data, to),) = feed.replies
    name, kind, number, sent, received, answered = data.decode().split(",")
    assert (name, kind, number, sent, to) == ("XU", "R", "4", "777", ("10.0.0.2", 5000))
    assert int(received) == feed.now_ns
    assert int(answered) > 0


def test_round_trips_are_checked() -> None:
    feed = Feed()
    t2 = feed.now_ns
    feed(f"XU,T,1,1000,{t2},{t2 + 50},{1000 + 50 + 4 * MS}")
    found = readings_of(feed.stream, feed.now_ns)
    assert found["clock_offset_ns"] == t2 - 1000 - 2 * MS
    assert found["round_trip_ms"] == 4
    assert found["clock_offset_sigma_ns"] == pytest.approx(4 * MS / 12**0.5, abs=1)
    feed(f"XU,T,1,1000,{t2},{t2 - 1},2000", f"XU,T,1,1000,{t2 + S},{t2 + S},2000")
    assert feed.stream.rejected["trip"] == 2
    assert "clock_offset_ns" not in readings_of(feed.stream, feed.now_ns + 11 * S)


def test_the_clock_is_told_every_ten_seconds() -> None:
    feed = Feed()
    told = []
    for _ in range(25):
        t2 = feed.now_ns
        found = feed(f"XU,T,1,{t2 - 500 - MS},{t2},{t2 + 50},{t2 - 500 + MS}")
        told += [event for event in found if isinstance(event, Event) and event.name == "clock"]
        feed.now_ns += S
    assert len(told) == 3
    for event in told:
        assert event.detail["clock_offset_ns"] == pytest.approx(500, abs=100)
        assert event.detail["round_trip_ms"] == pytest.approx(2, abs=0.1)


def test_the_drift_of_the_headsets_clock() -> None:
    feed = Feed()
    for n in range(2000):
        feed(f"XU,P,{n},{round(n * 10 * MS * (1 - 40e-6))},N,R,{HEAD},{HEAD}")
    found = readings_of(feed.stream, feed.now_ns)
    assert found["clock_drift_ppm"] == pytest.approx(40, abs=0.1)
