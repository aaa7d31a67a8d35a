"""Clips of a camera that the hub does not see, attached to the session in which they were filmed."""

from exumi_recorders.attach.report import AttachReport, ClipReport, MissingReport
from exumi_recorders.attach.run import AttachOptions, attach

__all__ = ["AttachOptions", "AttachReport", "ClipReport", "MissingReport", "attach"]
