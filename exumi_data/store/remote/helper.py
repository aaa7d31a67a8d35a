"""A process that sends requests for one that was forked: ``python -m``; see `fetching`."""

import signal
import sys

from exumi_data.store.remote.fetching import serve

__all__ = ["main"]


def main() -> None:
    """Answer what comes on stdin until it ends."""
    # Ctrl-C reaches every process of the terminal; this one ends when the one it works for does.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    serve(sys.stdin.buffer, sys.stdout.buffer)


if __name__ == "__main__":
    main()
