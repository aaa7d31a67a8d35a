"""Journals made sample by sample, without devices or threads."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.dataset import create_dataset
from exumi_data.model import DatasetMetadata, EpisodeMetadata
from exumi_recorders.contract import Event, Port, Sample
from exumi_recorders.journal.header import (
    JournalHeader,
    KnownLatency,
    StreamHeader,
    port_document,
)
from exumi_recorders.journal.journal import JournalWriter
from exumi_recorders.journal.record import NONE, pack_header, salt_of
from tests.exumi_recorders.numbered import PAYLOADS, PORTS, episode

T0 = 1_000_000_000_000
S = 1_000_000_000


def make_dataset(folder: Path) -> Path:
    create_dataset(folder, DatasetMetadata(name="test", licence="CC0-1.0"))
    return folder


def make_journal(
    dataset: Path,
    streams: Mapping[str, tuple[Port, Sequence[Sample | None]]],
    *,
    events: Sequence[Event] = (),
    metadata: EpisodeMetadata | None = None,
    latency: Mapping[str, KnownLatency] | None = None,
    arrays: Mapping[str, np.ndarray] | None = None,
    state: str = "stopped",
    **options: Any,
) -> Path:
    """Write a journal; a sample that is None was dropped."""
    header = JournalHeader(
        boot_id="b",
        t0_monotonic_ns=T0,
        episode=metadata or episode(),
        streams={
            name: StreamHeader(
                device="toy",
                port=port_document(port),
                latency=(latency or {}).get(name, KnownLatency()),
            )
            for name, (port, _) in streams.items()
        },
    )
    writer = JournalWriter(dataset, header, arrays=arrays, **options)
    for name, (_, samples) in streams.items():
        salt = salt_of(header.episode.id, name)
        for number, sample in enumerate(samples):
            if sample is not None:
                writer.append(name, _pieces(salt, number, sample))
    for event in events:
        writer.append_event("toy", event)
    if state == "stopped":
        writer.stop()
    else:
        writer.abandon()
    return writer.path


def _pieces(salt: int, number: int, sample: Sample) -> tuple[bytes, bytes]:
    device = NONE if sample.time_device_ns is None else sample.time_device_ns
    sequence = NONE if sample.sequence is None else sample.sequence
    header = pack_header(
        salt, number, sample.time_host_ns, device, sequence, sample.flags, sample.payload
    )
    return header, sample.payload


def samples(name: str, count: int, rate: float = 30.0, **fields: Any) -> list[Sample | None]:
    """Numbered samples of a port of `numbered`."""
    return [
        Sample(
            PORTS[name].name,
            T0 + round((number + 1) * S / rate),
            PAYLOADS[name](number),
            **{"sequence": number, **fields},
        )
        for number in range(count)
    ]


def rows(
    name: str, values: Sequence[Sequence[float]], form: str, rate: float
) -> list[Sample | None]:
    return [
        Sample(name, T0 + round((number + 1) * S / rate), struct.pack(form, *value))
        for number, value in enumerate(values)
    ]
