"""Gates of fingers: nothing touches them, none is in the other's place."""

import numpy as np
import numpy.typing as npt

from exumi_data.tactile import pattern_difference
from exumi_recorders.rig.finger_gates import finger_gates
from exumi_recorders.rig.gate import Gate
from exumi_recorders.rig.probing import ProbedStream
from tests.exumi_recorders.rig.probes import camera_port, gel, port, pressed, shot, stream

LEFT, RIGHT = gel(1), gel(2)
REFERENCES = {"tactile_reference/left": LEFT, "tactile_reference/right": RIGHT}


def finger(name: str, *images: npt.NDArray[np.uint8]) -> ProbedStream:
    return stream(name, camera_port(), len(images), frames=[shot(image) for image in images])


def gates_of(
    *streams: ProbedStream, arrays: dict[str, npt.NDArray[np.uint8]] | None = None
) -> dict[tuple[str, str], Gate]:
    gates = finger_gates(streams, REFERENCES if arrays is None else arrays)
    return {(gate.name, gate.where): gate for gate in gates}


def verdicts(gates: dict[tuple[str, str], Gate]) -> dict[tuple[str, str], str]:
    return {key: gate.verdict for key, gate in gates.items()}


def test_the_gels_of_these_tests_differ() -> None:
    assert pattern_difference(LEFT[..., 0], RIGHT[..., 0]) > 4


def test_both_in_place_and_touching_nothing() -> None:
    gates = gates_of(finger("left", LEFT), finger("right", RIGHT), stream("force", port()))
    assert set(verdicts(gates).values()) == {"pass"}
    assert len(gates) == 4


def test_exchanged_fingers_are_found() -> None:
    gates = gates_of(finger("left", RIGHT), finger("right", LEFT))
    left, right = gates["left_right", "left"], gates["left_right", "right"]
    assert (left.verdict, left.found) == ("fail", "the finger right")
    assert (right.verdict, right.found) == ("fail", "the finger left")
    assert "exchange" in left.what_to_do


def test_contact_does_not_hide_which_finger_it_is() -> None:
    gates = gates_of(finger("left", pressed(LEFT)), finger("right", pressed(RIGHT)))
    assert verdicts(gates) == {
        ("reference", "left"): "fail",
        ("left_right", "left"): "pass",
        ("reference", "right"): "fail",
        ("left_right", "right"): "pass",
    }
    assert "Let go" in gates["reference", "left"].what_to_do


def test_one_moment_without_contact_is_enough() -> None:
    gates = gates_of(finger("left", pressed(LEFT), LEFT, pressed(LEFT)))
    assert gates["reference", "left"].verdict == "pass"


def test_without_references_it_is_said_how_to_capture_one() -> None:
    gates = gates_of(finger("left", LEFT), arrays={})
    assert verdicts(gates) == {("reference", "left"): "warn", ("left_right", "left"): "skipped"}
    assert "exumi calibrate tactile EPISODE --stream left" in gates["reference", "left"].what_to_do


def test_one_reference_tells_no_sides_and_alike_ones_neither() -> None:
    one = {"tactile_reference/left": LEFT}
    assert gates_of(finger("left", LEFT), arrays=one)["left_right", "left"].verdict == "skipped"
    alike = {**one, "tactile_reference/right": LEFT}
    gate = gates_of(finger("left", LEFT), arrays=alike)["left_right", "left"]
    assert (gate.verdict, gate.found) == ("skipped", "the references look alike")


def test_references_of_another_size() -> None:
    other = {name: gel(1, height=48, width=64) for name in REFERENCES}
    gates = gates_of(finger("left", LEFT), arrays=other)
    assert gates["reference", "left"].verdict == "fail"
    assert gates["reference", "left"].expected == "128x96, as the frames are"
    assert gates["left_right", "left"].verdict == "skipped"


def test_no_frames_and_damaged_ones() -> None:
    broken = stream("left", camera_port(), 1, frames=[shot(LEFT)[:200]])
    for each in (stream("left", camera_port()), broken):
        assert set(verdicts(gates_of(each)).values()) == {"skipped"}


def test_what_is_no_image_is_no_reference() -> None:
    flat = {"tactile_reference/left": np.zeros((3, 4), np.uint8)}
    assert gates_of(finger("left", LEFT), arrays=flat)["reference", "left"].verdict == "warn"
