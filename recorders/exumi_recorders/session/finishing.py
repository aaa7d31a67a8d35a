"""Finalising in the background: one process after the other, so that recording is not disturbed."""

import json
import queue
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Finished", "Finisher"]

_NICE = "10"


@dataclass(frozen=True, slots=True)
class Finished:
    """What became of a journal.

    Attributes
    ----------
    journal : pathlib.Path
    episode : pathlib.Path or None
        None where it could not be finalised; the journal is then still there.
    samples : dict of str to int
    damages : int
    truncated : str or None
    problem : str or None
        Why it could not be finalised.
    """

    journal: Path
    episode: Path | None
    samples: dict[str, int]
    damages: int = 0
    truncated: str | None = None
    problem: str | None = None


class Finisher:
    """Turns stopped journals into episodes, in the order in which they come.

    Parameters
    ----------
    on_done : callable
        Told of each, in a thread of its own.
    """

    def __init__(self, on_done: Callable[[Finished], None]) -> None:
        self._on_done = on_done
        self._jobs: queue.Queue[Path | None] = queue.Queue()
        self._process: subprocess.Popen[bytes] | None = None
        self._given_up = threading.Event()
        self._waiting = 0
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._work, name="finisher", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """How many journals are not finished yet."""
        return self._waiting

    def put(self, journal: Path) -> None:
        """Add a stopped journal.

        Parameters
        ----------
        journal : pathlib.Path
        """
        with self._lock:
            self._waiting += 1
        self._jobs.put(journal)

    def close(self) -> None:
        """Wait until all are finished."""
        self._jobs.put(None)
        while self._thread.is_alive():
            self._thread.join(0.2)  # so that Ctrl-C is heard

    def give_up(self) -> None:
        """Stop at once; what is not finished stays a journal, for ``exumi recover``."""
        self._given_up.set()
        process = self._process
        if process is not None:
            process.terminate()
        self._jobs.put(None)
        self._thread.join(10.0)

    def _work(self) -> None:
        while (journal := self._jobs.get()) is not None and not self._given_up.is_set():
            done = self._finish(journal)
            with self._lock:
                self._waiting -= 1
            # What was done in the last instant is an episode all the same.
            if done.episode is not None or not self._given_up.is_set():
                self._on_done(done)

    def _finish(self, journal: Path) -> Finished:
        command = [sys.executable, "-m", "exumi_data.cli", "recover"]
        # Two dashes: a dataset's name may begin with one.
        command += ["--format", "json", "--quiet", "--", str(journal)]
        nice = shutil.which("nice")
        if nice:
            command = [nice, "-n", _NICE, *command]
        try:
            self._process = subprocess.Popen(  # noqa: S603  # our own program
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C at the terminal is for the recorder alone
            )
        except OSError as error:
            return Finished(journal, None, {}, problem=f"cannot be finalised: {error.strerror}")
        out, err = self._process.communicate()
        self._process = None
        return _read(journal, out, err)


def _read(journal: Path, out: bytes, err: bytes) -> Finished:
    try:
        document: dict[str, Any] = json.loads(out)
    except ValueError:
        said = err.decode(errors="replace").strip().splitlines()
        return Finished(journal, None, {}, problem=said[-1] if said else "ended without a word")
    if document["failed"]:
        return Finished(journal, None, {}, problem=document["failed"][0]["reason"])
    (one,) = document["journals"]
    episode = None if one["episode"] is None else Path(one["episode"])
    return Finished(
        journal,
        episode,
        one["samples"],
        damages=len(one["damages"]),
        truncated=one["truncated"],
        problem=None if episode else f"is {one['outcome']}",
    )
