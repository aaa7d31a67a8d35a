"""Which of Octopi's three layouts a folder has; said by name and reason, never guessed by trying.

==================  ========================================================================
Octopi-1            ``<part id>_<trial>.mov``, all in one folder
Octopi-1.5 raw      ``physiclear|physicleardotted/<Procedure>/<part id>_<trial>.mov``,
                    ``hardness/<collection>/<file>``,
                    ``objectfolder/<n>/tactile_data/<trial>/0/gelsight/<frame>.png``
Octopi-1.5 samples  ``<dataset>_<k>/tactile/NNNNNNNNNN.jpg`` and ``data.json``
==================  ========================================================================
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from exumi_converters.converter import EpisodeSource
from exumi_converters.octopi_items import ItemMaker
from exumi_converters.octopi_samples import FRAME_SUFFIXES
from exumi_converters.source_folder import count_names, may_be_read, source_files
from exumi_data.errors import SourceError, UsageError
from exumi_data.store.video import probe_video

__all__ = ["Layout", "detect_layout"]

_PHYSICLEAR = ("physiclear", "physicleardotted")
_DATASETS = (*_PHYSICLEAR, "hardness", "objectfolder")
_LAYOUTS = (
    "Known layouts: clips <part id>_<trial>.mov in this folder (Octopi-1); folders physiclear, "
    "physicleardotted, hardness or objectfolder (Octopi-1.5 raw); folders with data.json and "
    "tactile/ (Octopi-1.5 samples)."
)


@dataclass(slots=True)
class Layout:
    """A recognised layout.

    Attributes
    ----------
    name, reason : str
        For people.
    items : callable
        Makes the episodes.
    notices : list of str
        What was found and not understood; complete once `items` was called.
    """

    name: str
    reason: str
    items: Callable[[ItemMaker], list[EpisodeSource]]
    notices: list[str] = field(default_factory=list)


def detect_layout(root: Path) -> Layout:
    """Recognise the layout of a folder.

    Raises
    ------
    SourceError
        There is no such folder, or it has none of the layouts.
    UsageError
        It has more than one.
    """
    if not root.is_dir():
        raise SourceError(
            "not a folder" if root.exists() else "no such folder",
            where=root,
            fix="Name the folder that holds the recordings.",
        )
    entries = sorted(path for path in root.iterdir() if not path.name.startswith("."))
    folders = [path for path in entries if path.is_dir()]
    # A link that leads nowhere is a clip that cannot be read, and fails by its name.
    videos = [path for path in entries if probe_video(path.name) and may_be_read(path)]
    datasets = [path for path in folders if path.name in _DATASETS]
    base = root / "samples" if (root / "samples").is_dir() else root
    samples = sorted(path.parent for path in base.glob("*/data.json"))
    if (root / "data.json").is_file() and (root / "tactile").is_dir():
        samples = [root]
    found = []
    if videos:
        found.append(_flat(root, videos, entries))
    if datasets:
        found.append(_raw(root, datasets))
    if samples:
        found.append(_samples(base, samples))
    if len(found) > 1:
        reasons = "; ".join(f"{layout.name} ({layout.reason})" for layout in found)
        raise UsageError(
            f"the folder has more than one layout: {reasons}",
            where=root,
            fix="Name one of the folders in it.",
        )
    if not found:
        raise SourceError("no clips and no samples found", where=root, fix=_LAYOUTS)
    return found[0]


def _flat(root: Path, videos: list[Path], entries: list[Path]) -> Layout:
    other = [path for path in entries if path not in set(videos)]
    notices = [count_names("file(s) and folder(s) that are no clips, not read", root, other)]
    return Layout(
        "Octopi-1",
        f"{len(videos)} clip(s) directly in the folder",
        lambda maker: maker.clips(videos, "physiclear"),
        notices if other else [],
    )


def _raw(root: Path, datasets: list[Path]) -> Layout:
    names = ", ".join(path.name for path in datasets)
    layout = Layout("Octopi-1.5 raw", f"it holds the folder(s) {names}", lambda _: [])
    layout.items = lambda maker: _raw_items(root, datasets, maker, layout.notices)
    return layout


def _raw_items(
    root: Path, datasets: list[Path], maker: ItemMaker, notices: list[str]
) -> list[EpisodeSource]:
    items: list[EpisodeSource] = []
    other = [
        path
        for path in sorted(root.iterdir())
        if path not in datasets and not path.name.startswith(".")
    ]
    for dataset in datasets:
        files = list(source_files(dataset))
        if dataset.name == "objectfolder":
            trials = sorted({path.parent for path in files if _is_objectfolder(path, dataset)})
            items += maker.trials(trials)
            other += [path for path in files if path.parent not in set(trials)]
            continue
        # Exactly one folder between: the procedure, or the collection.
        clips = [p for p in files if probe_video(p.name) and p.parent.parent == dataset]
        items += maker.clips(clips, dataset.name)
        other += [path for path in files if path not in set(clips)]
    if other:
        notices.append(
            count_names("file(s) and folder(s) outside the layout, not read", root, other)
        )
    if not items:
        raise SourceError("no clips found", where=root, fix=_LAYOUTS)
    return items


def _is_objectfolder(path: Path, dataset: Path) -> bool:
    parts = path.relative_to(dataset).parts
    return (
        len(parts) == 6
        and parts[1] == "tactile_data"
        and parts[3:5] == ("0", "gelsight")
        and not any("backup" in part for part in parts)
        and path.suffix.lower() in FRAME_SUFFIXES
    )


def _samples(base: Path, samples: list[Path]) -> Layout:
    layout = Layout(
        "Octopi-1.5 samples", f"{len(samples)} folder(s) with a data.json", lambda _: []
    )

    def items(maker: ItemMaker) -> list[EpisodeSource]:
        known = {base / name for name in ("train", "val", "test")}
        other = [
            path
            for path in sorted(base.iterdir())
            if path not in samples
            and not path.name.startswith(".")
            and not path.name.endswith("_samples.json")
            and path not in known
        ]
        if samples != [base] and other:
            layout.notices.append(count_names("entries without a data.json, not read", base, other))
        return maker.samples(samples)

    layout.items = items
    return layout
