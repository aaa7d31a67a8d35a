"""The play session of ``exumi demo``: recorded live, or written straight from the simulation."""

import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from exumi_data.cli.output import progress_of, size_text, time_text
from exumi_data.wording import counted

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset
    from exumi_data.demo import DemoSettings
    from exumi_data.simulation import PlaySession

__all__ = ["Played", "record", "simulate"]


@dataclass(frozen=True, slots=True)
class Played:
    """A play session that is a dataset now.

    Attributes
    ----------
    dataset : Dataset
    session : PlaySession
        The truth.
    epoch_ns : int
        The episodes' clock at the session's start.
    text : str
        What was done, for people.
    """

    dataset: "Dataset"
    session: "PlaySession"
    epoch_ns: int
    text: str

    @property
    def command(self) -> str:
        """The command that makes such a dataset."""
        made_by = self.dataset.metadata.made_by
        return (made_by.command if made_by else None) or ""


def simulate(root: Path, settings: "DemoSettings", *, workers: int | None, quiet: bool) -> Played:
    """Write the session straight from the simulation.

    Parameters
    ----------
    root : pathlib.Path
    settings : DemoSettings
    workers : int, optional
    quiet : bool
    """
    from exumi_data.demo import make_session, write_play_dataset

    began = time.perf_counter()
    with progress_of("Simulating", quiet=quiet) as update:
        dataset = write_play_dataset(
            root,
            settings,
            workers=workers,
            on_done=lambda done, total: update(done, total, "grasps"),
        )
    session = make_session(settings.seed, settings.seconds)
    return Played(dataset, session, 0, _text(dataset, settings.seconds, began))


def record(root: Path, settings: "DemoSettings", *, quiet: bool) -> Played:
    """Record the session in real time, through the recorder and its drivers.

    Parameters
    ----------
    root : pathlib.Path
    settings : DemoSettings
    quiet : bool

    Raises
    ------
    ExumiError
        Something could not be recorded.
    """
    import exumi_data
    from exumi_data.dataset import create_dataset
    from exumi_data.demo import dataset_metadata
    from exumi_data.errors import ExumiError
    from exumi_recorders.rig.simulated import SimulatedSettings
    from exumi_recorders.session.plan import Plan
    from exumi_recorders.session.play import record_play

    began = time.perf_counter()
    create_dataset(root, dataset_metadata(settings, direct=False))
    plan = Plan(
        task="tabletop-play",
        instruction="Pick up what lies on the table, feel it, and put it down again.",
        regime="play",
        is_simulated=True,
    )
    simulated = SimulatedSettings(
        seed=settings.seed, seconds=settings.seconds, frame_width=settings.frame_width
    )
    played = record_play(root, simulated, plan, quiet=quiet)
    problems = played.report.problems
    if problems or not played.report.finished:
        raise ExumiError(
            problems[0] if problems else "no grasp was recorded",
            where=root,
            fix="Try again when this machine has less to do, or with --direct.",
        )
    dataset = exumi_data.open(root)
    assert isinstance(dataset, exumi_data.Dataset)  # noqa: S101  # it was made as one
    text = f"{_text(dataset, settings.seconds, began)}, {_lost(dataset)}"
    return Played(dataset, played.session, played.epoch_ns, text)


def _text(dataset: "Dataset", seconds: float, began: float) -> str:
    """Say what there is: less time than was played, as an episode is one grasp."""
    streams = [stream["name"] for stream in dataset.catalog.column("streams")[0].as_py()]
    size = size_text(sum(dataset.catalog.column("bytes").to_pylist()))
    kept = time_text(sum(dataset.catalog.column("duration_s").to_pylist()))
    took = time_text(time.perf_counter() - began)
    return (
        f"{counted(len(dataset), 'grasp')}, one episode each ({', '.join(streams)}), {size} "
        f"in {took}; {kept} of the {seconds:g} s are in episodes, the rest lies before, "
        "between and after the grasps"
    )


def _lost(dataset: "Dataset") -> str:
    """Say what did not arrive: a machine that has much to do loses samples."""
    lost: Counter[str] = Counter()
    for episode in dataset:
        for name, stream in episode.streams.items():
            lost[name] += sum((stream.metadata.lost or {}).values())
    found = ", ".join(f"{number:,} of {name}" for name, number in lost.items() if number)
    return f"lost {found}" if found else "nothing lost"
