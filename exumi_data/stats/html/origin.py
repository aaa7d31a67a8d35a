"""Section: where the data comes from, and what may be done with it."""

from collections.abc import Iterable, Mapping

from exumi_data import __version__
from exumi_data.model.episode import UNKNOWN_LICENCE
from exumi_data.stats.html.layout import facts, section
from exumi_data.stats.html.markup import Html, shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.words import counted, listed, named

__all__ = ["origin"]


def origin(material: Material) -> Html:
    """Write the section.

    Parameters
    ----------
    material : Material
    """
    content, totals, dataset = material.statistics.content, material.totals, material.dataset
    licences = [
        "not stated" if name == UNKNOWN_LICENCE else name for name in content.licences if name
    ]
    instructions = [f"“{shortened(words, 80)}”" for words in totals.instructions]
    rows = [
        ("licence", named(licences, 4)),
        ("authors", named(dataset.authors, 12) if dataset else None),
        ("citation", shortened(dataset.citation or "", 400) if dataset else None),
        ("how it came to be", _counts(content.sources)),
        ("lossy steps", _counts(content.lossy_steps)),
        ("sensors", named(sorted({m for c in totals.sensors.values() for m in c}), 6)),
        ("device", named(totals.devices)),
        ("gripper", named(totals.grippers)),
        ("gel pads", _counts(content.pad_types)),
        ("told to do", named(instructions, 3, 90)),
        ("sites", named(totals.sites)),
        (
            "operators",
            counted(len(totals.people), "person").replace("persons", "people")
            if totals.people
            else None,
        ),
        ("splits", _splits(material.splits)),
        ("fingerprint", material.fingerprint[:16]),
        ("page made by", f"exumi-data {__version__}"),
    ]
    return section("origin", "Where it comes from", "", facts(rows))


def _counts(counts: Mapping[str, int]) -> str:
    said = [f"{shortened(name, 40)} ({count:,})" for name, count in counts.items() if name]
    return named(said, 4, 60)


def _splits(splits: Mapping[str, Mapping[str, int]]) -> str:
    def words(lists: Iterable[tuple[str, int]]) -> str:
        return listed([f"{shortened(name, 24)} {count:,}" for name, count in list(lists)[:6]])

    found = [f"{name} ({words(lists.items())})" for name, lists in splits.items()]
    return named(found, 6, 120)
