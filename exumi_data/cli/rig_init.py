"""``exumi rig init``."""

from typing import Annotated

import typer

from exumi_data.cli.options import epilog, given_path

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi rig init exumi rig.toml",
    "exumi rig init tmi rig.toml",
    "exumi rig init simulated try.toml",
)


def run(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="[exumi|tmi|simulated] FILE",
            help="The device that it is for (default: exumi), and the file to write.",
            show_default=False,
        ),
    ],
    force: Annotated[
        bool, typer.Option("--force", help="Replace a file that is there already.")
    ] = False,
) -> None:
    """Write a rig file to begin with, and list the devices that are plugged in.

    Every line of it is explained, and what differs from rig to rig is marked CHANGE.
    """
    from exumi_data.cli.output import printable
    from exumi_data.errors import UsageError
    from exumi_recorders.rig.starting import TEMPLATES, present_devices, write_template

    if len(words) > 2:
        raise UsageError(
            f"{len(words)} names were given", fix="Say: exumi rig init [exumi|tmi|simulated] FILE."
        )
    if len(words) == 1 and words[0] in TEMPLATES:
        raise UsageError("no file is named", fix=f"Say: exumi rig init {words[0]} rig.toml")
    name = words[0] if len(words) == 2 else "exumi"
    path = write_template(name, given_path(words[-1]), force=force)
    shown = printable(str(path))
    print(f"{shown}: a rig file for {name}")
    lines = present_devices().lines()
    print("\nplugged in:" if lines else "\nplugged in: nothing that is known")
    for line in lines:
        print(f"  {printable(line)}")
    print(
        "\nnext:\n"
        f"  1. put your devices into {shown}: the lines marked CHANGE\n"
        f"  2. exumi rig check {shown}\n"
        "  3. exumi calibrate --help, and name the file as `calibration` in [rig]\n"
        f"  4. exumi record --rig {shown} --task 'what is to be done'"
    )
