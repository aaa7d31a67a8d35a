"""A rule of our own: an episode is of a task that our lab works on, and ends with a verdict."""

from collections.abc import Iterator

from exumi_data.standard import Rule
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped

__all__ = ["TASKS", "VERDICT", "known_task", "verdict"]

NAMES = ("stack the cups", "open the jar", "sort by touch")

TASKS = Rule(
    id="acme:TASK-001",
    level="document",
    severity="error",
    title="the task is one of the lab's",
    message="the task is {found!r}; ours are {expected}",
    suggestion="Correct it: exumi dataset relabel DATASET EPISODE --task NAME",
    anchor="https://acme.example/rules#TASK-001",
    since="1",
)
VERDICT = Rule(
    id="acme:TASK-002",
    level="document",
    severity="warning",
    title="a demonstration says whether it succeeded",
    message="nobody has said whether this demonstration succeeded",
    suggestion="Say it: exumi dataset rate DATASET EPISODE --success",
    anchor="https://acme.example/rules#TASK-002",
    since="1",
)


@check(TASKS)
def known_task(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the task is one that we know: a typing mistake makes a task of its own."""
    task = episode.section("task")
    name = task.name if task is not None else None
    if name not in NAMES:
        where = ("attributes", "exumi", "task")
        yield problem(TASKS, "zarr.json", pointer=where, expected=list(NAMES), found=name)


@check(VERDICT)
def verdict(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that demonstrations are rated; play cannot fail."""
    if episode.section("regime") != "demonstration":
        yield Skipped(VERDICT.id, "only demonstrations succeed or fail", "zarr.json")
    elif not isinstance(episode.section("success"), bool):
        yield problem(VERDICT, "zarr.json", pointer=("attributes", "exumi", "success"))
