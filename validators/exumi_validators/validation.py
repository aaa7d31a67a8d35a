"""`validate`: the one function that users call."""

import os
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from exumi_data import __version__
from exumi_data.catalog import EPISODES_FOLDER
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.engine import Engine, map_items, warm_up
from exumi_data.errors import NotAnEpisodeError, UnsupportedError, UsageError
from exumi_data.model.episode import FORMAT_VERSION
from exumi_data.opening import not_an_episode
from exumi_data.redaction import without_secrets
from exumi_data.standard import LEVELS, Level
from exumi_data.stopping import Stopped
from exumi_data.store.remote.address import is_url
from exumi_validators.checks import dataset as dataset_module
from exumi_validators.checks import manifest as manifest_module
from exumi_validators.config import Config
from exumi_validators.dataset_context import DatasetContext
from exumi_validators.episode_run import (
    EpisodeResult,
    archive_checks,
    episode_checks,
    root_checks,
    validate_episode,
)
from exumi_validators.findings import Collector, merged
from exumi_validators.listing import list_folder
from exumi_validators.plugins import installed
from exumi_validators.registry import Check, checks_of, reason_of
from exumi_validators.report import Configuration, Coverage, Problem, Report, Skipped, Unchecked

__all__ = ["dataset_checks", "validate"]

# Starting processes costs more than judging a few episodes.
_PARALLEL_FROM = 8
_PARALLEL_BYTES = 32 << 20


@cache
def dataset_checks() -> tuple[Check[DatasetContext], ...]:
    """Return the checks of datasets, the cheap levels first."""
    found: tuple[Check[DatasetContext], ...] = checks_of((dataset_module, manifest_module))
    return tuple(sorted(found, key=lambda check: LEVELS.index(check.level)))


def validate(
    path: str | os.PathLike[str],
    *,
    levels: Collection[Level] | None = None,
    config: Config | None = None,
    workers: int | None = None,
    engine: Engine | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> Report:
    """Judge an episode or a dataset by the rules of the standard.

    Everything that is wrong with what is there is a problem in the report; nothing is changed.

    Parameters
    ----------
    path : path-like
        A dataset's folder, an episode's folder, or a packed episode; or the URL of a packed episode
        as text, which is downloaded to a temporary file first.
    levels : collection of {"document", "hierarchy", "arrays", "data"}, optional
        Which rules to judge; default all. ``data`` reads every byte and decodes every frame.
    config : Config, optional
        Rules to judge in another way (`read_config`). Default: all as the standard has them; no
        file is looked for.
    workers : int, optional
        Processes; default all cores.
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.
    on_progress : callable, optional
        Called with the number of episodes that are done, and of all.

    Returns
    -------
    Report

    Raises
    ------
    NotAnEpisodeError
        Neither a dataset nor an episode is there.
    UsageError
        An unknown level, or an installed package whose checks cannot be used.
    UnsupportedError
        A URL that is no packed episode's.
    UnreachableError
        The server of a URL does not answer or does not let us in.
    OSError
        The path itself cannot be read.

    Examples
    --------
    >>> from exumi_validators import validate
    >>> report = validate("my-dataset")  # doctest: +SKIP
    >>> report.valid, report.codes()  # doctest: +SKIP
    (False, {'TIME-001': 1})
    """
    text = os.fspath(path)
    chosen = _chosen(levels)
    installed()  # a package that cannot be used is refused before anything is read
    if is_url(path):
        return _validate_remote(text, chosen, config, on_progress)
    if _kind(text) == "dataset":
        return _validate_dataset(text, chosen, config, workers, engine, on_progress)
    result = validate_episode(text, chosen, config=config)
    if on_progress is not None:
        on_progress(1, 1)
    judged = _judged(chosen, packed=Path(text).is_file(), of_dataset=False)
    coverage = _coverage(chosen, judged, [result], result.unchecked, result.skipped)
    return Report(
        path=text,
        kind="episode",
        standard=FORMAT_VERSION,
        library=__version__,
        problems=result.problems,
        coverage=coverage,
        not_listed=dict(result.not_listed),
        suppressed_not_listed=dict(result.suppressed_not_listed),
        configuration=_told(config, result.problems, result.suppressed_not_listed, chosen),
        extensions=installed().extensions,
    )


def _validate_remote(
    url: str,
    levels: frozenset[Level],
    config: Config | None,
    on_progress: Callable[[int, int], None] | None,
) -> Report:
    """Judge a packed episode behind a URL: every byte of it is read anyway."""
    from exumi_data.store.remote.download import download  # nobody else needs it

    if not url.partition("?")[0].endswith(".zip"):
        raise UnsupportedError(
            "a dataset and an unpacked episode are judged where all their files are at hand",
            where=url,
            fix="Download it (aws s3 sync, rclone copy or wget -r) and give the local path: exumi "
            "validate FOLDER. Packed episodes (.zarr.zip) can be judged by their URL.",
        )
    with tempfile.TemporaryDirectory(prefix="exumi-") as folder:
        file = download(url, Path(folder, "episode.zarr.zip"))
        report = validate(file, levels=levels, config=config, on_progress=on_progress)
    return replace(report, path=without_secrets(url))


def _chosen(levels: Collection[Level] | None) -> frozenset[Level]:
    wanted = frozenset(LEVELS if levels is None else levels)
    unknown = sorted(str(level) for level in wanted - set(LEVELS))
    if unknown or not wanted:
        raise UsageError(
            f"invalid level ({', '.join(unknown) or 'none'}). "
            f"Supported values are {', '.join(LEVELS)}"
        )
    return wanted


def _kind(path: str) -> str:
    if not path:
        raise NotAnEpisodeError("an empty path was given")
    target = Path(path)
    if target.is_dir():
        is_episode = (target / "zarr.json").is_file() or ".zarr" in target.suffixes
        if (target / DATASET_DOCUMENT).is_file():
            return "dataset"
        if not is_episode and (target / EPISODES_FOLDER).is_dir():
            return "dataset"
        if is_episode and _is_group_of_an_episode(target):
            raise not_an_episode(path)
        if is_episode or target.name.startswith(".partial-"):
            return "episode"
        raise not_an_episode(path)
    if not target.exists():
        raise NotAnEpisodeError("no such file or folder", where=path)
    if not target.is_file():  # a pipe would be waited for
        raise NotAnEpisodeError("neither a file nor a folder", where=path)
    with target.open("rb") as file:
        is_zip = file.read(4) in (b"PK\x03\x04", b"PK\x05\x06")
    if not is_zip and not path.endswith(".zip"):
        raise not_an_episode(path)
    return "episode"


def _is_group_of_an_episode(folder: Path) -> bool:
    """Whether a folder is named like no episode, and lies in one."""
    parents = folder.absolute().parents
    return ".zarr" not in folder.suffixes and any(place.suffix == ".zarr" for place in parents)


def _validate_dataset(
    path: str,
    levels: frozenset[Level],
    config: Config | None,
    workers: int | None,
    engine: Engine | None,
    on_progress: Callable[[int, int], None] | None,
) -> Report:
    dataset = DatasetContext(Path(path), config.limits if config else None)
    found = Collector(config.revised if config else None)
    unchecked: list[Unchecked] = []
    results: list[EpisodeResult] = []
    not_listed: Counter[str] = Counter()
    suppressed_not_listed: Counter[str] = Counter()
    if dataset.judgeable:
        has_digests = not isinstance(dataset.catalog, str) or dataset.manifest is not None
        judge = partial(
            _judge_member,
            root=path,
            levels=levels,
            with_digest="data" in levels and has_digests,
            config=config,
        )
        few = engine is None and len(dataset.episodes) < _PARALLEL_FROM
        if few and not ("data" in levels and _is_much(dataset.root, dataset.episodes)):
            workers = 1
        else:
            # Workers are forked with everything loaded, also in later calls.
            warm_up(__name__, workers=workers, engine=engine)
        for episode, result in _episodes(dataset.episodes, judge, workers, engine, on_progress):
            if isinstance(result, Unchecked):
                unchecked.append(result)
                continue
            results.append(_placed(result, episode))
            dataset.facts[episode] = result.facts
            not_listed.update(result.not_listed)
            suppressed_not_listed.update(result.suppressed_not_listed)
            unchecked += [replace(item, path=episode) for item in result.unchecked]
        dataset.facts = dict(sorted(dataset.facts.items()))
    for check in (*dataset_checks(), *installed().dataset_checks):
        if check.level not in levels:
            continue
        try:
            for problem in check(dataset):
                found.add(problem)
        except Stopped:
            raise
        except (Exception, SystemExit) as error:  # noqa: BLE001  # a check that fails must not hide the others
            unchecked.append(Unchecked(".", ", ".join(check.rules), reason_of(error)))
    not_listed.update(found.not_listed)
    suppressed_not_listed.update(found.suppressed_not_listed)
    problems = [*found.problems, *(problem for result in results for problem in result.problems)]
    problems.sort(key=lambda problem: (*problem.location.sort_key(), problem.code))
    unchecked.sort(key=lambda item: (item.path, item.what))
    packed = any(episode.endswith(".zip") for episode in dataset.episodes)
    judged = _judged(levels, packed=packed, of_dataset=True)
    skipped = merged([*found.skipped, *(item for result in results for item in result.skipped)])
    coverage = _coverage(levels, judged, results, tuple(unchecked), skipped)
    return Report(
        path=path,
        kind="dataset",
        standard=FORMAT_VERSION,
        library=__version__,
        problems=tuple(problems),
        coverage=coverage,
        not_listed=dict(not_listed),
        suppressed_not_listed=dict(suppressed_not_listed),
        configuration=_told(config, problems, suppressed_not_listed, levels),
        extensions=installed().extensions,
    )


def _told(
    config: Config | None,
    problems: Iterable[Problem],
    not_listed: Collection[str],
    levels: frozenset[Level],
) -> Configuration | None:
    return None if config is None else config.told(problems, not_listed, levels)


def _episodes(
    episodes: list[str],
    judge: Callable[[str], EpisodeResult],
    workers: int | None,
    engine: Engine | None,
    on_progress: Callable[[int, int], None] | None,
) -> "list[tuple[str, EpisodeResult | Unchecked]]":
    done: list[tuple[str, EpisodeResult | Unchecked]] = []
    for outcome in map_items(judge, episodes, workers=workers, engine=engine):
        if outcome.value is not None:
            done.append((outcome.item, outcome.value))
        else:
            reason = f"{type(outcome.error).__name__}: {outcome.error}"
            done.append((outcome.item, Unchecked(outcome.item, "the episode", reason[:500])))
        if on_progress is not None:
            on_progress(len(done), len(episodes))
    return sorted(done, key=lambda pair: pair[0])


def _is_much(root: Path, episodes: list[str]) -> bool:
    """Whether a few episodes are so long that they are worth processes of their own."""
    if len(episodes) < 2:
        return False
    total = 0
    for episode in episodes:
        path = root / episode
        if path.is_file():
            total += path.stat().st_size
        else:
            total += sum(list_folder(os.fspath(path)).files.values())
        if total > _PARALLEL_BYTES:
            return True
    return False


def _judge_member(
    episode: str,
    *,
    root: str,
    levels: frozenset[Level],
    with_digest: bool,
    config: Config | None,
) -> EpisodeResult:
    path = f"{root}/{episode}"
    return validate_episode(path, levels, with_digest=with_digest, config=config, member=episode)


def _placed(result: EpisodeResult, episode: str) -> EpisodeResult:
    problems = tuple(
        replace(problem, location=replace(problem.location, episode=episode))
        for problem in result.problems
    )
    skipped = tuple(replace(item, path=f"{episode}/{item.path}") for item in result.skipped)
    return replace(result, problems=problems, skipped=skipped)


def _judged(levels: frozenset[Level], *, packed: bool, of_dataset: bool) -> int:
    """Return how many rules were judged."""
    checks: list[Check[Any]] = [*root_checks(), *episode_checks(), *installed().episode_checks]
    checks += archive_checks() if packed else ()
    checks += (*dataset_checks(), *installed().dataset_checks) if of_dataset else ()
    return len({code for check in checks if check.level in levels for code in check.rules})


def _coverage(
    levels: frozenset[Level],
    judged: int,
    results: list[EpisodeResult],
    unchecked: tuple[Unchecked, ...],
    skipped: tuple[Skipped, ...],
) -> Coverage:
    return Coverage(
        levels=tuple(level for level in LEVELS if level in levels),
        rules=judged,
        episodes=len(results),
        streams=sum(result.streams for result in results),
        arrays=sum(result.arrays for result in results),
        samples=sum(result.samples for result in results),
        frames=sum(result.frames for result in results),
        unchecked=unchecked,
        skipped=skipped,
    )
