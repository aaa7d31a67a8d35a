import io
import re
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.editing.documents import write_splits
from exumi_data.model import (
    Annotations,
    DatasetMetadata,
    Label,
    LossyStep,
    QualityNote,
    Source,
    Task,
)
from exumi_data.model.dataset import SplitDocument
from exumi_data.release.card import Card, card_of
from exumi_data.release.card_header import hub_licence
from exumi_data.release.citation import Edition
from exumi_data.release.markdown import bytes_text, code_block, duration, plain
from tests.exumi_data.builders import episode_id, write_dataset, write_episode, write_small

EVIL = "a|b <script>alert(1)</script> `x` *y* ![z](javascript:1) # head"


@dataclass(frozen=True)
class Found:
    code: str
    severity: str
    message: str
    count: int = 1


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("card") / "my-touches"
    metadata = DatasetMetadata(
        name="my-touches", licence="CC-BY-4.0", authors=["A. Person"], description="Clips of gels."
    )
    create_dataset(root, metadata)
    label = Label(
        property="hardness", value=3.5, scale=[0, 10], raters=3, provenance="human", origin="survey"
    )
    lossy = [LossyStep(step="jpeg-encode", stream="tactile", detail="quality 95", by="a camera")]
    source = Source(type="recorded", tool="hub", tool_version="2", lossy=lossy)
    said: list[dict[str, Any]] = [
        {"annotations": Annotations(object_id="cup", labels=[label]), "success": True},
        {"source": source, "quality": [QualityNote(code="dropped", message="it fell")]},
        {"task": Task(name=EVIL), "success": False, "licence": "MIT"},
    ]
    for number, changes in enumerate(said):
        path = root / episode_path(episode_id(number))
        path.parent.mkdir(parents=True, exist_ok=True)
        write_episode(path, number, **changes)
    write_catalog(root, build_catalog(root)[0])
    lists = {"train": [episode_id(0), episode_id(1)], "val": [episode_id(2)]}
    write_splits(root, {"default": SplitDocument(name="default", level="object", lists=lists)})
    return root


@pytest.fixture(scope="module")
def card(dataset: Path) -> Card:
    return card_of(dataset)


def section(text: str, name: str) -> str:
    return text.partition(f"## {name}\n")[2].partition("\n## ")[0]


def test_that_the_hub_reads_its_head(card: Card) -> None:
    hub = pytest.importorskip("huggingface_hub")
    data = hub.DatasetCard(card.text).data.to_dict()
    assert data == {
        "license": "cc-by-4.0",
        "pretty_name": "my-touches",
        "task_categories": ["robotics"],
        "tags": ["exumi", "tactile", "manipulation", "zarr", "pose", "width", "wrench", "taxels",
                 "rgb"],
        "size_categories": ["n<1K"],
        "configs": [{"config_name": "episodes", "data_files": "catalog.parquet"}],
    }  # fmt: skip


def test_what_it_says(card: Card) -> None:
    assert "| episodes | 3 |" in section(card.text, "What it holds")
    assert "| gopro | rgb | 32×24, video (mpeg4) |" in section(card.text, "What it holds")
    making = section(card.text, "How it was made")
    assert "- jpeg-encode of tactile: quality 95, by a camera – 1 episode" in making
    assert "| recorded | hub 2 |  | 1 |" in making
    assert "| default | train | object | 2 |" in section(card.text, "Splits")
    labels = re.sub(" +", " ", section(card.text, "Labels"))
    assert "| hardness | 3.5 | 0 to 10 | people | 3 | survey | 1 |" in labels
    quality = section(card.text, "Quality")
    assert "| dropped | 1 |" in quality
    assert "The task was done: no 1, yes 1." in quality
    assert "| MIT | 1 |" in section(card.text, "Licence")
    assert "own, which holds for them: 3 of 3." in section(card.text, "Licence")
    assert "author = {A. Person}" in section(card.text, "Citation")
    assert "| encoder | made up | 3 |" in section(card.text, "Sensors and calibration")
    assert "Simulated, and measured by no sensor: 2 episodes" in section(card.text, "Known limits")


def test_findings(dataset: Path) -> None:
    found = [Found("TIME-001", "warning", "late", 7), Found("SAFE-001", "error", "bad | name")]
    quality = section(card_of(dataset, found).text, "Quality")
    assert quality.index("SAFE-001 | 1 | bad \\| name") < quality.index("TIME-001 | 7 | late")
    assert "nothing to complain" in section(card_of(dataset, []).text, "Quality")
    assert "exumi validate" not in card_of(dataset).text


def test_that_strange_words_are_words(card: Card) -> None:
    assert "<script>" not in card.text
    assert "![z]" not in card.text
    line = next(one for one in card.text.splitlines() if "alert(1)" in one)
    assert len(re.findall(r"(?<!\\)\|", line)) == 3  # a table of two columns
    assert plain("a\x1b[31m\nb") == "a \\[31m b"
    assert code_block("```", "python")[0] == "````python"


def test_that_its_code_runs(card: Card, dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = section(card.text, "Loading").partition("```python\n")[2].partition("```")[0]
    monkeypatch.chdir(dataset.parent)
    printed = io.StringIO()
    with redirect_stdout(printed):
        exec(compile(code, "card", "exec"), {})  # noqa: S102  # it is what readers will do
    assert "tactile tactile 5" in printed.getvalue()
    assert "(24, 32, 3)" in printed.getvalue()


def test_that_it_is_the_same_each_time(card: Card, dataset: Path) -> None:
    assert card_of(dataset) == card
    assert str(dataset.parent) not in card.text


def test_its_pictures(card: Card, dataset: Path) -> None:
    assert set(card.pictures) == {f"pictures/{n}.png" for n in ("touch", "camera", "signals")}
    assert sum(map(len, card.pictures.values())) < 2_000_000
    for name, data in card.pictures.items():
        assert f"]({name})" in card.text
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        assert picture.shape[1] == 1000
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 30
    # The frame of the most activity is in it, in its own colours.
    touch = cv2.imdecode(np.frombuffer(card.pictures["pictures/touch.png"], np.uint8), 1)
    assert touch is not None
    with open_dataset(dataset)[0] as episode:
        activity = episode["tactile"].activity
        assert activity is not None
        frame = episode["tactile"].frames[int(np.argmax(activity))]
    shown = cv2.cvtColor(touch, cv2.COLOR_BGR2RGB)[64 + 20 : 64 + 110, 24 + 20 : 24 + 160]
    expected = cv2.resize(frame, (182, 136), interpolation=cv2.INTER_AREA)[20:110, 20:160]
    assert np.abs(shown.astype(int) - expected).mean() < 8


def test_small_and_empty_datasets(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "small", 1, description="One.")
    text = card_of(root, edition=Edition(version="1.0.0"), repository="lab/small").text
    assert "snapshot_download('lab/small', repo_type='dataset', local_dir='tests')" in text
    assert "version = {1.0.0}" in text
    empty = tmp_path / "empty"
    create_dataset(empty, DatasetMetadata(name="empty", licence="NOASSERTION"))
    write_catalog(empty, build_catalog(empty)[0])
    card = card_of(empty)
    assert card.pictures == {}
    assert "It is not known under which licence" in card.text


def test_values_of_labels(tmp_path: Path) -> None:
    """The most frequent words first, the others counted; of numbers it is said what they are."""
    root = tmp_path / "set"
    create_dataset(root, DatasetMetadata(name="set", licence="CC-BY-4.0"))
    words = (["zigzag", *"abcdef"], ["zigzag", "x" * 500])
    for number, (value, felt) in enumerate(zip((0.5, 7.5), words, strict=True)):
        path = root / episode_path(episode_id(number))
        path.parent.mkdir(parents=True, exist_ok=True)
        labels = [
            Label(property="hardness", value=value, provenance="human"),
            Label(property="touch", value=felt, provenance="human"),
        ]
        write_small(path, number, annotations=Annotations(labels=labels))
    write_catalog(root, build_catalog(root)[0])
    said = section(card_of(root).text, "Labels")
    assert "| Values (of numbers: median, and lowest to highest) |" in said
    assert "| 4 (0.5 to 7.5) |" in said
    assert "| zigzag, a, b, c, d, e, and 2 more |" in said


def test_episodes_that_say_that_they_have_no_licence(tmp_path: Path) -> None:
    root = tmp_path / "set"
    create_dataset(root, DatasetMetadata(name="set", licence="CC-BY-4.0"))
    for number, licence in enumerate(("NOASSERTION", "NOASSERTION", "MIT")):
        path = root / episode_path(episode_id(number))
        path.parent.mkdir(parents=True, exist_ok=True)
        write_small(path, number, licence=licence)
    write_catalog(root, build_catalog(root)[0])
    said = section(card_of(root).text, "Licence")
    assert "`NOASSERTION` is no licence, and 2 of 3 episodes say it" in said
    assert "| NOASSERTION |" not in said
    assert "own, which holds for them: 1 of 3." in said


@pytest.mark.parametrize(
    ("licence", "known"),
    [
        ("Apache-2.0", "apache-2.0"),
        ("CC-BY-NC-SA-4.0", "cc-by-nc-sa-4.0"),
        ("GPL-3.0-or-later", "gpl-3.0"),
        ("AGPL-3.0-only", "agpl-3.0"),
        ("ODC-By-1.0", "odc-by"),
        ("NOASSERTION", "unknown"),
        ("MIT OR Apache-2.0", "other"),
        ("LicenseRef-ours", "other"),
        ("CC-BY-ND-2.0-JP", "other"),
    ],
)
def test_licences_by_the_hubs_names(licence: str, known: str) -> None:
    assert hub_licence(licence) == known


def test_amounts() -> None:
    assert [duration(seconds) for seconds in (5, 90, 5400)] == ["5.0 s", "1.5 min", "1.5 h"]
    assert [bytes_text(count) for count in (999, 1000, 2.5e9)] == ["999 B", "1.0 kB", "2.5 GB"]
