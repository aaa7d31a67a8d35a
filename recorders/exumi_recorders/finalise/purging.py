"""Room for new recordings: the logs of journals that were discarded long enough ago are removed."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from exumi_recorders.finalise.recover import for_journals
from exumi_recorders.journal.states import STATE_NAME, bytes_of_logs, purge, read_state

__all__ = ["Discarded", "Purge", "purge_discarded"]

_S_PER_DAY = 86_400.0


@dataclass(frozen=True, slots=True)
class Discarded:
    """What became of a journal that may be a discarded one.

    Attributes
    ----------
    journal : pathlib.Path
    outcome : str
        ``purged``; ``found``: it would be, and was only looked at; ``kept``: it was discarded too
        short a time ago; ``nothing``: it was not discarded, or its logs were gone already.
    bytes : int
        Of its logs.
    days : float
        For how long it has been discarded, by the system's clock.
    reason : str or None
        Why it was discarded.
    """

    journal: Path
    outcome: Literal["purged", "found", "kept", "nothing"]
    bytes: int
    days: float
    reason: str | None


@dataclass(frozen=True, slots=True)
class Purge:
    """What became of all discarded journals.

    Attributes
    ----------
    done : tuple of Discarded
        Without those of which there was nothing to purge.
    failed : tuple of (pathlib.Path, str)
        Journals that could not be judged or purged, and why.
    """

    done: tuple[Discarded, ...]
    failed: tuple[tuple[Path, str], ...]

    @property
    def freed(self) -> int:
        """Bytes that were removed."""
        return sum(one.bytes for one in self.done if one.outcome == "purged")

    def to_json(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return {
            "journals": [
                {
                    "journal": str(one.journal),
                    "outcome": one.outcome,
                    "bytes": one.bytes,
                    "days": one.days,
                    "reason": one.reason,
                }
                for one in self.done
            ],
            "failed": [{"journal": str(path), "reason": reason} for path, reason in self.failed],
            "freed_bytes": self.freed,
        }


def purge_discarded(
    paths: Sequence[Path], *, older_than_days: float = 7.0, dry_run: bool = False
) -> Purge:
    """Remove the logs of discarded journals; nothing of any other journal is touched.

    Header and state of each stay as its tombstone. A journal that cannot be purged does not keep
    the others.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        Journals, datasets, or folders ``.recording``.
    older_than_days : float
        Only those that were discarded at least so long ago.
    dry_run : bool
        Look, and remove nothing.

    Returns
    -------
    Purge

    Raises
    ------
    UsageError
        A path is none of these. Nothing was done.
    """
    work = partial(_purged, older_than_days=older_than_days, dry_run=dry_run)
    done, failed = for_journals(paths, work)
    return Purge(tuple(one for one in done if one.outcome != "nothing"), tuple(failed))


def _purged(journal: Path, *, older_than_days: float, dry_run: bool) -> Discarded:
    state = read_state(journal)
    size = bytes_of_logs(journal) if state.state == "discarded" else 0
    if state.state != "discarded" or (state.purged and not size):
        return Discarded(journal, "nothing", 0, 0.0, state.reason)
    # The state is written when a journal is discarded, and hardly ever after that.
    days = (time.time() - (journal / STATE_NAME).stat().st_mtime) / _S_PER_DAY
    # One that is half gone, because a purge was interrupted, cannot come back anyway.
    if days < older_than_days and not state.purged:
        return Discarded(journal, "kept", size, days, state.reason)
    if dry_run:
        return Discarded(journal, "found", size, days, state.reason)
    return Discarded(journal, "purged", purge(journal), days, state.reason)
