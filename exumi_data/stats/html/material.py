"""All that a page is made of."""

from dataclasses import dataclass

from exumi_data.model.dataset import DatasetMetadata
from exumi_data.stats.html.judgement import Judgement
from exumi_data.stats.html.pictures import Pictures
from exumi_data.stats.html.totals import Totals
from exumi_data.stats.model import Statistics

__all__ = ["Material"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """Numbers, pictures and findings of one dataset or episode.

    Attributes
    ----------
    statistics : Statistics
    totals : Totals
    pictures : Pictures
    judgement : Judgement or None
        None where nothing was validated.
    dataset : DatasetMetadata or None
        None for an episode.
    fingerprint : str
        Changes whenever the data does.
    splits : dict of str to dict of str to int
        Named splits: their lists, each with its number of episodes.
    """

    statistics: Statistics
    totals: Totals
    pictures: Pictures
    judgement: Judgement | None
    dataset: DatasetMetadata | None
    fingerprint: str
    splits: dict[str, dict[str, int]]

    @property
    def grouped_by(self) -> str:
        """What episodes are grouped by: the task, or the object or part where the task is one."""
        content = self.statistics.content
        for what, counts in (
            ("task", content.tasks),
            ("object", content.objects),
            ("part", content.parts),
        ):
            if sum(bool(name) for name in counts) > 1:
                return what
        return "task"

    @property
    def groups(self) -> dict[str, int]:
        """Episodes of each group."""
        content = self.statistics.content
        return {"task": content.tasks, "object": content.objects, "part": content.parts}[
            self.grouped_by
        ]
