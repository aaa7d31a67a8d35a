"""Guided poses: a headset sends real datagrams, and the operator is led."""

import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from exumi_recorders.calibration.guided import LivePoses, guided_jig, guided_tip
from exumi_recorders.calibration.live import LivePort
from exumi_recorders.drivers.quest import Quest
from exumi_recorders.drivers.quest_options import QuestOptions
from exumi_recorders.world_frame import to_headset_world
from tests.exumi_recorders.calibration.test_controller import TIP, pivoting

# A world that lies elsewhere in the headset's space, and is turned.
WORLD = np.array([0.4, 1.1, -0.3, 0.0, np.sin(0.4), 0.0, np.cos(0.4)])


class Hand:
    """An exUMI app: sends a hand's poses, over and over, from a thread of its own."""

    def __init__(self, address: tuple[str, int]) -> None:
        self.poses = pivoting()
        self.sends_world = False
        self._address = address
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def _send(self) -> None:
        number = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not self._ending.is_set():
                if self.sends_world:
                    sender.sendto(f"WF,{_text(WORLD)}".encode(), self._address)
                    self.sends_world = False
                pose = to_headset_world(self.poses[number % len(self.poses)], WORLD)
                sender.sendto(f"EE,N,{_text(pose)}".encode(), self._address)
                number += 1
                time.sleep(0.002)

    def end(self) -> None:
        self._ending.set()
        self._thread.join()


def _text(numbers: np.ndarray) -> str:
    return ",".join(f"{number:.7f}" for number in numbers)


@pytest.fixture
def port() -> Iterator[LivePort]:
    driver = Quest(QuestOptions(host="127.0.0.1", port=0, dialect="b"))
    with LivePort("headset", driver, driver.ports[0], "pose").opened() as opened:
        yield opened


@pytest.fixture
def hand(port: LivePort) -> Iterator[Hand]:
    assert isinstance(port.driver, Quest)
    hand = Hand(port.driver.address)
    yield hand
    hand.end()


def test_the_tip_is_found_and_what_does_not_tell_is_done_again(port: LivePort, hand: Hand) -> None:
    hand.poses = pivoting(axes=(1.0, 0.0, 0.0))  # about one axis only
    asked: list[str] = []
    said: list[str] = []

    def ask(prompt: str) -> str:
        asked.append(prompt)
        if len(asked) == 2:
            hand.poses = pivoting()
        return ""

    found = guided_tip(LivePoses(port), ask, said.append, seconds=1.2)
    assert len(asked) == 2
    assert "dent" in asked[0]
    assert "not taken: the hand turned by" in said[0]
    assert "Turn the hand to and fro" in said[0]
    # The world was not marked: where the tip is on the hand does not depend on it.
    assert np.linalg.norm(found.tip_m - TIP) < 1e-3
    assert "tip at 20." in said[1] or "tip at 19." in said[1]


def test_a_jig_needs_the_world(port: LivePort, hand: Hand) -> None:
    turned = np.array([0.0, 0.0, np.sin(0.3), np.cos(0.3)])
    hand.poses = np.concatenate([[0.1, 0.2, 0.3], turned])[None]
    asked: list[str] = []
    said: list[str] = []

    def ask(prompt: str) -> str:
        asked.append(prompt)
        hand.sends_world = len(asked) == 2
        return ""

    tool = [0.0, 0.0, np.sin(0.5), np.cos(0.5)]
    found = guided_jig(LivePoses(port), tool, ask, said.append, seconds=0.4)
    assert said[0] == "  not taken: the world is not known. Mark it in the app, now."
    assert len(asked) == 2
    angle = 2 * (0.5 - 0.3)
    expected = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    assert found.rotation[:2, :2] == pytest.approx(np.array(expected), abs=1e-4)
