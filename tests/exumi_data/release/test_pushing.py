"""Publishing, with the real client, to a server on localhost. Nothing reaches the network."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from huggingface_hub import constants

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.cli.release_judge import judge_with
from exumi_data.editing.documents import change_dataset
from exumi_data.errors import DamagedDataError, ExumiError, UsageError
from exumi_data.manifest import write_manifest
from exumi_data.model.dataset import DatasetMetadata
from exumi_data.release.judging import Judge, Judgement
from exumi_data.release.pushing import Pushed, push_release
from exumi_data.release.verifying import verify_release
from tests.exumi_data.builders import episode_id, write_small
from tests.exumi_data.release.hub import TOKEN, Hub, running_hub
from tests.exumi_data.release.making import LICENCE, Release, tree

NAME = "our-lab/touches"

# The client hands files to its own HTTP library in a way that this one calls outdated.
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Hub]:
    with running_hub() as running:
        # Its own storage protocol speaks to other machines; the hub's older one is the server's.
        monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
        monkeypatch.setenv("HF_TOKEN", TOKEN)
        monkeypatch.setenv("EXUMI_CACHE", str(tmp_path / "cache"))
        yield running


@pytest.fixture
def made(source: Path, tmp_path: Path, release: Release) -> Path:
    release(source, tmp_path / "v1", preview_bytes=0)
    return tmp_path / "v1"


def push(hub: Hub, root: Path, *, public: bool = False, judge: Judge | None = None) -> Pushed:
    chosen = judge or judge_with(1)
    return push_release(root, NAME, chosen, public=public, endpoint=hub.url, workers=1)


def download(hub: Hub, target: Path, revision: str = "main") -> Path:
    found = hub.repositories[NAME].at(revision)
    assert found is not None
    for path, content in found[1].items():
        (target / path).parent.mkdir(parents=True, exist_ok=True)
        (target / path).write_bytes(content)
    return target


def test_a_release_arrives_whole(hub: Hub, made: Path, tmp_path: Path) -> None:
    pushed = push(hub, made)
    assert pushed.url == f"{hub.url}/datasets/{NAME}"
    assert pushed.files == len(tree(made))
    assert hub.repositories[NAME].private
    assert hub.repositories[NAME].tags == {"v1.0.0": pushed.commit}
    copy = download(hub, tmp_path / "copy")
    assert verify_release(copy).good
    assert {path for path in tree(copy) if not path.startswith(".")} == tree(made).keys()
    # Once more does nothing.
    again = push(hub, made)
    assert again.already
    assert len(hub.repositories[NAME].commits) == 2


def test_a_page_written_by_hand_is_said_to_be_replaced(
    hub: Hub, source: Path, made: Path, tmp_path: Path, release: Release
) -> None:
    push(hub, made)
    repository = hub.repositories[NAME]
    repository.tags.clear()
    repository.commit({"README.md": b"mine", "notes.txt": b"mine, too"})
    pushed = push(hub, made)
    assert (pushed.replaced, pushed.others, pushed.removed) == (
        ("README.md",),
        ("notes.txt",),
        (),
    )
    assert verify_release(download(hub, tmp_path / "now")).findings[0].path == "notes.txt"
    # That of a release before is replaced without a word.
    release(source, tmp_path / "v2", previous=made, version="1.1.0")
    assert push(hub, tmp_path / "v2").replaced == ()


def test_public_is_said(hub: Hub, made: Path) -> None:
    push(hub, made, public=True)
    assert not hub.repositories[NAME].private


def test_one_that_was_cut_goes_on(hub: Hub, made: Path, tmp_path: Path) -> None:
    hub.refuse_after = 2
    with pytest.raises(ExumiError, match="Run the same command again"):
        push(hub, made)
    # Nothing is to be seen of it yet.
    assert tree(download(hub, tmp_path / "before")).keys() == {".gitattributes"}
    assert len(hub.uploads) == 2
    hub.refuse_after = None
    push(hub, made)
    assert len(hub.uploads) == len(set(hub.uploads)) == 4
    assert verify_release(download(hub, tmp_path / "after")).good


def test_a_later_release_takes_the_place_of_the_one_before(
    hub: Hub, source: Path, made: Path, tmp_path: Path, release: Release
) -> None:
    push(hub, made)
    hub.repositories[NAME].commit({**hub.repositories[NAME].files, "notes.txt": b"mine"})
    shutil.rmtree(source / episode_path(episode_id(0)))
    write_small(source / episode_path(episode_id(5)), 5)
    write_catalog(source, build_catalog(source)[0])
    release(source, tmp_path / "v2", previous=made, preview_bytes=0)
    sent = len(hub.uploads)
    pushed = push(hub, tmp_path / "v2")
    assert pushed.tag == "v2.0.0"
    assert pushed.removed == (episode_path(episode_id(0), packed=True),)
    assert pushed.others == ("notes.txt",)
    assert len(hub.uploads) == sent + 2  # the new episode, and the catalog
    now = download(hub, tmp_path / "now")
    assert [one.path for one in verify_release(now).findings] == ["notes.txt"]
    assert verify_release(download(hub, tmp_path / "then", "v1.0.0")).good


def test_what_is_published_under_a_version_stays(hub: Hub, made: Path) -> None:
    push(hub, made)
    (made / "README.md").write_text("more")
    write_manifest(made)
    with pytest.raises(UsageError, match=r"another release v1\.0\.0"):
        push(hub, made)


def test_damaged_and_invalid_data_are_never_sent(hub: Hub, made: Path) -> None:
    def invalid(_path: Path, thorough: bool) -> Judgement:
        return Judgement(errors=("TIME-001: wrong",)) if thorough else Judgement()

    with pytest.raises(DamagedDataError, match="TIME-001"):
        push(hub, made, judge=invalid)
    (made / "LICENSE").write_text("Something else.\n")
    with pytest.raises(DamagedDataError, match="LICENSE"):
        push(hub, made)
    assert not hub.repositories


@pytest.mark.parametrize(
    "name", ["", "touches", "datasets/our-lab/touches", "our lab/touches", "our--lab/touches"]
)
def test_a_name_that_no_repository_has_is_never_sent(hub: Hub, tmp_path: Path, name: str) -> None:
    """Nor is anything verified: the release need not even be there."""
    with pytest.raises(UsageError, match="is no name of a repository") as caught:
        push_release(tmp_path / "none", name, judge_with(1), endpoint=hub.url)
    assert "our-lab/my-dataset" in str(caught.value)
    assert "Run the same command again" not in str(caught.value)
    assert not hub.repositories


def test_data_that_were_never_released(hub: Hub, source: Path) -> None:
    with pytest.raises(UsageError, match=r"no manifest\.json"):
        push(hub, source)
    write_manifest(source)
    with pytest.raises(UsageError, match="states no version"):
        push(hub, source)
    assert not hub.repositories


def test_the_wrong_account(hub: Hub, made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_TOKEN", "hf_of_somebody_else")
    with pytest.raises(ExumiError, match="hf auth login"):
        push(hub, made)


def test_a_server_that_does_not_answer_is_no_empty_one(
    hub: Hub, made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    push(hub, made)
    hub.repositories[NAME].tags.clear()
    hub.is_broken = True
    monkeypatch.setattr(time, "sleep", lambda _seconds: None)  # the client waits between attempts
    with pytest.raises(ExumiError, match="Run the same command again"):
        push(hub, made)
    assert len(hub.repositories[NAME].commits) == 2


def environment_of(hub: Hub, folder: Path) -> dict[str, str]:
    own = {"HF_ENDPOINT": hub.url, "HF_HUB_DISABLE_XET": "1", "HF_HOME": str(folder / "home")}
    return {**os.environ, **own}


def test_released_and_published_by_one_command(hub: Hub, source: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "exumi_data.cli", "release", str(source), str(tmp_path / "v1")]
    command += ["--licence", LICENCE, "--push", NAME, "--format", "json", "--workers", "1"]
    done = subprocess.run(
        command,
        env=environment_of(hub, tmp_path),
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["pushed"]["tag"] == "v1.0.0"
    copy = download(hub, tmp_path / "copy")
    assert verify_release(copy, fingerprint=said["fingerprint"]).good
    assert verify_release(copy / "preview").good


def test_a_killed_program_goes_on(hub: Hub, made: Path, tmp_path: Path) -> None:
    """The program itself, killed in the middle of an upload and started again."""
    environment = environment_of(hub, tmp_path)
    command = [sys.executable, "-m", "exumi_data.cli", "release", "push", str(made), NAME]
    command += ["--workers", "1", "--public"]
    hub.hang_after = 2
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as program:
        assert hub.hanging.wait(60)
        program.send_signal(signal.SIGKILL)
    sent = len(hub.uploads)
    hub.hang_after = None
    hub.go_on.set()
    done = subprocess.run(
        command, env=environment, check=False, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert f"{hub.url}/datasets/{NAME}: v1.0.0 is published" in done.stdout
    assert sent == 2
    assert len(hub.uploads) == len(set(hub.uploads)) == 4
    assert verify_release(download(hub, tmp_path / "copy")).good


@pytest.mark.parametrize(
    ("part", "code"), [("/refs", 429), ("/objects/batch", 500), ("/tag/", 429)]
)
def test_a_server_in_trouble(
    hub: Hub, made: Path, monkeypatch: pytest.MonkeyPatch, part: str, code: int
) -> None:
    monkeypatch.setattr(time, "sleep", lambda _seconds: None)
    hub.troubles[part] = (code, 99)
    with pytest.raises(ExumiError, match=r"wait some minutes\. What was uploaded is kept"):
        push(hub, made)
    hub.troubles.clear()
    pushed = push(hub, made)
    # What had appeared before the tag was there is not made anew.
    assert hub.repositories[NAME].tags == {"v1.0.0": pushed.commit}
    assert len(hub.repositories[NAME].commits) == 2


def test_another_dataset_and_a_later_release_keep_their_place(
    hub: Hub, source: Path, made: Path, tmp_path: Path, release: Release
) -> None:
    release(source, tmp_path / "v2", version="2.0.0", preview_bytes=0)
    push(hub, tmp_path / "v2")
    with pytest.raises(UsageError, match=r"a later release is published there: 2\.0\.0"):
        push(hub, made)

    def named(metadata: DatasetMetadata) -> None:
        metadata.name = "others"

    change_dataset(source, named)
    release(source, tmp_path / "v3", version="3.0.0", preview_bytes=0)
    with pytest.raises(UsageError, match="another dataset is published there: 'tests'"):
        push(hub, tmp_path / "v3")
    assert len(hub.repositories[NAME].commits) == 2


def test_a_program_that_is_stopped(hub: Hub, made: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "exumi_data.cli", "release", "push", str(made), NAME]
    hub.hang_after = 1
    with subprocess.Popen(
        [*command, "--workers", "1"],
        env=environment_of(hub, tmp_path),
        stderr=subprocess.PIPE,
        text=True,
    ) as program:
        assert hub.hanging.wait(60)
        program.send_signal(signal.SIGINT)
        try:
            said = program.communicate(timeout=10)[1]  # the server says nothing for 30 s
        finally:
            program.kill()
    assert program.returncode == 130
    assert "run the same command again" in said
    assert "Traceback" not in said
    assert list(hub.repositories[NAME].files) == [".gitattributes"]
