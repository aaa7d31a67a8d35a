"""Devices as a preflight found them, made by hand."""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from exumi_data.store import jpeg
from exumi_recorders.contract import Event, Files, Health, Port, Rows
from exumi_recorders.rig.probing import ProbedDevice, ProbedStream

Image = npt.NDArray[np.uint8]


def port(kind: str = "wrench", **more: Any) -> Port:
    payload = Rows({"data": ("<f4", (6,))})
    return Port(
        **{"name": kind, "kind": kind, "payload": payload, "stamp_point": "user_rx", **more}
    )


def encoder_port() -> Port:
    return port(
        "width",
        payload=Rows({"raw": ("<u2", ())}),
        stamp_point="bracket_mid",
        transform="encoder_map",
        metadata={"raw": {"unit": "count", "modulus": 4096}},
    )


def camera_port(kind: str = "tactile", height: int = 96, width: int = 128) -> Port:
    payload = Files(height, width, 3)
    return port(kind, name="images", payload=payload, stamp_point="buffer_soe", nominal_rate="30")


def stream(
    name: str, of: Port, count: int = 0, *, frames: Sequence[bytes] = (), latest: bytes = b""
) -> ProbedStream:
    return ProbedStream(
        name, "device", of, count=count, latest=latest or None, frames=deque(frames)
    )


def device(
    *streams: ProbedStream,
    name: str = "device",
    failure: Exception | None = None,
    lost: Mapping[str, int] | None = None,
    events: Sequence[str] = (),
    problems: Sequence[str] = (),
    **readings: float | int | str | bool,
) -> ProbedDevice:
    return ProbedDevice(
        name,
        failure,
        {each.name: each for each in streams},
        {each: Event(each, 0) for each in events},
        dict(lost or {}),
        Health(readings=readings, problems=tuple(problems)),
    )


def gel(seed: int, *, height: int = 96, width: int = 128) -> Image:
    """A smooth gel with a light of its own, (height, width, 3)."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    across, down = np.random.default_rng(seed).uniform(-0.35, 0.35, 2)
    levels = 120 + across * (x - width / 2) + down * (y - height / 2)
    return np.asarray(np.repeat(levels[..., None], 3, axis=2), np.uint8)


def pressed(image: Image) -> Image:
    """The same with a dark blob in the middle."""
    height, width = image.shape[:2]
    y, x = np.mgrid[0:height, 0:width]
    blob = np.exp(-((x - width / 2) ** 2 + (y - height / 2) ** 2) / 200)
    return np.asarray(np.clip(image - 60.0 * blob[..., None], 0, 255), np.uint8)


def shot(image: Image) -> bytes:
    return jpeg.encode(image, 90)
