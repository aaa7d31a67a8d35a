"""Calibration of a rig: pure functions from readings to calibration items, and their file.

One module a procedure: `gripper` (counts to width), `sweep` (latency of poses, by a marker),
`contact` (latency of touch and images, by grasps), `controller` (where the tool is), `tactile`
(reference, rectification, depth), `camera` (intrinsics). `files` reads and writes what they find,
`apply` puts it into episodes.
"""

__all__: list[str] = []
