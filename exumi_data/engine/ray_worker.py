"""What runs in the processes of a Ray cluster. Nothing here imports ray."""

import os
import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from exumi_data._version import __version__
from exumi_data.engine.work import call_in_worker, stop, use_one_thread

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["NodeReport", "look_around", "run_item"]

Item = TypeVar("Item")
Value = TypeVar("Value")

# What writes the bytes of episodes, or decides what is written.
_PACKAGES = (
    "av",
    "numcodecs",
    "numpy",
    "opencv-contrib-python-headless",
    "scipy",
    "simplejpeg",
    "zarr",
)


@dataclass(frozen=True, slots=True)
class NodeReport:
    """What a node of a cluster has.

    Attributes
    ----------
    version : str
        Of exumi-data.
    packages : mapping of str to str
        Versions of what episodes are written with.
    missing : tuple of str
        Which of the paths that were asked for are not there.
    read_only : tuple of str
        Which of the folders that were asked for may not be written.
    """

    version: str
    packages: Mapping[str, str]
    missing: tuple[str, ...] = ()
    read_only: tuple[str, ...] = ()


def look_around(paths: Sequence[str], folders: Sequence[str]) -> NodeReport:
    """Tell what this machine has.

    Parameters
    ----------
    paths : sequence of str
        Files and folders that should be there.
    folders : sequence of str
        Folders that will be written into.
    """
    packages = {}
    for name in _PACKAGES:
        with suppress(PackageNotFoundError):
            packages[name] = version(name)
    return NodeReport(
        __version__,
        packages,
        tuple(path for path in paths if not Path(path).exists()),
        tuple(path for path in folders if Path(path).exists() and not os.access(path, os.W_OK)),
    )


def run_item(
    function: Callable[[Item], Value], item: Item, folder: str
) -> tuple[Value | None, Exception | None]:
    """Call a function as a worker of this machine would; return its value or its error.

    Parameters
    ----------
    function : callable
    item : object
    folder : str
        Where the program that wants it works: paths may be relative.
    """
    use_one_thread()
    # A path that is not relative does not need it.
    with suppress(OSError):
        os.chdir(folder)
    with _unwinding():
        outcome = call_in_worker(function, item)
    return outcome.value, outcome.error


@contextmanager
def _unwinding() -> "Iterator[None]":
    """Remove what is half written when Ray ends this worker, as it does when its node leaves."""
    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
