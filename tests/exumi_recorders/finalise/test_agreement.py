"""A journal whose header and logs do not belong together is left as it is."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from exumi_recorders.finalise.recover import recover
from exumi_recorders.journal.header import HEADER_LOG
from tests.exumi_recorders.finalise.journals import make_dataset, make_journal, samples
from tests.exumi_recorders.numbered import CAMERA, POSE, episode


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    streams = {
        "pose": (POSE, samples("pose", 9, 90.0)),
        "camera": (CAMERA, samples("camera", 3)),
    }
    return make_journal(make_dataset(tmp_path / "set"), streams)


def change(journal: Path, what: Callable[[dict[str, Any]], object]) -> None:
    """Change the header where its copy is lost too: else that would be taken."""
    shutil.rmtree(journal / HEADER_LOG)
    path = journal / "header.json"
    document = json.loads(path.read_text())
    what(document)
    path.write_text(json.dumps(document))


def refused(journal: Path) -> str:
    """Why nothing is made of it, also when it is only looked at; every byte stays."""
    files = [path for path in sorted(journal.rglob("*")) if path.is_file()]
    before = [path.read_bytes() for path in files]
    ((_, looked),) = recover([journal], dry_run=True).failed
    ((_, said),) = recover([journal]).failed
    assert said == looked
    assert [path.read_bytes() for path in files] == before
    assert not list((journal.parents[1] / "episodes").glob("*/*.zarr"))
    return said


def test_samples_of_another_length(journal: Path) -> None:
    def longer(document: dict[str, Any]) -> None:
        document["streams"]["pose"]["port"]["payload"]["arrays"][0]["shape"] = [8]

    change(journal, longer)
    assert "a sample of pose has 64 bytes, and those in its log have 56" in refused(journal)


def test_a_log_that_the_header_does_not_name(journal: Path) -> None:
    change(journal, lambda document: document["streams"].pop("pose"))
    assert "names no stream 'pose'" in refused(journal)


@pytest.mark.parametrize("name", ["camera", "camera/000000.log"])
def test_links(journal: Path, name: str, tmp_path: Path) -> None:
    (journal / name).rename(tmp_path / "elsewhere")
    (journal / name).symlink_to(tmp_path / "elsewhere")
    assert f"{name}: is a link" in refused(journal)


def test_a_header_that_nothing_can_be_made_of_keeps_no_other_journal(journal: Path) -> None:
    change(journal, lambda document: document.update(t0_monotonic_ns=(1 << 63) - 1))
    other = make_journal(
        journal.parents[1], {"pose": (POSE, samples("pose", 5))}, metadata=episode(2)
    )
    result = recover([journal.parents[1]])
    assert [one.journal for one in result.done] == [other]
    ((failed, why),) = result.failed
    assert (failed, "cannot be made an episode of" in why) == (journal, True)
    assert journal.exists()


def test_a_journal_without_a_header_is_looked_at_as_it_is_recovered(journal: Path) -> None:
    (journal / "header.json").unlink()
    shutil.rmtree(journal / HEADER_LOG)
    assert "has samples, but no header.json" in refused(journal)
    for log in journal.glob("*/*.log"):
        log.unlink()
    outcomes = [recover([journal], dry_run=dry).done[0].outcome for dry in (True, False)]
    assert outcomes == ["empty", "empty"]
