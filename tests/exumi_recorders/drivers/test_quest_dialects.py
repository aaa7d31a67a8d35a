"""One datagram of a headset."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_recorders.drivers.quest_dialects import (
    Command,
    Echo,
    Frame,
    Message,
    Poses,
    Rejected,
    Trip,
    format_reply,
    parse,
)

ONE = "0.1,1.25,-2E-05,0,0.6,0,0.8"
POSE = (0.1, 1.25, -2e-5, 0.0, 0.6, 0.0, 0.8)
TWO = "1,2,3,0,0,0,1"
POSE_2 = (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
HEAD = "0,1.6,0,0,0,0,-1"
POSE_3 = (0.0, 1.6, 0.0, 0.0, 0.0, 0.0, -1.0)
VALID: dict[str, Message] = {
    f"WorldFrame:{ONE}": Frame("a", "world_frame", POSE),
    f"RobotFrame:{ONE}": Frame("a", "robot_frame", POSE),
    f"YRHand:{ONE},{HEAD}": Poses("a", True, {"right": POSE, "head": POSE_3}),
    f"NLHand:{ONE},{HEAD}": Poses("a", False, {"left": POSE, "head": POSE_3}),
    f"NBHand:{ONE},{TWO},{HEAD}": Poses(
        "a", False, {"left": POSE, "right": POSE_2, "head": POSE_3}
    ),
    f"Start:{HEAD}": Command("a", "start"),
    "Stop": Command("a", "stop"),
    "Remove": Command("a", "remove"),
    f"WF,{ONE}": Frame("b", "world_frame", POSE),
    f"EE,Y,{ONE}": Poses("bc", True, {"hand": POSE}),
    f"EE,N,{TWO}": Poses("bc", False, {"hand": POSE_2}),
    f"worldframe,{TWO}": Frame("c", "world_frame", POSE_2),
    f"XU,WF,{ONE}": Frame("d", "world_frame", POSE),
    f"XU,P,4294967295,123,Y,R,{ONE},{HEAD}": Poses(
        "d", True, {"right": POSE, "head": POSE_3}, 4294967295, 123
    ),
    f"XU,P,0,9223372036854775807,N,B,{ONE},{TWO},{HEAD}": Poses(
        "d", False, {"left": POSE, "right": POSE_2, "head": POSE_3}, 0, 2**63 - 1
    ),
    "XU,E,7,1000": Echo("d", 7, 1000),
    "XU,T,7,1000,5,6,1009": Trip("d", 7, 1000, 5, 6, 1009),
}


@pytest.mark.parametrize("text", VALID, ids=lambda text: text.split(".")[0])
def test_every_message(text: str) -> None:
    assert parse(text.encode()) == VALID[text]


@pytest.mark.parametrize(
    ("datagram", "reason"),
    [
        (b"", "size"),
        (b"EE,Y," + b"0" * 1024, "size"),
        ("EE,Y,１,2,3,0,0,0,1".encode(), "encoding"),
        (b"\x00\xff", "encoding"),
        (b"hello", "message"),
        (b"ee,Y," + TWO.encode(), "message"),
        (b"YXHand:" + TWO.encode(), "message"),
        (b"XU", "message"),
        (b"XU,Z,1", "message"),
        (b"Stop ", "message"),
        (b"EE", "fields"),
        (b"EE,Y", "fields"),
        (b"EE,X," + TWO.encode(), "fields"),
        (b"EE,Y,1,2,3,0,0,0", "fields"),
        (b"EE,Y,1.0,2,3,0,0,0,1,5", "fields"),
        (b"YRHand:" + TWO.encode(), "fields"),
        (b"XU,P,1,2,Y,L," + TWO.encode(), "fields"),
        (b"XU,P,1,2,Y,X," + f"{TWO},{HEAD}".encode(), "fields"),
        (b"XU,E,1", "fields"),
        (b"XU,E,1,2,3", "fields"),
        (b"EE,Y,0,1,1,25,-2,1E-05,0,0,6,0,0,8", "decimal_comma"),
        (b"WF,0,1,1,25,-2,1,0,1,0,0,1", "decimal_comma"),
        (b"YRHand:0,1,1,25,-2,1,0,1,0,0,1,0,1,1,25,-2,1,0,1,0,0,1", "decimal_comma"),
        (b"EE,Y,1,2,x,0,0,0,1", "number"),
        (b"EE,Y,1,2,,0,0,0,1", "number"),
        (b"EE,Y,1,2,1_0,0,0,0,1", "number"),
        (b"EE,Y, 1,2,3,0,0,0,1", "number"),
        (b"EE,Y,1,2,0x1,0,0,0,1", "number"),
        (b"EE,Y,1,2,3,0,0,0,1\n", "number"),
        (b"XU,E,-1,5", "number"),
        (b"XU,E,1,9223372036854775808", "number"),
        (b"XU,P,4294967296,2,Y,L," + f"{TWO},{HEAD}".encode(), "number"),
        (b"EE,Y,NaN,2,3,0,0,0,1", "not_finite"),
        (b"EE,Y,1,-Infinity,3,0,0,0,1", "not_finite"),
        (b"EE,Y,1,1e999,3,0,0,0,1", "not_finite"),
        (b"EE,Y,1000.1,2,3,0,0,0,1", "range"),
        (b"EE,Y,1,2,3,0,0,0,0", "quaternion"),
        (b"EE,Y,1,2,3,0,0,0,0.49", "quaternion"),
        (b"EE,Y,1,2,3,0,0,0,2.01", "quaternion"),
        (b"EE,Y,1,2,3,0,0,0,1e200", "quaternion"),
        (b"YRHand:" + f"{TWO},0,0,0,0,0,0,0".encode(), "quaternion"),
    ],
)
def test_what_is_refused(datagram: bytes, reason: str) -> None:
    assert parse(datagram) == Rejected(reason)  # type: ignore[arg-type]  # parametrize has strings


@pytest.mark.parametrize("edge", ["0.5", "2", "-1", "5E-1"])
def test_quaternions_need_not_have_unit_length(edge: str) -> None:
    assert isinstance(parse(f"EE,Y,1,2,3,0,0,0,{edge}".encode()), Poses)


def check_result(result: Message | Rejected) -> None:
    frames = result.poses.values() if isinstance(result, Poses) else ()
    for pose in (*frames, *((result.pose,) if isinstance(result, Frame) else ())):
        assert len(pose) == 7
        assert all(math.isfinite(number) for number in pose)


@given(st.binary(max_size=1100))
def test_no_bytes_raise(datagram: bytes) -> None:
    check_result(parse(datagram))


@given(
    st.sampled_from(sorted(VALID)),
    st.lists(
        st.tuples(st.integers(0, 200), st.integers(0, 3), st.sampled_from("0159,.:-+eENYXR ")),
        max_size=6,
    ),
)
def test_no_spoiled_message_raises(text: str, edits: list[tuple[int, int, str]]) -> None:
    for place, cut, letter in edits:
        text = text[:place] + letter + text[place + cut :]
    check_result(parse(text.encode()))


@given(st.lists(st.floats(-999, 999, width=32), min_size=3, max_size=3), st.booleans())
def test_numbers_arrive_as_they_were_written(place: list[float], flag: bool) -> None:
    text = ",".join(repr(number).upper() for number in place)
    found = parse(f"EE,{'Y' if flag else 'N'},{text},0,0,0,1".encode())
    assert found == Poses("bc", flag, {"hand": (*place, 0.0, 0.0, 0.0, 1.0)})


def test_the_answer_to_an_echo() -> None:
    assert format_reply(Echo("d", 3, 17), 100, 101) == b"XU,R,3,17,100,101"
