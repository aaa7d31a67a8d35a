"""A driver of a six-axis force-torque sensor that sends lines over a serial port or UDP.

A line is ``FT,<count>,<fx>,<fy>,<fz>,<tx>,<ty>,<tz>*<sum>``: millinewtons and newton millimetres,
a count from 0 to 65535, and the sum of all characters before the asterisk, modulo 256, in hex.
"""

from pydantic import Field

from exumi_data.model.streams import Sensor
from exumi_recorders.contract import DriverType, Port, Rows
from exumi_recorders.drivers.line import LineDriver, LineSource, Reading

__all__ = ["DRIVER", "Options", "make", "parse"]


class Options(LineSource):
    """Of the rig file: where the lines come from, and where the sensor is mounted."""

    reference_frame: str = "gripper"
    rate_hz: int = Field(default=500, ge=1)


def parse(line: bytes) -> Reading | None:
    """Read a line; anything but ``FT`` is a message of the sensor's own."""
    if not line.startswith(b"FT,"):
        return None
    text, _, check = line.partition(b"*")
    if sum(text) % 256 != int(check, 16):
        raise ValueError("the check sum is wrong")
    _, count, *values = text.split(b",")
    return Reading([float(value) / 1000 for value in values], sequence=int(count))


def make(options: Options) -> LineDriver:
    """Return the driver, not open yet."""
    port = Port(
        name="wrench",
        kind="wrench",
        payload=Rows({"data": ("<f4", (6,))}),
        stamp_point="user_rx",
        nominal_rate=str(options.rate_hz),
        modulus=65536,
        sensor=Sensor(model="acme-ft6", manufacturer="Acme"),
        metadata={
            "components": ["fx", "fy", "fz", "tx", "ty", "tz"],
            "reference_frame": options.reference_frame,
        },
    )
    return LineDriver(port, options, parse)


DRIVER = DriverType("acme-ft6", "Acme's six-axis force-torque sensor.", Options, make)
