"""``--engine`` and ``--ray-address``: where the episodes are worked on."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from exumi_data.engine import Engine

__all__ = ["EngineName", "EngineOption", "RayAddressOption", "chosen_engine"]


class EngineName(StrEnum):
    """Where the episodes are worked on."""

    LOCAL = "local"
    RAY = "ray"


EngineOption = Annotated[
    EngineName,
    typer.Option(
        "--engine",
        help="Work with processes of this machine, or on a Ray cluster whose nodes see the same "
        "files.",
    ),
]
RayAddressOption = Annotated[
    str | None,
    typer.Option(
        "--ray-address",
        metavar="HOST:PORT",
        help="Head of the Ray cluster. Default: what RAY_ADDRESS says, else the cluster that runs "
        "on this machine, else one that is started on it for this command.",
    ),
]


@contextmanager
def chosen_engine(
    name: EngineName,
    address: str | None,
    *,
    workers: int | None,
    reads: Sequence[str | Path],
    writes: Sequence[Path] = (),
    quiet: bool,
) -> "Iterator[Engine | None]":
    """Join a cluster, where one was asked for, while the block runs.

    Parameters
    ----------
    name : EngineName
    address : str, optional
    workers : int, optional
    reads : sequence of str or pathlib.Path
        What will be read. URLs are not looked for on the nodes.
    writes : sequence of pathlib.Path
        What will be made.
    quiet : bool

    Yields
    ------
    Engine or None
        None for processes of this machine.

    Raises
    ------
    UsageError
        The options contradict each other, or the cluster cannot be used for this.
    MissingExtraError
        Ray is not installed.
    """
    from exumi_data.cli.output import error_console
    from exumi_data.errors import UsageError

    if name is EngineName.LOCAL:
        if address is not None:
            raise UsageError("--ray-address goes with --engine ray", fix="Add it.")
        yield None
        return
    from exumi_data.engine.ray_cluster import access_token, find_cluster
    from exumi_data.engine.ray_engine import ray_engine

    address = find_cluster(address) or "local"
    if address == "local":
        os.environ.update(access_token())
    here = [Path(one) for one in reads if "://" not in str(one)]
    with ray_engine(address, workers=workers, reads=here, writes=writes) as engine:
        if not quiet:
            which = "a Ray cluster of its own" if engine.own else "the Ray cluster"
            nodes = f"{engine.nodes:,} node{'' if engine.nodes == 1 else 's'}"
            error_console().print(
                f"note: on {which}: {nodes}, {engine.processors:,} processors",
                style="dim",
                markup=False,
            )
        yield engine
