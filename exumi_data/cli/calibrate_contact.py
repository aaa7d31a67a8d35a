"""``exumi calibrate contact``."""

from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.calibrate_options import EpisodeArgument, OutOption, check_out, finish
from exumi_data.cli.options import Format, FormatOption, epilog

if TYPE_CHECKING:
    from exumi_data.episode import Episode, StreamView
    from exumi_recorders.calibration.contact import ContactLatency

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi calibrate contact grasps.zarr --out rig.json",
    "exumi calibrate contact grasps.zarr --stream tactile_left --stream rgb --out rig.json",
)


def run(
    episode: EpisodeArgument,
    out: OutOption,
    stream: Annotated[
        list[str] | None,
        typer.Option(
            help="Tactile stream or camera; may be given several times. Default: all "
            "tactile streams."
        ),
    ] = None,
    width: Annotated[
        str | None, typer.Option(help="Stream of widths. Default: the only one, or width.")
    ] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Find the latency of touch and cameras from grasps of something rigid.

    Close slowly on something that does not give way, and open until nothing is touched, ten times,
    with the hand at rest. The encoder's width is what the others are compared with. Exit code 1 if
    a stream does not tell; the others are written.
    """
    from exumi_data.calibration_items import LATENCY, CalibrationRefusedError
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import error_console, print_json
    from exumi_data.episode import open_episode
    from exumi_data.errors import UsageError
    from exumi_recorders.calibration.contact import contact_item
    from exumi_recorders.calibration.files import Calibration
    from exumi_recorders.calibration.recordings import stream_of

    check_out(out)
    items, refused = {}, {}
    with open_episode(episode) as opened:
        widths = stream_of(opened, "width", width)
        names = list(dict.fromkeys(stream or ())) or [one.name for one in opened.of_kind("tactile")]
        if not names:
            raise UsageError("no tactile stream", where=episode, fix="Name a camera: --stream.")
        sigma_s = 1e-9 * (widths.metadata.clock.latency_sigma_ns or 0.0)
        for name in names:
            try:
                found = _latency(opened, name, widths)
                items[LATENCY + name] = contact_item(found, width_sigma_s=sigma_s)
            except CalibrationRefusedError as error:
                refused[name] = str(error)
    if items:
        finish(Calibration(items), out, output, [episode], {"refused": refused})
    elif output is Format.JSON:
        print_json({"file": None, "items": {}, "refused": refused})
    console = error_console()
    for name, reason in refused.items():
        console.print(f"[bold red]refused:[/] {name}: ", end="")
        console.print(reason, markup=False)
    if refused:
        raise typer.Exit(FOUND_WRONG)


def _latency(episode: "Episode", name: str, widths: "StreamView") -> "ContactLatency":
    from exumi_data.errors import UsageError
    from exumi_recorders.calibration.contact import image_latency, touch_latency
    from exumi_recorders.calibration.recordings import (
        activity_of,
        as_stamped,
        motion_energy,
        width_track,
    )

    stream = episode[name]
    stamps = as_stamped(stream)
    if stream.kind == "tactile":
        return touch_latency(stamps, activity_of(stream), *width_track(widths))
    if stream.kind == "rgb":
        return image_latency(stamps, motion_energy(stream.frames), *width_track(widths))
    raise UsageError(f"{name!r} is a stream of kind {stream.kind}", fix="Name touch or a camera.")
