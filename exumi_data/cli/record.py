"""``exumi record``."""

import signal
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer

from exumi_data.cli.options import epilog, given_path

if TYPE_CHECKING:
    from exumi_recorders.session.messages import SessionReport
    from exumi_recorders.session.operator import Operator
    from exumi_recorders.session.session import Session

__all__ = ["EPILOG", "Pad", "RegimeName", "run"]

EPILOG = epilog(
    "exumi record --rig simulated --task 'pick up what is there' --duration 10 --out my-dataset",
    "exumi record --rig rig.toml --task 'wipe the board' --operator p03",
    "exumi record --rig rig.toml --task 'feel' --regime touch --object mug --part handle \\\n"
    "      --procedure slide --pad-type plain",
    "exumi record --rig rig.toml --task 'wipe the board' --preview 0.0.0.0:8642 --status-json",
)


class RegimeName(StrEnum):
    """What the episodes are."""

    DEMONSTRATION = "demonstration"
    PLAY = "play"
    TOUCH = "touch"


class Pad(StrEnum):
    """What the gel's pad looks like."""

    PLAIN = "plain"
    DOTTED = "dotted"


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    rig: Annotated[
        str,
        typer.Option(help="The rig file (see `exumi rig init`), or: simulated."),
    ],
    task: Annotated[str, typer.Option(help="Name of the task.")],
    out: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="DATASET",
            help="The dataset to add to, made if it is not there. Default: that of the rig file.",
        ),
    ] = None,
    instruction: Annotated[
        str | None, typer.Option(help="The task in plain language, as a policy would be told.")
    ] = None,
    regime: Annotated[RegimeName, typer.Option(help="What is recorded.")] = (
        RegimeName.DEMONSTRATION
    ),
    duration: Annotated[
        float | None,
        typer.Option(
            min=0.5,
            help="Length of an episode, seconds. Recording then begins at once, without the "
            "operator.",
        ),
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(min=1, help="End after so many. Default: 1 with --duration, else no end."),
    ] = None,
    pause: Annotated[
        float, typer.Option(min=0, help="Between episodes of --duration, seconds.")
    ] = 3.0,
    object_name: Annotated[
        str | None, typer.Option("--object", help="What is touched, in plain words.")
    ] = None,
    part: Annotated[str | None, typer.Option(help="Which part of it.")] = None,
    procedure: Annotated[
        str | None, typer.Option(help="How it is touched: press, slide, twist.")
    ] = None,
    pad_type: Annotated[Pad | None, typer.Option(help="The gel's pad.")] = None,
    operator: Annotated[str | None, typer.Option(help="A pseudonym.")] = None,
    site: Annotated[str | None, typer.Option(help="Where it is recorded.")] = None,
    licence: Annotated[
        str | None, typer.Option(help="SPDX expression. Default: that of the rig file.")
    ] = None,
    preview: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="Show the cameras in a browser, such as on 127.0.0.1:8642; on other machines "
            "only with a HOST such as 0.0.0.0.",
        ),
    ] = None,
    uncalibrated: Annotated[
        bool,
        typer.Option(
            "--uncalibrated",
            help="Record although the calibration lacks what widths need: to calibrate by it.",
        ),
    ] = False,
    status_json: Annotated[
        bool,
        typer.Option(
            "--status-json",
            help="Print JSON lines on stdout, and take commands as lines on stdin: start, stop, "
            "discard REASON, undo, success, failure, reference, quit.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the simulated rig.")] = 7,
) -> None:
    """Record episodes with a rig: start and stop with the controller's button or the space bar.

    Everything is on disk within half a second, and survives a crash: `exumi recover` makes an
    episode of what was recorded until then. Ctrl-C ends the session cleanly. Exit code 1 if an
    episode could not be finished.
    """
    from exumi_data.cli.failures import FOUND_WRONG, INTERRUPTED
    from exumi_recorders.rig.simulated import NAME
    from exumi_recorders.session.labels import TouchLabels
    from exumi_recorders.session.operator import Operator
    from exumi_recorders.session.plan import Plan
    from exumi_recorders.session.preview import parse_address
    from exumi_recorders.session.running import open_session

    if rig != NAME:
        given_path(rig)
    auto = duration is not None
    plan = Plan(
        task=task,
        instruction=instruction,
        regime=regime.value,
        labels=TouchLabels(object_name, part, procedure, pad_type.value if pad_type else None),
        duration_s=duration,
        auto=auto,
        pause_s=pause,
        episodes=1 if auto and episodes is None else episodes,
        operator=operator,
        site=site,
        licence=licence,
        uncalibrated=uncalibrated,
    )
    address = None if preview is None else parse_address(preview)
    operator_view: Operator = Operator(as_json=status_json)
    interrupted = False
    with operator_view, _Signals() as signals:
        with open_session(rig, out, plan, operator_view, seed=seed, preview=address) as session:
            try:
                signals.end(session)
                session.run()
            except KeyboardInterrupt:
                interrupted = True
            finally:
                signals.ignore()
        _report(operator_view, session.report)
    if interrupted:
        raise typer.Exit(INTERRUPTED)
    if session.report.problems or session.report.left:
        raise typer.Exit(FOUND_WRONG)


class _Signals:
    """What Ctrl-C, SIGTERM and a lost connection do; as before after the block.

    Before a session is there, they end the program.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def end(self, session: "Session") -> None:
        """End a session cleanly from now on; at once on a second Ctrl-C.

        A lost connection comes as several SIGHUP: of the terminal, and of the shell.
        """
        asked = False

        def end(number: int, _frame: Any) -> None:
            nonlocal asked
            if asked and number == signal.SIGINT:
                raise KeyboardInterrupt
            asked = True
            session.command("quit")

        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            # Under nohup a lost connection is nothing to end for.
            if number is not None and (
                name != "SIGHUP" or signal.getsignal(number) is not signal.SIG_IGN
            ):
                self._before[number] = signal.signal(number, end)

    def ignore(self) -> None:
        """Hear none of them any more: closing devices takes a moment, and ends by itself."""
        for number in self._before:
            signal.signal(number, signal.SIG_IGN)


def _report(operator: "Operator", report: "SessionReport") -> None:
    kept = [one for one in report.finished if one.episode is not None]
    text = f"{len(kept)} {'episode' if len(kept) == 1 else 'episodes'} kept, "
    text += f"{len(report.discarded)} discarded"
    if report.left:
        dataset = report.left[0].parents[1]
        text += f", {len(report.left)} not finished: exumi recover {dataset}"
    operator.end(
        {
            "type": "report",
            "episodes": [str(one.episode) for one in kept],
            "discarded": [str(path) for path in report.discarded],
            "problems": report.problems,
            "left": [str(path) for path in report.left],
        },
        text,
    )
