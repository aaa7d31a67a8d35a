"""The gripper's encoder: an AS5600 on an I2C bus.

RAW ANGLE is polled on a schedule of absolute times, one block read of two bytes a sample, stamped
midway between the times before and after it. STATUS, AGC and MAGNITUDE are read now and then, each
on its own: the chip's pointer does not go past the low byte of RAW ANGLE. Nothing is ever written
but the pointer. Where the gripper turns the encoder more than once, turns are counted from `home`.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field

from exumi_data.errors import MissingExtraError
from exumi_data.model.streams import Sensor
from exumi_data.standard.registry import flags
from exumi_recorders.contract import (
    DeviceError,
    DeviceLostError,
    DriverType,
    Event,
    Health,
    Port,
    Rows,
    Sample,
)
from exumi_recorders.drivers.turn_counter import TurnCounter
from exumi_recorders.simulated.play import SimulatedPlay

__all__ = ["DRIVER", "As5600", "As5600Options", "Bus", "SimulatedEncoder"]

_ZMCO, _CONF, _STATUS, _RAW, _AGC, _MAGNITUDE = 0x00, 0x07, 0x0B, 0x0C, 0x1A, 0x1B
_DETECTED, _WEAK, _STRONG = 1 << 5, 1 << 4, 1 << 3
_MODULUS = 4096
_INVALID = 1 << flags()["invalid"].bit
# The gain settles between 0 and this; beyond a fifth from either end the magnet is badly placed.
_AGC_MOST = {"3.3V": 128, "5V": 255}
_AGC_MARGIN = 0.2
# So many samples are handed over at once: often enough that a sample is stored soon after it was
# taken, rarely enough that handing over costs little.
_BATCH_NS = 10_000_000
# Failures in a row after which the device is gone, or a time without a reading where failing is
# slow, as when the bus is held low.
_LOST_AFTER = 10
_LOST_AFTER_NS = 500_000_000
_BRACKET_SHARE = 1 / 64
_NS = 1_000_000_000


class Bus(Protocol):
    """The part of ``smbus2.SMBus`` that is used."""

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int) -> list[int]:
        """Read some bytes."""

    def close(self) -> None:
        """Close it."""


class SimulatedEncoder(SimulatedPlay):
    """A simulated gripper in place of the bus."""

    magnet_gap_mm: float = Field(default=2.0, gt=0)
    """2 is right; beyond 4.7 the chip notices no magnet."""
    away_s: list[tuple[float, float]] = Field(default=[], strict=False)
    """When the device is unplugged: spans in seconds since the session's start."""


class As5600Options(BaseModel):
    """An AS5600 in a rig file."""

    model_config = ConfigDict(extra="forbid", strict=True)

    bus: int = Field(default=1, ge=0)
    """Number of the bus: 1 for /dev/i2c-1."""
    address: int = Field(default=0x36, ge=0x08, le=0x77)
    rate_hz: int = Field(default=500, ge=1, le=1000)
    status_hz: float = Field(default=5.0, ge=1.0, le=20.0)
    """How often STATUS, AGC and MAGNITUDE are read: a missing magnet is noticed as late as this."""
    supply: Literal["3.3V", "5V"] = "3.3V"
    """The gain goes to 128 at 3.3 V, to 255 at 5 V."""
    home: int | None = Field(default=None, ge=0, lt=_MODULUS)
    """For a gripper that turns the encoder more than once: the count where it is closed."""
    simulated: SimulatedEncoder | None = None


@dataclass(frozen=True, slots=True)
class _Status:
    """What the slow registers said."""

    bits: int
    agc: int
    magnitude: int

    def problems(self, most: int) -> tuple[str, ...]:
        if not self.bits & _DETECTED:
            return ("The encoder sees no magnet: is it in its place, about 2 mm above the chip?",)
        if self.bits & _STRONG:
            return ("The encoder's magnet is too strong: move it away from the chip.",)
        if self.bits & _WEAK:
            return ("The encoder's magnet is too weak: bring it closer to the chip.",)
        where = "far from" if self.agc > most / 2 else "close to"
        if not _AGC_MARGIN * most <= self.agc <= (1 - _AGC_MARGIN) * most:
            return (
                f"The encoder's gain is {self.agc}, {most // 2} is best: "
                f"the magnet is rather {where} the chip.",
            )
        return ()


class As5600:
    """The driver.

    Parameters
    ----------
    options : As5600Options
    open_bus : callable, optional
        Returns an open bus in place of ``smbus2.SMBus(options.bus)``.
    """

    def __init__(self, options: As5600Options, open_bus: Callable[[], Bus] | None = None) -> None:
        self._options = options
        self._open_bus = open_bus or _opener(options)
        counts_turns = options.home is not None
        self._period_ns = _NS // options.rate_hz
        self._status_ns = int(_NS / options.status_hz)
        self._bus: Bus | None = None
        self._events: list[Event] = []
        self._turns: TurnCounter | None = None
        self._forget()
        counts = {"unit": "count"} if counts_turns else {"unit": "count", "modulus": _MODULUS}
        self.ports = (
            Port(
                name="width",
                kind="width",
                payload=Rows({"raw": ("<i4" if counts_turns else "<u2", ())}),
                stamp_point="bracket_mid",
                nominal_rate=str(options.rate_hz),
                transform="encoder_map",
                sensor=Sensor(model="as5600", manufacturer="ams OSRAM"),
                metadata={"raw": counts},
            ),
        )

    def _forget(self) -> None:
        self._next_ns: int | None = None
        self._status: _Status | None = None
        self._status_due_ns = 0
        self._failures = 0
        self._good_ns = 0
        self._bracket_ns: float | None = None
        self._count: int | None = None
        home = self._options.home
        self._turns = None if home is None else TurnCounter(home, _MODULUS)
        self._lost = {"bus": 0, "late": 0, "rejected": 0}

    def open(self) -> None:
        """Open the bus and see that the chip answers.

        Raises
        ------
        DeviceError
            There is no such bus, it may not be used, nothing answers, or it is open already.
        MissingExtraError
            smbus2 is not installed.
        """
        where = self._where()
        if self._bus is not None:
            raise DeviceError("the encoder is open already", where=where)
        self._forget()
        bus = _open(self._open_bus, where)
        try:
            address = self._options.address
            self._status = _read_status(bus, address)
            conf = bus.read_i2c_block_data(address, _CONF, 2)
            burnt = bus.read_byte_data(address, _ZMCO)
        except OSError as error:
            bus.close()
            raise DeviceError(
                f"no AS5600 answers at address {self._options.address:#04x} ({error})",
                where=where,
                fix="Check its supply and the wires SDA and SCL; what answers is listed by "
                f"`i2cdetect -y {self._options.bus}`.",
            ) from None
        # Filters of CONF delay the angle, so it belongs to the recording.
        detail = {"conf": conf[0] << 8 | conf[1], "zmco": burnt}
        self._events = [Event("controls", time.monotonic_ns(), detail)]
        self._good_ns = time.monotonic_ns()
        self._status_due_ns = self._good_ns + self._status_ns
        self._bus = bus

    def read(self, timeout_s: float) -> list[Sample | Event]:
        """Take the samples that are due within the time, at most 10 ms of them.

        Raises
        ------
        DeviceLostError
            The chip has not answered several times in a row.
        DeviceError
            It is not open.
        """
        bus = self._bus
        if bus is None:
            raise DeviceError("the encoder is not open", where=self._where())
        began_ns = time.monotonic_ns()
        until_ns = began_ns + int(timeout_s * _NS)
        full_ns = min(until_ns, began_ns + _BATCH_NS)
        items: list[Sample | Event] = [*self._events]
        self._events = []
        due_ns = began_ns if self._next_ns is None else self._next_ns
        while due_ns <= (full_ns if items else until_ns):
            _sleep_until(due_ns)
            sample = self._sample(bus)
            if sample is not None:
                items.append(sample)
            now_ns = time.monotonic_ns()
            if now_ns >= self._status_due_ns:
                self._look(bus)
                now_ns = time.monotonic_ns()
                self._status_due_ns = now_ns + self._status_ns
            due_ns = self._after(due_ns, now_ns)
        self._next_ns = due_ns
        if not items:
            _sleep_until(until_ns)
        return items

    def health(self) -> Health:
        """Tell what the chip last said of itself, and what failed."""
        status, bracket_ns = self._status, self._bracket_ns
        readings: dict[str, float | int | str | bool] = {}
        problems: tuple[str, ...] = ()
        if status is not None:
            readings |= {
                "magnet": bool(status.bits & _DETECTED),
                "agc": status.agc,
                "magnitude": status.magnitude,
            }
            problems = status.problems(_AGC_MOST[self._options.supply])
        if self._count is not None:
            readings["count"] = self._count
        if self._turns is not None and not self._turns.is_known:
            problems += (
                "The encoder's turn is not known: close the gripper, and hold it for a second "
                f"(count {self._options.home}).",
            )
        if bracket_ns is not None:
            readings["bracket_us"] = round(bracket_ns / 1000, 1)
        if self._failures:
            problems += ("The encoder's bus fails: check its plug and wires.",)
        return Health(
            lost=dict(self._lost),
            readings=readings,
            problems=problems,
            stamp_sigma_ns=bracket_ns,
        )

    def close(self) -> None:
        """Release the bus."""
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def _where(self) -> str:
        return "simulated bus" if self._options.simulated else f"/dev/i2c-{self._options.bus}"

    def _after(self, due_ns: int, now_ns: int) -> int:
        """Return when the next sample is due: on the schedule, leaving out what is past."""
        due_ns += self._period_ns
        # Right after a late sample the next one would tell nothing new.
        earliest_ns = now_ns + self._period_ns // 4
        if due_ns < earliest_ns:
            missed = -((due_ns - earliest_ns) // self._period_ns)
            self._lost["late"] += missed
            due_ns += missed * self._period_ns
        return due_ns

    def _sample(self, bus: Bus) -> Sample | None:
        before_ns = time.monotonic_ns()
        try:
            high, low = bus.read_i2c_block_data(self._options.address, _RAW, 2)
        except OSError as error:
            self._fail(error)
            return None
        after_ns = time.monotonic_ns()
        if high > 0x0F:  # the upper four bits are zero on a chip, ones on a bus that nobody drives
            self._lost["rejected"] += 1
            return None
        self._failures, self._good_ns = 0, after_ns
        width_ns = after_ns - before_ns
        mean_ns = self._bracket_ns
        self._bracket_ns = (
            float(width_ns) if mean_ns is None else mean_ns + _BRACKET_SHARE * (width_ns - mean_ns)
        )
        status = self._status
        seen = status is not None and bool(status.bits & _DETECTED)
        time_ns = before_ns + width_ns // 2
        payload, is_known = self._counted(high << 8 | low, time_ns, seen=seen)
        return Sample(
            port="width",
            time_host_ns=time_ns,
            payload=payload,
            flags=0 if seen and is_known else _INVALID,
        )

    def _counted(self, count: int, time_ns: int, *, seen: bool) -> tuple[bytes, bool]:
        """Return what is recorded of a count, and whether its turn is known."""
        turns = self._turns
        if turns is None:
            self._count = count
            return count.to_bytes(2, "little"), True
        if not seen:
            turns.lose()
        self._count = turns.take(count, time_ns)
        return self._count.to_bytes(4, "little", signed=True), turns.is_known

    def _look(self, bus: Bus) -> None:
        try:
            self._status = _read_status(bus, self._options.address)
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self._lost["bus"] += 1
        self._failures += 1
        silent_ns = time.monotonic_ns() - self._good_ns
        if self._failures >= _LOST_AFTER or (self._failures > 1 and silent_ns > _LOST_AFTER_NS):
            raise DeviceLostError(
                f"the encoder has not answered {self._failures} times in a row ({error})",
                where=self._where(),
                fix="Check its plug, its supply and the wires SDA and SCL.",
            ) from error


def _read_status(bus: Bus, address: int) -> _Status:
    high, low = bus.read_i2c_block_data(address, _MAGNITUDE, 2)
    return _Status(
        bits=bus.read_byte_data(address, _STATUS),
        agc=bus.read_byte_data(address, _AGC),
        magnitude=(high & 0x0F) << 8 | low,
    )


def _sleep_until(time_ns: int) -> None:
    # Python sleeps to an absolute time of CLOCK_MONOTONIC; only the step to it is relative.
    left_ns = time_ns - time.monotonic_ns()
    if left_ns > 0:
        time.sleep(left_ns / _NS)


def _open(open_bus: Callable[[], Bus], where: str) -> Bus:
    try:
        return open_bus()
    except FileNotFoundError:
        fix = "Switch the bus on in the board's settings (device tree overlay), and count from 0."
        raise DeviceError("there is no such bus", where=where, fix=fix) from None
    except PermissionError:
        fix = "Add the user to the group i2c: sudo usermod -aG i2c $USER, then log in again."
        raise DeviceError("the bus may not be used", where=where, fix=fix) from None
    except OSError as error:
        raise DeviceError(f"the bus cannot be opened ({error})", where=where) from None


def _opener(options: As5600Options) -> Callable[[], Bus]:
    simulated = options.simulated
    if simulated is None:
        return lambda: _real_bus(options.bus)
    made: list[Bus] = []  # one chip, however often it is opened

    def open_bus() -> Bus:
        if not made:
            made.append(_simulated_bus(simulated, options.address))
        return made[0]

    return open_bus


def _real_bus(number: int) -> Bus:
    try:
        from smbus2 import SMBus
    except ModuleNotFoundError as error:
        if error.name == "fcntl":
            raise DeviceError("I2C devices are recorded on Linux only") from None
        raise MissingExtraError(
            "the driver as5600 needs smbus2",
            fix='Install it: pip install "exumi-data[record]"',
        ) from None
    bus: Bus = SMBus(number)
    return bus


def _simulated_bus(simulated: SimulatedEncoder, address: int) -> Bus:
    from exumi_recorders.simulated.as5600_chip import As5600Chip
    from exumi_recorders.simulated.bus import SimulatedBus, gripper_counts

    epoch_ns = simulated.epoch_ns
    chip = As5600Chip(gripper_counts(simulated.session(), epoch_ns), simulated.magnet_gap_mm)
    bus = SimulatedBus(chip, address=address)
    bus.away_ns = tuple(
        (epoch_ns + int(start * _NS), epoch_ns + int(end * _NS)) for start, end in simulated.away_s
    )
    return bus


def _make(options: Any) -> As5600:
    return As5600(options)


DRIVER = DriverType("as5600", "The gripper's magnetic encoder on I2C.", As5600Options, _make)
