"""All cases, with what the corpus itself must be."""

from corpus.case import Case
from corpus.invalid_arrays import array_cases
from corpus.invalid_data import data_cases
from corpus.invalid_datasets import dataset_cases
from corpus.invalid_documents import document_cases
from corpus.invalid_hierarchy import hierarchy_cases
from corpus.invalid_packing import packing_cases
from corpus.invalid_streams import stream_cases
from corpus.manifests import manifest_cases
from corpus.quality_calibration import calibration_cases
from corpus.quality_labels import labels_cases
from corpus.quality_motion import motion_cases
from corpus.quality_sync import sync_cases
from corpus.quality_timing import timing_cases
from corpus.quality_touch import touch_cases
from corpus.valid import valid_cases
from corpus.valid_combinations import combined_cases
from corpus.valid_videos import video_cases

__all__ = ["invalid", "valid"]


def valid() -> list[Case]:
    """Return the cases in which nothing is to be found."""
    return _checked([*valid_cases(), *combined_cases(), *video_cases()], findings=False)


def invalid() -> list[Case]:
    """Return the cases in which exactly their findings are to be found."""
    makers = (
        document_cases,
        stream_cases,
        hierarchy_cases,
        packing_cases,
        array_cases,
        data_cases,
        dataset_cases,
        manifest_cases,
        timing_cases,
        sync_cases,
        touch_cases,
        motion_cases,
        calibration_cases,
        labels_cases,
    )
    return _checked([case for maker in makers for case in maker()], findings=True)


def _checked(cases: list[Case], *, findings: bool) -> list[Case]:
    names = [case.name for case in cases]
    if len(set(names)) < len(names):
        msg = f"two cases of one name: {sorted(n for n in names if names.count(n) > 1)}"
        raise ValueError(msg)
    for case in cases:
        rule = case.name.partition("__")[0]
        if findings and rule not in {finding.code for finding in case.findings}:
            msg = f"{case.name} does not break {rule}"
            raise ValueError(msg)
        if bool(case.findings) != findings:
            msg = f"{case.name} is on the wrong side"
            raise ValueError(msg)
    return cases
