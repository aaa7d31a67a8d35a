"""What the corpus itself must be: not empty, complete, small, and readable without us."""

import hashlib
import json
import zipfile
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import zarr

import exumi_data
from exumi_data.model.schema import DOCUMENTS, json_schema
from exumi_data.standard import rules
from exumi_data.store.shards import ArrayReader, open_array

CORPUS = Path(__file__).resolve().parents[2] / "spec" / "conformance" / "1.0"
VALID = sorted((CORPUS / "valid").iterdir())
INVALID = sorted((CORPUS / "invalid").iterdir())
MODEL_CODES = {"META-001", "META-002", "META-003", "ID-001", "KIND-001", "EXT-001"}
# Documents of another version or format, and what is no JSON.
NOT_FOR_A_SCHEMA = {"META-004", "DOC-001", "DOC-003", "DOC-004", "DOC-005"}
PLACES = {
    "episode": ("zarr.json", ("attributes", "exumi")),
    "derived": ("derived/zarr.json", ("attributes", "exumi")),
    "dataset": ("dataset.json", ()),
    "split": ("splits/default.json", ()),
    "manifest": ("manifest.json", ()),
}


def expected(case: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((case / "expected.json").read_text("utf-8"))
    return document


def name(case: Path) -> str:
    return case.name


def test_there_are_cases() -> None:
    assert len(VALID) >= 25
    assert len(INVALID) >= len(rules())


def test_every_rule_has_a_case_of_its_name() -> None:
    named = {case.name.partition("__")[0] for case in INVALID}
    assert named == set(rules())


def test_the_corpus_is_small() -> None:
    files = [path for path in CORPUS.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 5_000_000


@pytest.mark.parametrize("case", VALID, ids=name)
def test_valid_cases_expect_nothing(case: Path) -> None:
    assert expected(case)["findings"] == []


@pytest.mark.parametrize("case", INVALID, ids=name)
def test_invalid_cases_expect_known_rules(case: Path) -> None:
    codes = {finding["code"] for finding in expected(case)["findings"]}
    assert case.name.partition("__")[0] in codes
    assert codes <= set(rules())


@pytest.mark.parametrize("case", VALID, ids=name)
def test_our_reader_reads_all_of_a_valid_case(case: Path) -> None:
    opened = exumi_data.open(case / expected(case)["store"])
    episodes = list(opened) if isinstance(opened, exumi_data.Dataset) else [opened]
    assert bool(episodes) == (case.name != "dataset__empty")
    for episode in episodes:
        episode.check_complete()
        for stream in episode.streams.values():
            for array in stream.metadata.arrays:
                assert isinstance(stream.array(array), np.ndarray)
            if stream.is_image:
                assert len(list(stream.frames.iterate())) == len(stream)


@pytest.mark.parametrize("case", VALID, ids=name)
def test_plain_zarr_reads_the_same(case: Path) -> None:
    store = case / expected(case)["store"]
    if store.name != "store.zarr":
        pytest.skip("a dataset or a zip: the folders show the same")
    group = zarr.open_group(store, mode="r", zarr_format=3)
    episode = exumi_data.open(store)
    assert isinstance(episode, exumi_data.Episode)
    for path, node in group.members(max_depth=None):
        if isinstance(node, zarr.Array):
            reader = open_array(episode.store, path)
            assert isinstance(reader, ArrayReader), "the standard's layout is the fast reader's"
            plain: Any = node[:]
            np.testing.assert_array_equal(reader.read(), plain)


def document_of(case: Path, kind: str) -> Any:
    """One document of a case, or None where it is not there or no JSON object."""
    file, keys = PLACES[kind]
    try:
        value = json.loads((case / expected(case)["store"] / file).read_text("utf-8"))
    except (OSError, ValueError):
        return None
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_schema_and_model_agree_on_every_document(kind: str) -> None:
    schema = json_schema(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    judge = jsonschema.Draft202012Validator(schema)
    file = PLACES[kind][0]
    judged = 0
    for case in (*VALID, *INVALID):
        document = document_of(case, kind)
        findings = expected(case)["findings"]
        of_file = {f["code"] for f in findings if f["path"] == file and not f["episode"]}
        if document is None or of_file & NOT_FOR_A_SCHEMA:
            continue
        judged += 1
        by_schema = judge.is_valid(document)
        assert by_schema == (not of_file & MODEL_CODES), case.name
    assert judged > 5


def files_of(store: Path) -> dict[str, bytes]:
    """The files of an episode, read without the library."""
    if store.is_file():
        with zipfile.ZipFile(store) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    return {
        p.relative_to(store).as_posix(): p.read_bytes() for p in store.rglob("*") if p.is_file()
    }


def digest(store: Path) -> str:
    """The digest by section 14 of the standard."""
    lines = [
        f"{hashlib.sha256(data).hexdigest()} {len(data)} {path}\n".encode()
        for path, data in sorted(files_of(store).items(), key=lambda item: item[0].encode())
        if not path.startswith("derived/")
    ]
    return hashlib.sha256(b"".join(lines)).hexdigest()


@pytest.mark.parametrize("case", VALID, ids=name)
def test_the_dump_of_a_valid_case_has_its_digest(case: Path) -> None:
    dump = json.loads((case / "dump.json").read_bytes())
    store = case / expected(case)["store"]
    if store.name != "dataset":
        assert dump["digest"] == digest(store)
        return
    stores = [*store.glob("episodes/*/*.zarr"), *store.glob("episodes/*/*.zarr.zip")]
    assert sorted(e["digest"] for e in dump["episodes"]) == sorted(map(digest, stores))


def test_a_packed_case_has_the_digest_of_its_folder(tmp_path: Path) -> None:
    packed = CORPUS / "valid" / "packed__derived"
    folder = tmp_path / "store.zarr"
    with zipfile.ZipFile(packed / "store.zarr.zip") as archive:
        archive.extractall(folder)
    opened = exumi_data.open(folder)
    assert isinstance(opened, exumi_data.Episode)
    twin = CORPUS / "valid" / "derived__activity_and_salient"
    for case in (packed, twin):
        assert opened.digest() == json.loads((case / "dump.json").read_bytes())["digest"]
