"""Putting a session together: rig, calibration, dataset, recorder, preview."""

import contextlib
import os
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from exumi_data._version import __version__
from exumi_data.calibration_items import moment_of
from exumi_data.dataset import DATASET_DOCUMENT, create_dataset, open_dataset
from exumi_data.errors import UsageError
from exumi_data.model import Annotations, DatasetMetadata, MadeBy
from exumi_recorders.journal.space import SpaceLimits
from exumi_recorders.recording.headers import LATENCY
from exumi_recorders.recording.lanes import Limits
from exumi_recorders.recording.recorder import Recorder
from exumi_recorders.rig.calibrations import read_calibrations
from exumi_recorders.rig.devices import recorded_devices
from exumi_recorders.rig.loading import load_rig
from exumi_recorders.rig.model import Rig, expanded
from exumi_recorders.rig.simulated import NAME, SimulatedSettings, simulated_rig
from exumi_recorders.session.labels import TrialCounter
from exumi_recorders.session.messages import Message
from exumi_recorders.session.operator import Operator
from exumi_recorders.session.plan import Calibrated, Plan, check_plan, licence_of
from exumi_recorders.session.preview import Preview
from exumi_recorders.session.readiness import check_calibration
from exumi_recorders.session.session import Session

__all__ = ["make_recorder", "open_rig", "open_session", "session_with"]

_MOST_SIMULATED_S = 300.0
_LEAST_SIMULATED_S = 120.0


@contextlib.contextmanager
def open_rig(
    name: str, simulated: SimulatedSettings | None = None
) -> Iterator[tuple[Rig, Calibrated]]:
    """Read a rig file and its calibration, or start the simulated rig until the block ends.

    Parameters
    ----------
    name : str
        Path of the rig file, or ``simulated``.
    simulated : SimulatedSettings, optional
    """
    if name != NAME:
        rig = load_rig(expanded(name))
        yield rig, read_calibrations(rig)
        return
    with simulated_rig(simulated) as started:
        yield started.rig, started.calibrated


def make_recorder(rig: Rig) -> Recorder:
    """Return the recorder of a rig's devices, which are not open yet.

    Parameters
    ----------
    rig : Rig
    """
    return Recorder(
        recorded_devices(rig),
        limits=Limits(bytes=rig.limits.queue_mb << 20),
        space=SpaceLimits(reserve_bytes=rig.limits.reserve_mb << 20),
    )


@contextlib.contextmanager
def open_session(
    name: str,
    out: Path | None,
    plan: Plan,
    operator: Operator,
    *,
    seed: int = 0,
    preview: tuple[str, int] | None = None,
) -> Iterator[Session]:
    """Open everything that a session needs; all is closed after the block.

    Parameters
    ----------
    name : str
        Path of the rig file, or ``simulated``.
    out : pathlib.Path, optional
        The dataset; default that of the rig file.
    plan : Plan
    operator : Operator
    seed : int
        Of the simulated rig.
    preview : (str, int), optional
        Where to show the cameras.

    Raises
    ------
    UsageError
        The rig file or the dataset cannot be used, or the rig is not calibrated.
    DeviceError
        A device cannot be opened.
    """
    check_plan(plan)
    settings = SimulatedSettings(seed=seed, seconds=_simulated_seconds(plan))
    if name == NAME:
        plan = replace(plan, is_simulated=True)
        operator.tell(Message("info", "simulated", "starting the simulated devices ..."))
    with (
        open_rig(name, settings) as (rig, calibrated),
        session_with(rig, calibrated, out, plan, operator, preview=preview) as session,
    ):
        yield session


@contextlib.contextmanager
def session_with(
    rig: Rig,
    calibrated: Calibrated,
    out: Path | None,
    plan: Plan,
    operator: Operator,
    *,
    preview: tuple[str, int] | None = None,
) -> Iterator[Session]:
    """Open a session with a rig that is known already; all is closed after the block.

    Parameters
    ----------
    rig : Rig
    calibrated : Calibrated
    out : pathlib.Path, optional
        The dataset; default that of the rig file.
    plan : Plan
    operator : Operator
    preview : (str, int), optional
        Where to show the cameras.

    Raises
    ------
    UsageError
        The dataset cannot be used, or the rig is not calibrated.
    DeviceError
        A device cannot be opened.
    """
    with contextlib.ExitStack() as stack:
        doubts = check_calibration(rig, calibrated, uncalibrated=plan.uncalibrated)
        dataset = _dataset_of(rig, out, plan)
        trials = TrialCounter(_earlier(dataset))
        warning = trials.warning(plan.labels)
        recorder = make_recorder(rig)
        session = Session(
            rig, recorder, dataset, plan, calibrated, trials, operator.tell, operator.show
        )
        recorder.told = session.hear
        stack.enter_context(recorder)
        cameras = [stream.name for stream in recorder.streams.values() if stream.is_image]
        shown = None
        if preview is not None:

            def latest(stream: str) -> bytes | None:
                sample = recorder.latest_frame(stream)
                return None if sample is None else sample.payload

            shown = stack.enter_context(Preview(cameras, latest, preview))
        operator.attend(
            session,
            sync_age_s=sync_age_s(calibrated),
            preview=None if shown is None else shown.url,
        )
        if shown is not None:
            operator.tell(Message("info", "preview", f"preview: {shown.url}"))
            if shown.is_public:
                text = "everybody in this network can see the preview"
                operator.tell(Message("warning", "public_preview", text))
        if warning:
            operator.tell(Message("warning", "pads_mix", warning))
        if doubts:
            operator.tell(Message("warning", "not_calibrated", doubts))
        yield session


def _simulated_seconds(plan: Plan) -> float:
    one = (plan.duration_s or 0.0) + plan.pause_s + 1.0
    wanted = one * (plan.episodes or 1) + 5.0
    return min(
        max(_LEAST_SIMULATED_S if plan.duration_s is None else 5.0, wanted), _MOST_SIMULATED_S
    )


def _dataset_of(rig: Rig, out: Path | None, plan: Plan) -> Path:
    if out is None and rig.about.data is None:
        raise UsageError(
            "where to record to is not said",
            where=rig.path,
            fix="Name a dataset with --out, or as `data` in the rig file's section [rig].",
        )
    root = out if out is not None else rig.beside(str(rig.about.data))
    place = Path(os.path.realpath(root))
    if not (root / DATASET_DOCUMENT).exists():
        for parent in place.parents:
            if (parent / DATASET_DOCUMENT).exists():
                raise UsageError(
                    f"lies in the dataset {parent}",
                    where=root,
                    fix="Name that one, or a folder beside it.",
                )
    return create_dataset(
        root,
        DatasetMetadata(
            name=_name_of(place),
            licence=licence_of(plan, rig),
            made_by=MadeBy(tool="exumi record", tool_version=__version__),
        ),
    )


def _name_of(folder: Path) -> str:
    """Return a dataset's name: its folder's, on one line, without what is no letter."""
    shown = "".join(c if c.isprintable() else " " for c in folder.name)
    return " ".join(shown.split())[:255].rstrip() or "recordings"


def _earlier(dataset: Path) -> Iterator[Annotations]:
    """Return what the episodes say that are there already."""
    table = open_dataset(dataset).catalog
    names = ("object_id", "part_id", "procedure", "pad_type", "trial")
    for row in table.select(list(names)).to_pylist():
        yield Annotations.model_validate(
            {name: value for name, value in row.items() if value is not None}
        )


def sync_age_s(calibrated: Calibrated) -> float | None:
    """Return how old the oldest latency calibration is, seconds; None where there is none.

    Parameters
    ----------
    calibrated : Calibrated
    """
    times = [
        moment
        for name, item in calibrated.items.items()
        if name.startswith(LATENCY) and (moment := moment_of(item)) is not None
    ]
    return (datetime.now(UTC) - min(times)).total_seconds() if times else None
