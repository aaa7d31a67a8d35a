"""The command line: ``exumi VERB``, one module a verb.

Every verb imports what it needs when it runs, so that ``exumi --help`` is fast and converting needs
no PyTorch. This is the one part of `exumi_data` that imports the other four packages.

Results go to stdout, everything else (progress, notes, errors) to stderr. Exit codes:

===  =============================================================================
0    done; for ``validate``: valid
1    done, and something was found wrong: invalid data, or files not converted
2    could not run: wrong arguments, nothing to read, no room to write
70   a bug in exUMI Data
130  interrupted with Ctrl-C
===  =============================================================================
"""

import signal

__all__ = ["main"]


def main() -> None:
    """Run the program; ends the process with one of the package's exit codes."""
    # Ctrl-C while everything is still being loaded ends the program without a traceback.
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from exumi_data.cli.app import main as run

    signal.signal(signal.SIGINT, before)
    run()
