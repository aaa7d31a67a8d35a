"""A recording in Rerun's native viewer."""

import os
import sys
from pathlib import Path

from exumi_data.errors import UnsupportedError
from exumi_data.view.program import run_rerun
from exumi_data.view.sdk import require_rerun

__all__ = ["check_display", "has_display", "look"]


def has_display() -> bool:
    """Return whether there is a screen to open a window on."""
    if sys.platform != "linux":
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"))


def check_display() -> None:
    """Check that there is a screen.

    Raises
    ------
    UnsupportedError
        There is none.
    """
    if not has_display():
        raise UnsupportedError(
            "there is no display to open the viewer on",
            fix="Write a file with --save FILE.rrd, or serve a browser with --web.",
        )


def look(recording: Path) -> None:
    """Open a recording in the native viewer, and wait until its window is closed.

    Parameters
    ----------
    recording : pathlib.Path
        The ``.rrd`` file.

    Raises
    ------
    MissingExtraError
        The Rerun SDK is not installed.
    UnsupportedError
        There is no display, or the viewer could not be opened.
    """
    require_rerun()
    check_display()
    # Its own window, whatever other viewers are open.
    code, printed = run_rerun("--new", "--hide-welcome-screen", str(recording))
    if code != 0:
        last = printed.strip().rpartition("\n")[2]
        raise UnsupportedError(
            f"the viewer ended with code {code}: {last}",
            fix="Serve a browser with --web, or write a file with --save FILE.rrd.",
        )
