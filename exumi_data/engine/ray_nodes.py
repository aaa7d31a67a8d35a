"""Whether the nodes of a Ray cluster can do what is asked: the same program, the same files."""

import secrets
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from exumi_data.engine.ray_cluster import ray_module
from exumi_data.engine.ray_worker import NodeReport, look_around
from exumi_data.errors import UsageError

__all__ = ["check_nodes", "node_name", "problems_of", "working_nodes"]

_ANSWERS_WITHIN_S = 60.0
_SEEN_WITHIN_S = 5.0  # a file that is new is not seen at once on every network file system


def working_nodes() -> list[dict[str, Any]]:
    """Return the nodes that can be given work, as Ray describes them."""
    ray = ray_module()
    return [node for node in ray.nodes() if node["Alive"] and node["Resources"].get("CPU")]


def check_nodes(reads: Sequence[Path], writes: Sequence[Path]) -> None:
    """See to it that every node has this version of the library, and the same files.

    Parameters
    ----------
    reads : sequence of pathlib.Path
        What must be there.
    writes : sequence of pathlib.Path
        What will be made or written into.

    Raises
    ------
    UsageError
        Names each node that cannot take part, and why.
    """
    found = problems_of(working_nodes(), reads, writes)
    if wrong := [f"{name}: {problem}" for name, problems in found.items() for problem in problems]:
        raise UsageError(
            "not every node of the Ray cluster can do this: " + "; ".join(wrong),
            fix="Each needs this version of exumi-data, and the same files under the same paths "
            "(a shared file system).",
        )


def problems_of(
    nodes: Sequence[Mapping[str, Any]], reads: Sequence[Path], writes: Sequence[Path]
) -> dict[str, list[str]]:
    """Say why nodes cannot take part.

    Parameters
    ----------
    nodes : sequence of mapping
        As `working_nodes` gives them.
    reads, writes : sequence of pathlib.Path
        As of `check_nodes`.

    Returns
    -------
    dict of str to list of str
        For each node, as it is named in messages: nothing where it can.
    """
    folders = {str(_existing(path)) for path in writes}
    # What is not here either, the command itself will name.
    paths = {str(path.absolute()) for path in reads if path.exists()}
    if any(not path.is_absolute() for path in (*reads, *writes)):
        paths.add(str(Path.cwd()))
    with _marked(sorted(folders)) as marks:
        asked = {
            node_name(node): _ask(node, sorted({*paths, *marks}), sorted(folders)) for node in nodes
        }
        here = look_around((), ())
        return {name: list(_problems(answer, here, marks)) for name, answer in asked.items()}


def node_name(node: Mapping[str, Any]) -> str:
    """Return what a node is called in messages."""
    host, address = node["NodeManagerHostname"], node["NodeManagerAddress"]
    return f"node {host} ({address}, {node['NodeID'][:8]})"


def _ask(node: Mapping[str, Any], paths: list[str], folders: list[str]) -> Any:
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    there = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
    # No processor is asked for: others may work on all of them.
    ask = ray_module().remote(num_cpus=0, max_retries=1, scheduling_strategy=there)(
        _question(paths, folders, _SEEN_WITHIN_S)
    )
    return ask.remote()


def _question(
    paths: list[str], folders: list[str], patience_s: float
) -> Callable[[], NodeReport | str]:
    def question() -> NodeReport | str:
        """Look around; a function within a function is sent as it is, to where we may not be."""
        try:
            from exumi_data.engine.ray_worker import look_around as look
        except ImportError as error:
            return str(error)
        end = time.monotonic() + patience_s
        while (report := look(paths, folders)).missing and time.monotonic() < end:
            time.sleep(0.2)
        return report

    return question


def _problems(answer: Any, here: NodeReport, marks: Mapping[str, str]) -> Iterator[str]:
    ray = ray_module()
    try:
        report = ray.get(answer, timeout=_ANSWERS_WITHIN_S)
    except ray.exceptions.TaskUnschedulableError:
        return  # the node has left, which is not known at once
    except ray.exceptions.RayError as error:
        yield f"does not answer ({type(error).__name__})"
        return
    if isinstance(report, str):
        yield f"exumi-data cannot be loaded ({report})"
        return
    if report.version != here.version:
        yield f"has exumi-data {report.version}, this is {here.version}"
    for path in report.missing:
        if path in marks:
            yield f"its {marks[path]} is another folder than ours"
        else:
            yield f"has no {path}"
    for path in report.read_only:
        yield f"may not write into {path}"
    differing = [
        f"{name} {report.packages.get(name, 'missing')} (here {found})"
        for name, found in here.packages.items()
        if report.packages.get(name) != found
    ]
    if differing:
        warnings.warn(
            f"a node of the cluster has other versions of what episodes are made with, so their "
            f"bytes may differ: {', '.join(differing)}",
            stacklevel=2,
        )


def _existing(path: Path) -> Path:
    """Return a folder or the nearest one above it that is there."""
    path = path.absolute()
    return next((one for one in (path, *path.parents) if one.is_dir()), path)


@contextmanager
def _marked(folders: Sequence[str]) -> Iterator[dict[str, str]]:
    """Put an empty file into folders for a moment: a name alone does not make them the same."""
    marks: dict[str, str] = {}
    try:
        for folder in folders:
            mark = Path(folder, f".partial-seen-{secrets.token_hex(8)}")
            try:
                mark.touch(exist_ok=False)
            except OSError:
                continue  # the command itself will say that it cannot be written
            marks[str(mark)] = folder
        yield marks
    finally:
        for name in marks:
            Path(name).unlink(missing_ok=True)
