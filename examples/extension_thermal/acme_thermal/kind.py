"""The stream kind ``acme:thermal``: the temperature of a fingertip's surface."""

from typing import Annotated

from pydantic import Field

from exumi_data.extensions import StreamKind
from exumi_data.model.streams import ExtensionStream
from exumi_data.standard import ArraySpec

__all__ = ["KIND", "SCHEMA_URL", "THERMAL", "VERSION", "ThermalStream"]

KIND = "acme:thermal"
VERSION = "1"
SCHEMA_URL = "https://acme.example/thermal/1.json"


class ThermalStream(ExtensionStream):
    """Metadata of the stream: the vendor's keys bear its prefix."""

    emissivity: Annotated[float, Field(alias="acme:emissivity", gt=0, le=1)]
    """Of the surface that the sensor looks at."""
    range_celsius: Annotated[
        list[float] | None, Field(alias="acme:range_celsius", min_length=2, max_length=2)
    ] = None
    """What the sensor can measure, lowest and highest."""


THERMAL = StreamKind(
    name=KIND,
    version=VERSION,
    schema_url=SCHEMA_URL,
    text="Temperature of a fingertip's surface.",
    metadata=ThermalStream,
    arrays=(
        ArraySpec(
            name="data",
            dtype=("float32",),
            shape=("N",),
            dimensions=("time",),
            unit="acme:celsius",
            required=True,
            text="Degrees Celsius.",
        ),
    ),
)
