"""What a verification has read so far, so that one that was killed goes on where it was.

It lies in the user's cache folder, never in the data, and is gone when a verification has come to
its end: the next one reads everything again.
"""

import json
import os
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from types import TracebackType
from typing import Self, TextIO

from exumi_data.stopping import Stopped

__all__ = ["FileState", "VerifyState", "stamp_of", "state_folder"]

_FORGOTTEN_AFTER_S = 24 * 3600.0


@dataclass(frozen=True, slots=True)
class FileState:
    """What was read of a file.

    Attributes
    ----------
    path : str
        Relative to the release.
    bytes : int
    stamp : tuple of int
        Which the file had then: it is read again when it has others.
    sha256 : str or None
        None where it could not be read.
    digest : str or None
        Of a packed episode.
    problem : str or None
        Why it could not be read, or is no packed episode.
    """

    path: str
    bytes: int
    stamp: tuple[int, ...]
    sha256: str | None
    digest: str | None
    problem: str | None


def stamp_of(found: os.stat_result) -> tuple[int, ...]:
    """Return what changes when a file does: also where its date is set back, or one takes its name.

    Parameters
    ----------
    found : os.stat_result
    """
    return (found.st_mtime_ns, found.st_ctime_ns, found.st_ino)


def state_folder() -> Path:
    """Return where it lies: below ``$EXUMI_CACHE``, or in the user's own cache folder."""
    import platformdirs  # used here alone

    chosen = os.environ.get("EXUMI_CACHE")
    base = Path(chosen) if chosen else platformdirs.user_cache_path("exumi-data", appauthor=False)
    return base / "verify"


class VerifyState:
    """The files of one release that were read, while a verification lasts.

    A cache that cannot be written is no error: then nothing is remembered.

    Parameters
    ----------
    path : pathlib.Path
        Its file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[str, FileState] = {}
        self._file: TextIO | None = None

    @classmethod
    def of(cls, root: Path, fingerprint: str) -> Self:
        """Return the state of a release in a folder.

        Parameters
        ----------
        root : pathlib.Path
        fingerprint : str
            SHA-256 of its manifest.
        """
        name = sha256(f"{root.resolve()}\n{fingerprint}".encode()).hexdigest()[:40]
        return cls(state_folder() / f"{name}.jsonl")

    def __enter__(self) -> Self:
        with suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            if self._path.exists():
                if time.time() - self._path.stat().st_mtime > _FORGOTTEN_AFTER_S:
                    self._path.unlink()
                else:
                    self._read()
            self._file = self._path.open("a", encoding="utf-8")
            self._file.write("\n")  # after a line that was being written
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            self._file.close()
        if not isinstance(error, KeyboardInterrupt | Stopped):
            with suppress(OSError):
                self._path.unlink(missing_ok=True)

    def get(self, root: Path, path: str) -> FileState | None:
        """Return what was read of a file, if it is still the same.

        Parameters
        ----------
        root : pathlib.Path
            The release.
        path : str
        """
        known = self._known.get(path)
        if known is None:
            return None
        try:
            there = (root / path).lstat()
        except OSError:
            return None
        return known if (there.st_size, stamp_of(there)) == (known.bytes, known.stamp) else None

    def put(self, state: FileState) -> None:
        """Remember what was read of a file.

        Parameters
        ----------
        state : FileState
        """
        if self._file is None:
            return
        try:
            self._file.write(json.dumps(asdict(state)) + "\n")
            self._file.flush()
        except OSError:
            self._file = None

    def _read(self) -> None:
        for line in self._path.read_text("utf-8", errors="replace").splitlines():
            try:
                entry = json.loads(line)
                state = FileState(**{**entry, "stamp": tuple(entry["stamp"])})
                self._known[state.path] = state
            except (ValueError, TypeError, KeyError):
                continue
