"""``exumi calibrate``: what a rig's sensors mean and when, measured and put into episodes."""

from exumi_data.cli import (
    calibrate_apply,
    calibrate_camera,
    calibrate_contact,
    calibrate_controller,
    calibrate_gripper,
    calibrate_latency,
    calibrate_tactile,
)
from exumi_data.cli.options import group

__all__ = ["app"]

app = group(
    "Calibrate a rig: each verb puts its items into a calibration file, and `apply` brings "
    "finished episodes to it. What does not tell is refused, with the reason.",
    "exumi calibrate gripper readings.csv --out rig.json",
    "exumi calibrate latency sweep.zarr --out rig.json --plot sweep.png",
    "exumi calibrate apply my-dataset --calibration rig.json",
    no_args_is_help=True,
)
app.command("gripper", epilog=calibrate_gripper.EPILOG)(calibrate_gripper.run)
app.command("controller", epilog=calibrate_controller.EPILOG)(calibrate_controller.run)
app.command("latency", epilog=calibrate_latency.EPILOG)(calibrate_latency.run)
app.command("contact", epilog=calibrate_contact.EPILOG)(calibrate_contact.run)
app.command("tactile", epilog=calibrate_tactile.EPILOG)(calibrate_tactile.run)
app.command("camera", epilog=calibrate_camera.EPILOG)(calibrate_camera.run)
app.command("apply", epilog=calibrate_apply.EPILOG)(calibrate_apply.run)
