"""A headset that sends, a driver that listens."""

import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from exumi_data.simulation import Truth
from exumi_recorders.contract import Event, Health, Sample
from exumi_recorders.drivers.quest import Quest
from exumi_recorders.drivers.quest_options import QuestOptions
from exumi_recorders.simulated.headset import Sent, send
from exumi_recorders.simulated.headset_options import HeadsetOptions, SimulatedSession
from exumi_recorders.simulated.headset_plan import Planned, plan

SESSION = SimulatedSession(seed=3, duration_s=4)


@dataclass
class Heard:
    """What was sent, and what came of it."""

    planned: list[Planned]
    sent: Sent
    health: Health
    samples: list[Sample] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    def of(self, port: str) -> list[Sample]:
        return [sample for sample in self.samples if sample.port == port]

    def poses(self, port: str = "pose") -> np.ndarray:
        """(N, 7) as they were sent."""
        payload = b"".join(sample.payload for sample in self.of(port))
        return np.frombuffer(payload, "<f8").reshape(-1, 7)

    def event(self, name: str) -> Event:
        (found,) = (event for event in self.events if event.name == name)
        return found

    def since_epoch_s(self, time_ns: int) -> float:
        return (time_ns - self.sent.epoch_ns) * 1e-9


class Listening:
    """Starts a headset in a thread, and reads until all has come."""

    def __init__(self, truth: Truth) -> None:
        self.truth = truth

    def __call__(self, quest: dict[str, Any] | None = None, **headset: Any) -> Heard:
        driver = Quest(
            QuestOptions.model_validate({"host": "127.0.0.1", "port": 0, **(quest or {})})
        )
        driver.open()
        try:
            return self._listen(driver, headset)
        finally:
            driver.close()

    def _listen(self, driver: Quest, headset: dict[str, Any]) -> Heard:
        options = HeadsetOptions.model_validate(
            {"duration_s": 0.4, "session": SESSION, "port": driver.address[1], **headset}
        )
        planned = plan(options, self.truth)
        sent: list[Sent] = []
        sender = threading.Thread(target=lambda: sent.append(send(options, planned)))
        found: list[Sample | Event] = []
        sender.start()
        while sender.is_alive():
            found += driver.read(0.02)
        found += driver.read(0.02)
        return Heard(
            planned,
            sent[0],
            driver.health(),
            [each for each in found if isinstance(each, Sample)],
            [each for each in found if isinstance(each, Event)],
        )
