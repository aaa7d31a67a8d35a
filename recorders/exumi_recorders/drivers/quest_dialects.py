"""What Quest apps send to a hub: one datagram is parsed, or refused with a reason.

Datagrams are ASCII text without a terminator. Poses are x, y, z, qx, qy, qz, qw in Unity's world:
metres, left-handed, y up. *Flag* is ``Y`` while the operator records, else ``N``.

======= ===================== ==================================================================
dialect from                  messages
======= ===================== ==================================================================
a       ARCap                 ``WorldFrame:`` pose; ``RobotFrame:`` pose; flag ``RHand:`` or flag
                              ``LHand:`` hand, head; flag ``BHand:`` left, right, head;
                              ``Start:`` head; ``Stop``; ``Remove``
b       the exUMI app         ``WF,`` pose; ``EE,`` flag ``,`` hand
c       a fork of it          ``worldframe,`` pose; ``EE,`` as in b
d       this project          ``XU,WF,`` pose;
                              ``XU,P,`` sequence, time, flag, side, one or two hands, head;
                              ``XU,E,`` number, t1; ``XU,T,`` number, t1, t2, t3, t4
======= ===================== ==================================================================

Dialect d is for apps that are yet to be written. ``sequence`` counts ``XU,P`` datagrams from 0 and
wraps at 2^32; ``time`` is when the poses held, in nanoseconds of a clock of the headset that never
steps; ``side`` is ``L``, ``R`` or ``B`` (left, then right). The world frame is sent again every
second, so that a lost datagram does not matter. To let the hub compare the two clocks, the headset
sends ``XU,E`` with its time t1 about twice a second; the hub answers at once, to the address that
it came from, ``XU,R,`` number, t1, t2, t3 (received and answered, by the hub's clock); the headset
takes the time t4 at which that arrives, and returns all of it as ``XU,T``.

Numbers are as C# writes them in the invariant culture (``1.5``, ``-2E-05``). An app that uses its
headset's language may write a decimal comma, which cannot be told from a comma between fields: such
datagrams have too many fields and are refused.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite, sqrt
from types import MappingProxyType
from typing import Literal, TypeAlias, get_args

__all__ = [
    "MAX_BYTES",
    "REASONS",
    "SEQUENCE_MODULUS",
    "Command",
    "Dialect",
    "Echo",
    "Frame",
    "Message",
    "Part",
    "Pose",
    "Poses",
    "Reason",
    "Rejected",
    "Trip",
    "format_reply",
    "parse",
]

Dialect: TypeAlias = Literal["a", "b", "c", "d"]
Part: TypeAlias = Literal["hand", "left", "right", "head"]
"""Whose pose it is; ``hand`` where the app does not say which."""
Pose: TypeAlias = tuple[float, ...]
"""x y z qx qy qz qw."""
Reason: TypeAlias = Literal[
    "size",
    "encoding",
    "message",
    "fields",
    "decimal_comma",
    "number",
    "not_finite",
    "range",
    "quaternion",
]
REASONS: tuple[Reason, ...] = get_args(Reason)

MAX_BYTES = 1024
"""The longest message, two hands and a head with every digit, stays far below."""
SEQUENCE_MODULUS = 2**32

_MAX_METRES = 1000.0
_NORMS = (0.5, 2.0)
_FLOAT = re.compile(r"[+-]?(\d{1,40}\.?\d{0,40}|\.\d{1,40})([eE][+-]?\d{1,4})?", re.ASCII)
_WORDS = re.compile(r"[+-]?(nan|inf(inity)?)", re.IGNORECASE)
_WHOLE = re.compile(r"\d{1,19}", re.ASCII)
_HAND = re.compile(r"([YN])([LRB])Hand")


@dataclass(frozen=True, slots=True)
class Poses:
    """Poses of one instant.

    Attributes
    ----------
    dialects : str
        Those that it can be of, such as ``bc``.
    flag : bool
        Whether the operator records.
    poses : mapping of str to tuple of float
    sequence, time_device_ns : int, optional
        Of dialect d.
    """

    dialects: str
    flag: bool
    poses: Mapping[Part, Pose]
    sequence: int | None = None
    time_device_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Frame:
    """A reference frame that the operator has put into the room.

    Attributes
    ----------
    dialects : str
    name : {"world_frame", "robot_frame"}
    pose : tuple of float
    """

    dialects: str
    name: Literal["world_frame", "robot_frame"]
    pose: Pose


@dataclass(frozen=True, slots=True)
class Command:
    """What the operator did; ``stop`` and ``remove`` are repeated until the next ``start``."""

    dialects: str
    name: Literal["start", "stop", "remove"]


@dataclass(frozen=True, slots=True)
class Echo:
    """A headset asks for the hub's time."""

    dialects: str
    number: int
    sent_ns: int


@dataclass(frozen=True, slots=True)
class Trip:
    """An echo that has come back: ``sent_ns`` and ``back_ns`` are the headset's, the rest ours."""

    dialects: str
    number: int
    sent_ns: int
    received_ns: int
    answered_ns: int
    back_ns: int


@dataclass(frozen=True, slots=True)
class Rejected:
    """A datagram that is none of the messages."""

    reason: Reason


Message: TypeAlias = Poses | Frame | Command | Echo | Trip


class _RejectedError(Exception):
    def __init__(self, reason: Reason) -> None:
        self.reason: Reason = reason


def parse(datagram: bytes) -> Message | Rejected:
    """Parse one datagram of any dialect; never raises.

    Parameters
    ----------
    datagram : bytes
    """
    if not 0 < len(datagram) <= MAX_BYTES:
        return Rejected("size")
    try:
        return _message(datagram.decode("ascii"))
    except UnicodeDecodeError:
        return Rejected("encoding")
    except _RejectedError as error:
        return Rejected(error.reason)


def format_reply(echo: Echo, received_ns: int, answered_ns: int) -> bytes:
    """Write the answer to an echo (dialect d).

    Parameters
    ----------
    echo : Echo
    received_ns, answered_ns : int
        CLOCK_MONOTONIC of the hub.
    """
    return f"XU,R,{echo.number},{echo.sent_ns},{received_ns},{answered_ns}".encode("ascii")


def _message(text: str) -> Message:
    head, colon, rest = text.partition(":")
    if colon:
        return _arcap(head, rest.split(","))
    if text in {"Stop", "Remove"}:
        return Command("a", "stop" if text == "Stop" else "remove")
    name, *fields = text.split(",")
    reader = _READERS.get(name)
    if reader is None:
        raise _RejectedError("message")
    return reader(fields)


def _arcap(head: str, fields: list[str]) -> Message:
    hand = _HAND.fullmatch(head)
    if hand is not None:
        side = hand[2]
        return Poses("a", hand[1] == "Y", _parts(side, _poses(fields, 3 if side == "B" else 2)))
    if head == "WorldFrame":
        return Frame("a", "world_frame", _poses(fields, 1)[0])
    if head == "RobotFrame":
        return Frame("a", "robot_frame", _poses(fields, 1)[0])
    if head == "Start":
        _poses(fields, 1)  # where the head is, which every other message says too
        return Command("a", "start")
    raise _RejectedError("message")


def _effector(fields: list[str]) -> Poses:
    flag = _flag(fields[0]) if fields else None
    poses = _poses(fields[1:], 1)
    if flag is None:
        raise _RejectedError("fields")
    return Poses("bc", flag, MappingProxyType({"hand": poses[0]}))


def _own(fields: list[str]) -> Message:
    reader = _OWN_READERS.get(fields[0]) if fields else None
    if reader is None:
        raise _RejectedError("message")
    return reader(fields[1:])


def _own_poses(fields: list[str]) -> Poses:
    if len(fields) < 4:
        raise _RejectedError("fields")
    sequence, time_ns = _whole(fields[0], SEQUENCE_MODULUS), _whole(fields[1], 2**63)
    flag, side = _flag(fields[2]), fields[3]
    if side not in {"L", "R", "B"}:
        raise _RejectedError("fields")
    poses = _poses(fields[4:], 3 if side == "B" else 2)
    return Poses("d", flag, _parts(side, poses), sequence, time_ns)


def _echo(fields: list[str]) -> Echo:
    return Echo("d", *_times(fields, 2))


def _trip(fields: list[str]) -> Trip:
    return Trip("d", *_times(fields, 5))


_READERS: Mapping[str, Callable[[list[str]], Message]] = MappingProxyType(
    {
        "WF": lambda fields: Frame("b", "world_frame", _poses(fields, 1)[0]),
        "worldframe": lambda fields: Frame("c", "world_frame", _poses(fields, 1)[0]),
        "EE": _effector,
        "XU": _own,
    }
)
_OWN_READERS: Mapping[str, Callable[[list[str]], Message]] = MappingProxyType(
    {
        "WF": lambda fields: Frame("d", "world_frame", _poses(fields, 1)[0]),
        "P": _own_poses,
        "E": _echo,
        "T": _trip,
    }
)
_PARTS: Mapping[str, tuple[Part, ...]] = MappingProxyType(
    {"L": ("left", "head"), "R": ("right", "head"), "B": ("left", "right", "head")}
)


def _parts(side: str, poses: list[Pose]) -> Mapping[Part, Pose]:
    return MappingProxyType(dict(zip(_PARTS[side], poses, strict=True)))


def _poses(fields: list[str], count: int) -> list[Pose]:
    if len(fields) != 7 * count:
        # No point anywhere, and more fields than there are numbers.
        commas = len(fields) > 7 * count and not any("." in field for field in fields)
        raise _RejectedError("decimal_comma" if commas else "fields")
    numbers = [_number(field) for field in fields]
    return [_pose(tuple(numbers[i : i + 7])) for i in range(0, len(numbers), 7)]


def _pose(numbers: Pose) -> Pose:
    if max(abs(number) for number in numbers[:3]) > _MAX_METRES:
        raise _RejectedError("range")
    if not _NORMS[0] <= sqrt(sum(min(abs(q), 10.0) ** 2 for q in numbers[3:])) <= _NORMS[1]:
        raise _RejectedError("quaternion")
    return numbers


def _number(field: str) -> float:
    if _FLOAT.fullmatch(field) is None:
        raise _RejectedError("not_finite" if _WORDS.fullmatch(field) else "number")
    value = float(field)
    if not isfinite(value):
        raise _RejectedError("not_finite")
    return value


def _flag(field: str) -> bool:
    if field not in {"Y", "N"}:
        raise _RejectedError("fields")
    return field == "Y"


def _whole(field: str, limit: int) -> int:
    if _WHOLE.fullmatch(field) is None or int(field) >= limit:
        raise _RejectedError("number")
    return int(field)


def _times(fields: list[str], count: int) -> list[int]:
    if len(fields) != count:
        raise _RejectedError("fields")
    return [_whole(field, 2**63) for field in fields]
