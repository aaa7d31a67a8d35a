"""A process that sends requests for one that was forked: ``python -m``; see `fetching`."""

import os
import signal
import sys

from exumi_data.store.remote.fetching import serve

__all__ = ["main"]


def main() -> None:
    """Answer what comes on stdin until it ends."""
    # Ctrl-C reaches every process of the terminal; this one ends when the one it works for does.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        serve(sys.stdin.buffer, sys.stdout.buffer)
    except BrokenPipeError:  # it was killed while it waited: nobody wants the answer
        os._exit(0)  # returning would flush the pipe, and fail once more


if __name__ == "__main__":
    main()
