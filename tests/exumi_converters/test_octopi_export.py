"""Back to Octopi-1.5's samples: what its own code would read, and our reader."""

import json
from pathlib import Path

import numpy as np
import pytest

from exumi_converters import ConvertOptions, ExportOptions, convert, export, plan_export
from exumi_converters.registry import find_converter, find_exporter
from exumi_converters.testing import check_converter, check_exporter, check_round_trip
from exumi_data.catalog import build_catalog, write_catalog
from exumi_data.dataset import open_dataset
from exumi_data.errors import UsageError
from tests.exumi_converters.whole import write_dataset

QUICK = ConvertOptions(workers=1, durable=False)
ALL = ExportOptions(durable=False, settings={"frames": "all"})


@pytest.fixture
def touches(samples: Path, tmp_path: Path) -> Path:
    convert(samples, tmp_path / "touches", from_format="octopi", options=QUICK)
    return tmp_path / "touches"


def test_the_contracts(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", seconds=0.6)
    exporter, converter = find_exporter("octopi"), find_converter("octopi")
    check_exporter(exporter, dataset, tmp_path / "out")
    check_converter(converter, tmp_path / "out" / "first" / "samples", tmp_path / "in")
    check_round_trip(exporter, converter, dataset, tmp_path / "trip")


def test_what_octopi_reads(touches: Path, tmp_path: Path) -> None:
    report = export(touches, tmp_path / "out", to_format="octopi", options=ALL)
    assert report.written == 3
    root = tmp_path / "out"
    documents = {
        path.parent.name: json.loads(path.read_text()) for path in root.glob("samples/*/data.json")
    }
    assert sorted(documents) == ["hardness_0", "physiclear_0", "physicleardotted_0"]
    assert documents["physiclear_0"] == {
        "object_id": "physiclear_egg",
        "object": "an egg",
        "properties": {"hardness": 7.67, "roughness": 1.33},
        "tactile_format": "video",
        "exploratory_procedure": "Pressing",
        "tactile_path": "physiclear/Pressing/egg_3.mov",
        "split": "train",
    }
    assert documents["hardness_0"]["object_id"] == "hardness_ball_soft"
    assert json.loads((root / "val_samples.json").read_text()) == {
        "physiclear_egg": ["data/samples/physicleardotted_0"]
    }
    assert json.loads((root / "test_samples.json").read_text()) == {}
    train = json.loads((root / "train_samples.json").read_text())
    assert train["physiclear_egg"] == ["data/samples/physiclear_0"]


def test_jpegs_stay_as_they_are_and_come_back(touches: Path, tmp_path: Path) -> None:
    export(touches, tmp_path / "out", to_format="octopi", options=ALL)
    convert(tmp_path / "out" / "samples", tmp_path / "back", from_format="octopi", options=QUICK)
    before = {_name(e): e for e in open_dataset(touches)}
    after = {_name(e): e for e in open_dataset(tmp_path / "back")}
    assert before.keys() == after.keys()
    for name, episode in before.items():
        own, other = episode["tactile"], after[name]["tactile"]
        assert [own.encoded(i) for i in range(len(own))] == [
            other.encoded(i) for i in range(len(other))
        ]


def _name(episode: object) -> str:
    about = episode.metadata.annotations  # type: ignore[attr-defined]  # an episode
    return f"{about.part_id} {about.pad_type} {about.trial} {about.procedure}"


def test_salient_frames_are_the_papers(octopi: Path, labels: Path, tmp_path: Path) -> None:
    told = ConvertOptions(workers=1, durable=False, labels=labels)
    convert(octopi, tmp_path / "data", from_format="octopi", options=told)
    report = export(
        tmp_path / "data",
        tmp_path / "out",
        to_format="octopi",
        options=ExportOptions(durable=False),
    )
    assert any("no split 'octopi15'" in line for line in report.notices)
    episodes = {e.metadata.annotations.part_id: e for e in open_dataset(tmp_path / "data")}  # type: ignore[union-attr]  # clips have them
    for path in (tmp_path / "out").glob("samples/*/data.json"):
        part = json.loads(path.read_text())["object_id"].removeprefix("physiclear_")
        numbers = sorted(int(file.stem) - 1 for file in (path.parent / "tactile").iterdir())
        if part != "egg":  # of which there are two clips
            salient = episodes[part]["tactile"].salient
            assert salient is not None
            assert numbers == salient.tolist()
            assert len(np.unique(numbers)) == 10


def test_episodes_that_name_no_part_are_refused(touches: Path, tmp_path: Path) -> None:
    clips = write_dataset(tmp_path / "data", seconds=0.2)
    for path in clips.glob("episodes/*/*/zarr.json"):
        document = json.loads(path.read_text())
        del document["attributes"]["exumi"]["annotations"]["part_id"]
        path.write_text(json.dumps(document))
    write_catalog(clips, build_catalog(clips)[0])
    with pytest.raises(UsageError, match="names no part"):
        plan_export(clips, tmp_path / "out", to_format="octopi")
    wrong = ExportOptions(settings={"split": "nine"})
    with pytest.raises(UsageError, match="no split 'nine'"):
        plan_export(touches, tmp_path / "out", to_format="octopi", options=wrong)


def test_one_rating_without_the_other_is_lost_and_said(
    octopi: Path, labels: Path, tmp_path: Path
) -> None:
    """Octopi's code takes hardness and roughness, or neither: one alone is a KeyError there."""
    told = ConvertOptions(workers=1, durable=False, labels=labels)
    convert(octopi, tmp_path / "data", from_format="octopi", options=told)
    plan = plan_export(tmp_path / "data", tmp_path / "out", to_format="octopi")
    assert any("only hardness or only roughness" in loss.detail for loss in plan.losses)
    export(
        tmp_path / "data",
        tmp_path / "out",
        to_format="octopi",
        options=ExportOptions(durable=False),
    )
    found = {}
    for path in (tmp_path / "out").glob("samples/*/data.json"):
        document = json.loads(path.read_text())
        found[document["object_id"]] = set(document.get("properties", ()))
    both = {"hardness", "roughness"}
    assert found == {
        "physiclear_egg": both,
        "physiclear_rice": both,
        "physiclear_rice_spatula_base": set(),
        "physiclear_apple": set(),
    }


def test_lists_that_lead_elsewhere_are_refused(touches: Path, tmp_path: Path) -> None:
    path = touches / "splits" / "octopi15.json"
    document = json.loads(path.read_text())
    document["lists"]["../../evil"] = document["lists"].pop("val")
    path.write_text(json.dumps(document))
    with pytest.raises(UsageError, match=r"the list '../../evil': Octopi's are train, val, test"):
        export(touches, tmp_path / "in" / "out", to_format="octopi", options=ALL)
    assert not (tmp_path / "evil_samples.json").exists()
