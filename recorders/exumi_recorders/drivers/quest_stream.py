"""From a headset's datagrams to samples and events, and what they tell about the headset."""

import struct
import time
from collections import Counter
from collections.abc import Callable
from math import dist

from exumi_data.standard.registry import flags
from exumi_recorders.contract import Event, Sample
from exumi_recorders.drivers.quest_clock import ClockWatch
from exumi_recorders.drivers.quest_dialects import (
    SEQUENCE_MODULUS,
    Command,
    Echo,
    Frame,
    Message,
    Part,
    Pose,
    Poses,
    Rejected,
    Trip,
    format_reply,
    parse,
)
from exumi_recorders.drivers.quest_options import QuestOptions, port_names
from exumi_recorders.drivers.quest_sequence import SequenceWatch
from exumi_recorders.drivers.quest_watch import (
    FlagWatch,
    PoseWatch,
    RateWatch,
    SenderWatch,
)
from exumi_recorders.drivers.stamped_udp import Datagram

__all__ = ["QuestStream"]

_ANOTHER_AFTER_NS = 2_000_000_000
_CLOCK_EVERY_NS = 10_000_000_000
_POSE = struct.Struct("<7d")
_SIDES = ("left", "right")

Found = list[Sample | Event]


class QuestStream:
    """Takes datagrams one by one; keeps only what the next ones are judged by.

    Parameters
    ----------
    options : QuestOptions
    reply : callable
        Sends a datagram to an address.

    Attributes
    ----------
    dialects : str
        Those that it can be by what has come, such as ``bc``; empty before.
    rejected : Counter
        Datagrams that were refused, by reason.
    rejected_ns : dict
        When one was last refused, by reason.
    sender, flag, rate, sequence, clock
        See there.
    frames : dict
        The world frame, and what else the operator has put into the room, by name.
    watches : dict
        One for each port.
    """

    def __init__(
        self, options: QuestOptions, reply: Callable[[bytes, tuple[str, int]], None]
    ) -> None:
        self.options = options
        self._reply = reply
        self.dialects = "" if options.dialect == "auto" else str(options.dialect)
        self.rejected: Counter[str] = Counter()
        self.rejected_ns: dict[str, int] = {}
        self.sender = SenderWatch(options.sender)
        self.flag = FlagWatch()
        self.rate = RateWatch()
        self.sequence = SequenceWatch(SEQUENCE_MODULUS)
        self.clock = ClockWatch()
        self.frames: dict[str, Pose] = {}
        self.watches = {name: PoseWatch(options.jump_m) for name in port_names(options)}
        self._dialect_ns = 0
        self._clock_ns: int | None = None
        self._side: Part | None = None
        self._head: Pose | None = None
        self._command: str | None = None

    @property
    def from_headset_m(self) -> float | None:
        """How far the controller is from the headset, metres; None where that is not sent."""
        head = self._head
        if head is None:
            return None
        hands = [watch.latest for name, watch in self.watches.items() if name != "headset"]
        return max((dist(head[:3], hand[:3]) for hand in hands if hand is not None), default=None)

    def take(self, datagram: Datagram) -> Found:
        """Return the samples and events of the next datagram.

        Parameters
        ----------
        datagram : Datagram
        """
        time_ns = datagram.time_ns
        message = parse(datagram.data)
        if isinstance(message, Rejected):
            return self._reject(message.reason, time_ns)
        if not self.sender.take(time_ns, datagram.sender[0]):
            return self._reject("sender", time_ns)
        found = self._narrow(message.dialects, time_ns)
        if found is None:
            return self._reject("dialect", time_ns)
        if isinstance(message, Echo):
            answer = format_reply(message, time_ns, time.monotonic_ns())
            self._reply(answer, datagram.sender)
            return found
        return found + self._read(message, time_ns)

    def _read(self, message: Message, time_ns: int) -> Found:
        if isinstance(message, Poses):
            return self._read_poses(message, time_ns)
        if isinstance(message, Frame):
            return self._read_frame(message, time_ns)
        if isinstance(message, Command):
            return self._read_command(message, time_ns)
        return self._read_trip(message, time_ns) if isinstance(message, Trip) else []

    def _read_trip(self, message: Trip, time_ns: int) -> Found:
        if not self.clock.take_trip(message, time_ns):
            return self._reject("trip", time_ns)
        if self._clock_ns is not None and time_ns - self._clock_ns < _CLOCK_EVERY_NS:
            return []
        self._clock_ns = time_ns
        return [Event("clock", time_ns, self.clock.readings(time_ns))]

    def _reject(self, reason: str, time_ns: int) -> Found:
        self.rejected[reason] += 1
        self.rejected_ns[reason] = time_ns
        return []

    def _narrow(self, dialects: str, time_ns: int) -> Found | None:
        """Find out which dialect it is; None for another than that which is being sent."""
        common = "".join(dialect for dialect in dialects if dialect in self.dialects)
        if not common and self.dialects:
            silent = time_ns - self._dialect_ns > _ANOTHER_AFTER_NS
            if self.options.dialect != "auto" or not silent:
                return None
        self._dialect_ns = time_ns
        if common == self.dialects and common:
            return []
        self.dialects = common or dialects
        return [Event("dialect", time_ns, {"dialect": " or ".join(self.dialects)})]

    def _read_poses(self, message: Poses, time_ns: int) -> Found:
        named = self._named(message)
        if not named:
            return self._reject("hand", time_ns)
        found: Found = []
        late = False
        if message.sequence is not None and message.time_device_ns is not None:
            order = self.sequence.take(message.sequence, message.time_device_ns)
            if order == "twice":
                return self._reject("twice", time_ns)
            if order == "restart":
                self.clock.restart()
                self._clock_ns = None
                found.append(Event("restart", time_ns))
            late = order == "late"
            if not late:
                self.clock.take_arrival(message.time_device_ns, time_ns)
        self.rate.take(time_ns)
        bits = flags()["out_of_order"].mask if late else 0
        found += [
            Sample(
                port=name,
                time_host_ns=time_ns,
                payload=_POSE.pack(*pose),
                time_device_ns=message.time_device_ns,
                sequence=message.sequence,
                flags=bits,
            )
            for name, pose in named.items()
        ]
        if late:  # where things were, not where they are
            return found
        self._head = message.poses.get("head", self._head)
        return found + self._watch(named, time_ns) + self._read_flag(message.flag, time_ns)

    def _named(self, message: Poses) -> dict[str, Pose]:
        """Return the poses by port; nothing where the wanted hand is not among them."""
        poses = message.poses
        found: dict[str, Pose] = {}
        if self.options.hand == "both":
            found = {f"pose_{part}": pose for part, pose in poses.items() if part in _SIDES}
        else:
            side = self._wanted(message)
            if side is not None:
                found = {"pose": poses[side]}
        if found and "head" in poses and "headset" in self.watches:
            found["headset"] = poses["head"]
        return found

    def _wanted(self, message: Poses) -> Part | None:
        """Return which of a message's poses is that of the one hand, None where none is."""
        hands = [part for part in message.poses if part != "head"]
        if self.options.hand == "any":
            if len(hands) != 1:
                return None
            self._side = self._side or hands[0]
            return hands[0] if hands[0] == self._side else None
        return next((part for part in hands if part in {self.options.hand, "hand"}), None)

    def _watch(self, named: dict[str, Pose], time_ns: int) -> Found:
        found: Found = []
        for name, pose in named.items():
            jump_m = self.watches[name].take(time_ns, pose)
            if jump_m is not None:
                found.append(Event("pose_jump", time_ns, {"port": name, "distance_m": jump_m}))
        return found

    def _read_flag(self, flag: bool, time_ns: int) -> Found:
        changed_ns = self.flag.take(time_ns, flag)
        return [] if changed_ns is None else [Event("record_flag", changed_ns, {"on": flag})]

    def _read_frame(self, message: Frame, time_ns: int) -> Found:
        if self.frames.get(message.name) == message.pose:
            return []
        self.frames[message.name] = message.pose
        for watch in self.watches.values():
            watch.settle()
        return [Event(message.name, time_ns, {"pose": list(message.pose)})]

    def _read_command(self, message: Command, time_ns: int) -> Found:
        repeated = message.name == self._command
        self._command = message.name
        found = self._read_flag(message.name == "start", time_ns)
        if message.name == "remove" and not repeated:
            found.append(Event("remove", time_ns))
        return found
