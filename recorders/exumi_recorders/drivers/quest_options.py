"""The options of the Quest driver, and the ports that follow from them."""

from types import MappingProxyType
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from exumi_data.model.streams import Sensor
from exumi_recorders.contract import Port, Rows
from exumi_recorders.drivers.quest_dialects import SEQUENCE_MODULUS

__all__ = ["QuestOptions", "make_ports", "port_names"]


class QuestOptions(BaseModel):
    """Options of the driver ``quest``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = "0.0.0.0"  # noqa: S104  # the headset comes over whichever network there is
    """IPv4 address of this machine to listen on."""
    port: Annotated[int, Field(ge=0, le=65535)] = 12346
    dialect: Literal["auto", "a", "b", "c", "d"] = "auto"
    """See `exumi_recorders.drivers.quest_dialects`."""
    hand: Literal["any", "left", "right", "both"] = "any"
    """``any`` takes the hand that comes first; ``both`` delivers pose_left and pose_right."""
    headset: bool | None = None
    """Whether to deliver the headset's own pose: by default unless the dialect is b or c, which
    do not send it."""
    sender: str | None = None
    """The headset's address; by default the first that sends."""
    jump_m: Annotated[float, Field(gt=0)] = 0.2
    """A pose that jumps further than this between two datagrams: the headset was recentred."""
    range_m: Annotated[float, Field(gt=0)] = 3.0
    """Further from the headset than this a controller is not tracked well."""
    buffer_bytes: Annotated[int, Field(ge=4096, le=2**28)] = 2**22
    """Wanted size of the kernel's receive buffer."""


def port_names(options: QuestOptions) -> tuple[str, ...]:
    """Return ``pose``, or ``pose_left`` and ``pose_right``; and ``headset``.

    Parameters
    ----------
    options : QuestOptions
    """
    hands = ("pose_left", "pose_right") if options.hand == "both" else ("pose",)
    with_headset = options.headset
    if with_headset is None:
        with_headset = options.dialect not in {"b", "c"}
    return (*hands, "headset") if with_headset else hands


def make_ports(options: QuestOptions) -> tuple[Port, ...]:
    """Return the ports of a headset.

    Parameters
    ----------
    options : QuestOptions
    """
    clock = options.dialect in {"auto", "d"}
    return tuple(_port(name, clock=clock) for name in port_names(options))


def _port(name: str, *, clock: bool) -> Port:
    child = "headset" if name == "headset" else name.replace("pose", "controller")
    side: Literal["left", "right"] | None = None
    if name in {"pose_left", "pose_right"}:
        side = "left" if name == "pose_left" else "right"
    return Port(
        name=name,
        kind="pose",
        payload=Rows(MappingProxyType({"raw": ("<f8", (7,))})),
        stamp_point="kernel_rx",
        transform="world_frame",
        modulus=SEQUENCE_MODULUS if clock else None,
        time_device_unit="ns" if clock else None,
        sensor=Sensor(model="quest-3", manufacturer="Meta", side=side),
        metadata=MappingProxyType(
            {
                "frames": {"parent": "world", "child": child},
                "raw": {
                    "unit": "m",
                    "reference_frame": "headset_world",
                    "transform": "world_frame",
                },
            }
        ),
    )
