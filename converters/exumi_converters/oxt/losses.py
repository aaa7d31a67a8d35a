"""What of an episode has no place in the contract."""

from collections.abc import Iterator, Mapping

from exumi_converters.exporter import Loss
from exumi_converters.oxt.places import Place, Places
from exumi_data.episode import Episode, StreamView

__all__ = ["LOSES", "find_losses"]

LOSES: Mapping[str, str] = {
    "identity": "the id is kept as parent_id when the store is converted back",
    "start": "timestamps count from the episode's start, whose date is not kept",
    "task": "the contract asks for an instruction: where there is none, the task's name is "
    "written, and one that repeats it is taken for none; blanks become one",
    "regime": "there is no place for regime and success",
    "annotations": "there is no place for objects, labels and segments",
    "people": "there is no place for operator, site, device and embodiment",
    "licence": "there is no place for a licence: it is in exumi_export.json",
    "quality": "there is no place for quality notes",
    "source": "converted back, it names the store",
    "calibration": "there is no place for calibration",
    "streams": "sound and extension kinds have no place; nor have streams beyond those of one "
    "gripper, unless -o streams names one",
    "time": "all streams share one timeline: the camera's, or what -o timeline or -o rate says",
    "raw-time": "host and device times and sequence numbers are left out",
    "clock": "how times came about is left out",
    "flags": "samples that are flagged invalid are not used; other flags are left out",
    "gaps": "gaps and loss counters are left out",
    "sensor": "serial numbers, scales, cells' positions and nominal rates are left out",
    "values": "poses, widths and wrenches are interpolated at the steps and rounded to float32; "
    "of taxels the nearest sample is taken",
    "raw": "the device's own values are left out",
    "frame-bytes": "frames are decoded, and their pixels stored",
    "pixels": "frames that no step is nearest to are left out; grey ones get three equal channels",
    "reference": "there is no place for reference images",
    "derived": "there is no place for derived arrays",
}
"""Facets that do not survive."""

_ALWAYS = ("identity", "source", "time", "clock", "regime", "licence")
_DOCUMENT: Mapping[str, tuple[str, ...]] = {
    "start": ("start",),
    "annotations": ("annotations",),
    "people": ("operator", "site", "device", "embodiment"),
    "quality": ("quality",),
    "calibration": ("calibration",),
}
_ARRAYS: Mapping[str, tuple[str, ...]] = {
    "raw-time": ("time_host", "time_device", "sequence"),
    "flags": ("flags",),
    "raw": ("raw",),
    "reference": ("reference",),
}


def find_losses(episode: Episode, places: Places) -> Iterator[Loss]:
    """Yield what an episode loses.

    Parameters
    ----------
    episode : Episode
    places : Places
    """
    metadata = episode.metadata
    for facet in _ALWAYS:
        yield Loss(facet=facet, detail=LOSES[facet])
    for facet, fields in _DOCUMENT.items():
        if any(getattr(metadata, name) for name in fields):
            yield Loss(facet=facet, detail=LOSES[facet])
    words = metadata.task.instruction
    if words is not None and (words != " ".join(words.split()) or words == metadata.task.name):
        yield Loss(facet="task", detail=LOSES["task"])
    if episode.derived is not None:
        yield Loss(facet="derived", detail=LOSES["derived"])
    for name, reason in places.left_out.items():
        yield Loss(facet="streams", detail=reason, stream=name)
    for place in places.found.values():
        for name in place.streams:
            yield from _of_stream(episode[name], place)


def _of_stream(stream: StreamView, place: Place) -> Iterator[Loss]:
    model = stream.metadata
    facets = [facet for facet, arrays in _ARRAYS.items() if set(arrays) & set(model.arrays)]
    if model.gaps or model.lost:
        facets.append("gaps")
    if model.sensor or model.description or model.nominal_rate:
        facets.append("sensor")
    facets += ["frame-bytes", "pixels"] if place.is_image else ["values"]
    for facet in facets:
        yield Loss(facet=facet, detail=LOSES[facet], stream=stream.name)
