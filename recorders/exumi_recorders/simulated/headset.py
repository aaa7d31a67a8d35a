"""A headset that sends real datagrams: ``python -m exumi_recorders.simulated.headset OPTIONS``.

OPTIONS is a `HeadsetOptions` as JSON. When everything is sent, one line of JSON tells what was: the
number of datagrams, how late the latest was sent, and the epoch.
"""

import json
import select
import socket
import sys
import time
from dataclasses import asdict, dataclass

from exumi_recorders.simulated.headset_options import HeadsetOptions
from exumi_recorders.simulated.headset_plan import Planned, plan
from exumi_recorders.simulated.headset_poses import session_truth

__all__ = ["Sent", "main", "send"]

S_NS = 1_000_000_000
_REPLY = b"XU,R,"


@dataclass(frozen=True, slots=True)
class Sent:
    """What a headset has sent.

    Attributes
    ----------
    epoch_ns : int
        CLOCK_MONOTONIC of the session's second 0.
    datagrams : int
        All but echoes.
    poses : int
        Those with poses.
    echoes, trips : int
        How often it asked for the hub's time, and got an answer.
    latest_ns : int
        How long after its time the latest datagram was sent.
    """

    epoch_ns: int
    datagrams: int
    poses: int
    echoes: int
    trips: int
    latest_ns: int


def send(options: HeadsetOptions, planned: list[Planned]) -> Sent:
    """Send datagrams, each at its time, and compare clocks meanwhile (dialect d).

    Parameters
    ----------
    options : HeadsetOptions
    planned : list of Planned
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.setblocking(False)
        link.bind((options.source, 0))
        return _Sender(options, link).run(planned)


class _Sender:
    def __init__(self, options: HeadsetOptions, link: socket.socket) -> None:
        self._options = options
        self._link = link
        self._hub = (options.host, options.port)
        self._epoch_ns = options.epoch_ns or time.monotonic_ns()
        self._next_echo_ns = self._epoch_ns if options.dialect == "d" else None
        self._echoes = 0
        self._trips = 0

    def run(self, planned: list[Planned]) -> Sent:
        latest_ns = 0
        for each in planned:
            due_ns = self._epoch_ns + each.send_ns
            self._wait(due_ns)
            latest_ns = max(latest_ns, time.monotonic_ns() - due_ns)
            self._send(each.data)
        if self._next_echo_ns is not None:
            self._wait(time.monotonic_ns() + S_NS // 20)  # for the last answer
        poses = sum(each.pose_ns is not None for each in planned)
        return Sent(self._epoch_ns, len(planned), poses, self._echoes, self._trips, latest_ns)

    def _wait(self, until_ns: int) -> None:
        """Wait; ask for the hub's time when it is time to, and hear the answers."""
        while (now_ns := time.monotonic_ns()) < until_ns:
            wake_ns = until_ns
            if self._next_echo_ns is not None:
                if now_ns >= self._next_echo_ns:
                    self._ask(now_ns)
                wake_ns = min(until_ns, self._next_echo_ns)
            readable, _, _ = select.select([self._link], [], [], max(0, wake_ns - now_ns) / S_NS)
            if readable:
                self._hear()

    def _ask(self, now_ns: int) -> None:
        self._send(f"XU,E,{self._echoes},{self._clock(now_ns)}".encode("ascii"))
        self._echoes += 1
        self._next_echo_ns = now_ns + round(self._options.echo_s * S_NS)

    def _hear(self) -> None:
        try:
            data = self._link.recv(1024)
        except OSError:  # nobody listens yet: Linux reports that on the next call
            return
        back_ns = self._clock(time.monotonic_ns())
        if data.startswith(_REPLY):
            self._trips += 1
            self._send(b"XU,T," + data.removeprefix(_REPLY) + b",%d" % back_ns)

    def _clock(self, monotonic_ns: int) -> int:
        return self._options.device_time_ns(monotonic_ns - self._epoch_ns)

    def _send(self, data: bytes) -> None:
        try:
            self._link.sendto(data, self._hub)
        except OSError:  # as above; a datagram that cannot be sent is lost, as on any network
            return


def main() -> None:
    """Send all that the options on the command line say."""
    options = HeadsetOptions.model_validate_json(sys.argv[1])
    planned = plan(options, session_truth(options.session))
    sys.stdout.write(json.dumps(asdict(send(options, planned))) + "\n")


if __name__ == "__main__":
    main()
