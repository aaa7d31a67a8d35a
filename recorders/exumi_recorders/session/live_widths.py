"""How wide the grippers are now: the counts that their encoders tell of, by the calibration."""

from collections.abc import Iterable, Mapping

import numpy as np

from exumi_data.model import CalibrationItem
from exumi_data.width_map import WIDTH_MAP, WidthMap, read_width_map
from exumi_recorders.recording.device import RecordedStream
from exumi_recorders.recording.status import RecordingStatus

__all__ = ["LiveWidths"]


class LiveWidths:
    """Knows the maps of a rig's encoders.

    Parameters
    ----------
    streams : iterable of RecordedStream
        Of which those of encoders count.
    items : mapping of str to CalibrationItem
    """

    def __init__(
        self, streams: Iterable[RecordedStream], items: Mapping[str, CalibrationItem]
    ) -> None:
        self._maps: dict[str, tuple[WidthMap, int | None]] = {}
        item = items.get(WIDTH_MAP)
        for stream in streams:
            if stream.port.transform != "encoder_map" or item is None:
                continue
            modulus = (stream.port.metadata.get("raw") or {}).get("modulus")
            known = read_width_map(item.value, modulus)
            if isinstance(known, WidthMap):
                self._maps[stream.name] = known, modulus

    def of(self, status: RecordingStatus) -> dict[str, float]:
        """Return the widths in metres, by stream; without those that are not known.

        Parameters
        ----------
        status : RecordingStatus
        """
        counts = {one.name: one.readings.get("count") for one in status.devices if one.connected}
        found = {}
        for stream in status.streams:
            count = counts.get(stream.device)
            if stream.name in self._maps and isinstance(count, int):
                known, modulus = self._maps[stream.name]
                found[stream.name] = float(known.widths(np.array([count]), modulus)[0][0])
        return found
