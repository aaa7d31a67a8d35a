"""A simulated device that ends with the program that started it, even if that was killed.

``python -m exumi_recorders.simulated.leash MODULE OPTIONS`` runs a device until stdin ends, which
is a pipe that the parent holds.
"""

import os
import runpy
import sys
import threading

__all__ = ["main"]


def main() -> None:
    """Run the module that the command line names."""
    sys.argv = sys.argv[1:]
    threading.Thread(target=_end_with_stdin, name="leash", daemon=True).start()
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


def _end_with_stdin() -> None:
    while os.read(0, 1 << 10):
        pass
    # At once, whatever the device does: nothing of it is worth keeping.
    os._exit(0)


if __name__ == "__main__":
    main()
