"""Pose and width as signals: jumps, frozen tracking, wrapped counts, calibrated ranges."""

__all__: list[str] = []
