"""Clips of a camera that the hub does not see, attached to the session of which they are."""

from exumi_recorders.attach.report import AttachReport, ClipReport, MissingReport
from exumi_recorders.attach.run import AttachOptions, attach

__all__ = ["AttachOptions", "AttachReport", "ClipReport", "MissingReport", "attach"]
