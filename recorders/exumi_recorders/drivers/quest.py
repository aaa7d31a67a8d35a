"""A Meta Quest headset that sends the poses of its controllers as UDP datagrams."""

import threading
import time

from exumi_recorders.contract import DeviceError, DriverType, Event, Health, Port, Sample
from exumi_recorders.drivers.quest_dialects import MAX_BYTES
from exumi_recorders.drivers.quest_options import QuestOptions, make_ports
from exumi_recorders.drivers.quest_report import problems_of, readings_of
from exumi_recorders.drivers.quest_stream import QuestStream
from exumi_recorders.drivers.stamped_udp import StampedSocket
from exumi_recorders.drivers.waiting import first_items

__all__ = ["DRIVER", "Quest"]


class Quest:
    """Listens to a headset: poses stamped by the kernel, the operator's flag, the world frame.

    Parameters
    ----------
    options : QuestOptions
    """

    def __init__(self, options: QuestOptions) -> None:
        self._options = options
        self._socket: StampedSocket | None = None
        self._stream = QuestStream(options, lambda data, to: None)
        self._opened_ns = 0
        # health() looks at what read() is working on.
        self._lock = threading.Lock()

    @property
    def ports(self) -> tuple[Port, ...]:
        """``pose``, or ``pose_left`` and ``pose_right``; and ``headset``."""
        return make_ports(self._options)

    @property
    def address(self) -> tuple[str, int]:
        """Address and port that it listens on, while it is open."""
        return self._link().address

    def open(self) -> None:
        """Listen.

        Raises
        ------
        DeviceError
            The address is in use or is not of this machine, or the system is not Linux.
        """
        self.close()
        options = self._options
        link = StampedSocket(
            options.host, options.port, buffer_bytes=options.buffer_bytes, max_bytes=MAX_BYTES
        )
        with self._lock:
            self._stream = QuestStream(options, link.send)
            self._opened_ns = time.monotonic_ns()
            self._socket = link

    def read(self, timeout_s: float) -> list[Sample | Event]:
        """Return what has come; wait for the first, but not longer.

        Parameters
        ----------
        timeout_s : float

        Raises
        ------
        DeviceLostError
            The socket fails.
        """
        link = self._link()

        def receive(left_s: float) -> list[Sample | Event]:
            datagrams = link.receive(left_s)
            with self._lock:
                return [found for datagram in datagrams for found in self._stream.take(datagram)]

        return first_items(receive, timeout_s)

    def health(self) -> Health:
        """Tell how the device is."""
        with self._lock:
            link, stream, now_ns = self._socket, self._stream, time.monotonic_ns()
            if link is None:
                return Health(problems=("The headset's port is not open.",))
            lost = {f"rejected_{reason}": count for reason, count in stream.rejected.items()}
            lost |= {"kernel": link.dropped, "sequence": stream.sequence.lost}
            return Health(
                lost={cause: count for cause, count in lost.items() if count},
                readings={
                    **readings_of(stream, now_ns),
                    "utc_steps": link.utc_steps,
                    "receive_buffer_bytes": link.buffer_bytes,
                },
                problems=tuple(problems_of(stream, self._opened_ns, now_ns)),
                stamp_sigma_ns=link.stamp_sigma_ns,
            )

    def close(self) -> None:
        """Stop listening; also a second time."""
        with self._lock:
            link, self._socket = self._socket, None
        if link is not None:
            link.close()

    def _link(self) -> StampedSocket:
        if self._socket is None:
            raise DeviceError("the headset's port is not open", fix="Call open() first.")
        return self._socket


DRIVER = DriverType(
    "quest", "A Meta Quest headset: poses of its controllers, by UDP.", QuestOptions, Quest
)
