"""Calibration of a rig: pure functions from readings to calibration items, and their file.

One module a procedure: `contact` (latency of touch and images, by grasps), `controller` (where the
tool is), `tactile` (reference, rectification, depth), `camera` (intrinsics). `files` reads and
writes what they find, `apply` puts it into episodes. What converters need as well is in the core:
`exumi_data.gripper_readings` (counts to width) and `exumi_data.synchronisation.sweep` (latency of
poses, by a marker).
"""

__all__: list[str] = []
