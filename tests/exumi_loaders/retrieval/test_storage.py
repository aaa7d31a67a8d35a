"""An index is whole at any moment: killed anywhere, changed by several processes, read back."""

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import exumi_data
from exumi_data.errors import DamagedDataError, MetadataError, UsageError
from exumi_loaders.retrieval import folder
from exumi_loaders.retrieval.building import EncodedClips
from exumi_loaders.retrieval.document import (
    EncoderStatement,
    IndexDocument,
    SegmentStatement,
    dump_index,
    parse_index,
)
from exumi_loaders.retrieval.entries import Entry, entry_of, read_entries, write_entries
from exumi_loaders.retrieval.folder import changing
from exumi_loaders.retrieval.index import TactileIndex
from exumi_loaders.retrieval.segments import open_segment, write_segment
from exumi_loaders.retrieval.space import unit
from exumi_loaders.retrieval.writing import write_index
from exumi_loaders.texture import TextureEncoder
from tests.exumi_loaders.retrieval.gratings import REST, pressed


class _KilledError(BaseException):
    """Stands for SIGKILL: nothing can be done any more, not even cleaning up."""


class _Killer:
    """Counts what touches the disk; from the n-th on, everything fails."""

    def __init__(self) -> None:
        self.left: int | None = None

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.left is None:
            return
        writes = event == "open" and arguments[2] & 3  # not only for reading
        if writes or event in ("os.mkdir", "os.rename", "os.remove", "os.rmdir"):
            self.left -= 1
            if self.left < 0:
                raise _KilledError


_killer = _Killer()
sys.addaudithook(_killer)  # a hook cannot be removed; this one sleeps between tests


@contextmanager
def _killed_after(events: int) -> Iterator[None]:
    _killer.left = events
    try:
        yield
    finally:
        _killer.left = None


def _kill_everywhere(change: Callable[[], object], check: Callable[[bool], None]) -> int:
    """Call a change again and again, killed one step later each time, until it gets through."""
    for events in range(100):
        try:
            with _killed_after(events):
                change()
        except _KilledError:
            check(False)
        else:
            check(True)
            return events
    pytest.fail("it never got through")


def test_killed_anywhere_a_lesson_is_there_or_not(index: TactileIndex) -> None:
    lesson = index.embed(pressed(11, 1), REST)
    before = [entry.id for entry in index.entries()]

    def check(done: bool) -> None:
        opened = TactileIndex.open(index.path)
        ids = [entry.id for entry in opened.entries()]
        assert ids[:12] == before
        # Killed after index.json got its name, the lesson is there although nobody was told.
        assert len(ids) in ((13, 14) if done else (12, 13))
        assert opened.query(lesson, unique="clip")[0].similarity <= 1.0001

    steps = _kill_everywhere(
        lambda: TactileIndex.open(index.path).teach([lesson], name="new"), check
    )
    assert steps > 8  # the hook saw what happens
    # What the dead left behind is gone after the next change.
    index.forget("new")
    TactileIndex.open(index.path).teach([lesson], name="newer")
    left = {path.name for path in (index.path / "segments").iterdir()}
    assert left == {s.name for s in TactileIndex.open(index.path).document.segments}
    assert not list(index.path.glob(".partial-*"))


def test_killed_anywhere_something_is_forgotten_or_not(index: TactileIndex) -> None:
    def check(done: bool) -> None:
        count = len(TactileIndex.open(index.path))
        assert count == 8 if done else count in (8, 12)

    def change() -> None:
        if len(TactileIndex.open(index.path)) == 12:
            TactileIndex.open(index.path).forget("a comb 0", built=True)

    _kill_everywhere(change, check)


def test_killed_anywhere_a_build_is_there_or_not(tmp_path: Path) -> None:
    encoder = TextureEncoder(1)
    vectors = np.random.default_rng(0).normal(size=(5, encoder.dimension)).astype(np.float32)
    clips = EncodedClips(vectors, [Entry(f"e{n}/t", "x") for n in range(5)], encoder.digest)
    target = tmp_path / "index"

    def change() -> None:
        if not target.exists():
            write_index(target, clips, encoder, frames=10)

    def check(done: bool) -> None:
        if done or target.exists():
            assert len(TactileIndex.open(target)) == 5

    _kill_everywhere(change, check)
    assert [path.name for path in tmp_path.iterdir()] == ["index"]


_TEACHER = """
import sys
import numpy as np
from exumi_loaders import Embedding, TactileIndex

index = TactileIndex.open(sys.argv[1])
vector = np.random.default_rng(int(sys.argv[2])).normal(size=114).astype(np.float32)
lesson = Embedding(vector, index.document.encoder.digest)
for number in range(5):
    index.teach([lesson], name=f"{sys.argv[2]}/{number}")
index.forget(f"{sys.argv[2]}/3")
"""


def test_several_processes_append_and_nothing_is_lost(index: TactileIndex) -> None:
    teachers = [
        subprocess.Popen([sys.executable, "-c", _TEACHER, str(index.path), str(number)])
        for number in range(2)
    ]
    assert [teacher.wait(timeout=120) for teacher in teachers] == [0, 0]
    opened = TactileIndex.open(index.path)
    taught = {entry.name for entry in opened.entries() if entry.taught}
    assert taught == {f"{who}/{n}" for who in range(2) for n in range(5) if n != 3}
    assert opened.info().generation == 12


def test_a_reader_keeps_what_it_opened(index: TactileIndex) -> None:
    lesson = index.embed(pressed(11, 1), REST)
    index.teach([lesson], name="new")
    reader = TactileIndex.open(index.path)
    index.forget("new")
    index.teach([lesson], name="newer")  # removes the forgotten segment's files
    assert reader.query(lesson)[0].name == "new"
    assert TactileIndex.open(index.path).query(lesson)[0].name == "newer"


def test_one_that_changes_waits_for_another(
    index: TactileIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder, "_PATIENCE_S", 0.05)
    lesson = index.embed(pressed(11, 1), REST)
    with changing(index.path), pytest.raises(UsageError, match="another process"):
        TactileIndex.open(index.path).teach([lesson], name="new")
    index.teach([lesson], name="new")


def test_an_index_that_was_replaced_is_not_taught(
    index: TactileIndex, tmp_path: Path, gratings: exumi_data.Dataset
) -> None:
    lesson = index.embed(pressed(11, 1), REST)
    shutil.rmtree(index.path)
    TactileIndex.build(gratings, path=index.path)
    with pytest.raises(UsageError, match="replaced"):
        index.teach([lesson], name="new")


_words = st.text(st.characters(codec="utf-8"), min_size=1, max_size=12)
_maybe = st.none() | _words
_entries = st.builds(
    Entry,
    id=_words,
    name=_words.filter(str.strip),
    object_id=_maybe,
    part_id=_maybe,
    part=_maybe,
    sensor_model=_maybe,
    pad_type=_maybe,
    adjectives=st.lists(_words, max_size=4).map(tuple),
    labels=st.dictionaries(_words, st.floats(0, 10), max_size=3),
    provenance=st.sampled_from(["human", "model"]),
    taught=st.booleans(),
    clips=st.integers(1, 9),
    origins=st.lists(_words, max_size=3).map(tuple),
)


@settings(max_examples=30)  # each writes files
@given(entries=st.lists(_entries, min_size=1, max_size=6), width=st.integers(1, 9))
def test_segments_come_back_as_they_were(
    tmp_path_factory: pytest.TempPathFactory, entries: list[Entry], width: int
) -> None:
    root = tmp_path_factory.mktemp("segment")
    vectors = unit(np.random.default_rng(width).normal(size=(len(entries), width)))
    segment = open_segment(root, write_segment(root, vectors, entries), width)
    assert segment.entries(segment.alive) == entries
    np.testing.assert_array_equal(np.concatenate([block.rows for block in segment.blocks]), vectors)
    assert [entry_of(row) for row in segment.table.to_pylist()] == entries


def test_large_segments_are_mapped_in_blocks(tmp_path: Path) -> None:
    vectors = unit(np.random.default_rng(0).normal(size=(5_000, 2048)))
    entries = [Entry(f"e{n}/t", "x") for n in range(len(vectors))]
    blocks = (vectors[start : start + 999] for start in range(0, len(vectors), 999))
    segment = open_segment(tmp_path, write_segment(tmp_path, blocks, entries), 2048)
    assert len(segment.blocks) > 1
    assert not any(block.rows.flags.writeable for block in segment.blocks)
    np.testing.assert_array_equal(np.concatenate([block.rows for block in segment.blocks]), vectors)


def test_vectors_that_are_not_numbers_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="finite"):
        write_segment(tmp_path, np.full((1, 3), np.nan, np.float32), [Entry("e/t", "x")])
    with pytest.raises(UsageError, match="2 vectors for 1"):
        write_segment(tmp_path, np.zeros((2, 3), np.float32), [Entry("e/t", "x")])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"adjectives": [None]}, "no table"),
        ({"origins": ["a", None]}, "no table"),
        ({"labels": [None]}, "no table"),
        ({"labels": [{"property": None, "value": 1.0}]}, "no table"),
        ({"labels": [{"property": "hardness", "value": None}]}, "no table"),
        ({"labels": [{"property": "hardness", "value": float("nan")}]}, "from 0 to 10"),
        ({"provenance": "oracle"}, "invalid provenance"),
        ({"name": ""}, "needs a name"),
    ],
)
def test_entries_that_nobody_wrote_are_damage(tmp_path: Path, change: Any, said: str) -> None:
    path = tmp_path / "entries.parquet"
    write_entries(path, [Entry("a", "x", adjectives=("soft",), labels={"hardness": 3.0})])
    table = pq.read_table(path)
    row = {**table.to_pylist()[0], **change}
    pq.write_table(pa.Table.from_pylist([row], schema=table.schema), path)
    with pytest.raises(DamagedDataError, match=said):
        entry_of(read_entries(path, 1).to_pylist()[0])


def test_a_table_of_another_kind_is_refused(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    write_entries(tmp_path / "entries.parquet", [Entry("e/t", "x")])
    assert read_entries(tmp_path / "entries.parquet", 1).num_rows == 1
    with pytest.raises(DamagedDataError, match="so many"):
        read_entries(tmp_path / "entries.parquet", 2)
    pq.write_table(pa.table({"id": ["x"]}), tmp_path / "other.parquet")
    with pytest.raises(DamagedDataError, match="no table"):
        read_entries(tmp_path / "other.parquet", 1)
    (tmp_path / "link.parquet").symlink_to(tmp_path / "entries.parquet")
    with pytest.raises(DamagedDataError, match="missing"):
        read_entries(tmp_path / "link.parquet", 1)


def _document(**changed: Any) -> IndexDocument:
    encoder = EncoderStatement(name="e/1", digest="e/1?x", dimension=8)
    known = {"encoder": encoder, "frames": 10, "dimension": 8, **changed}
    return IndexDocument(**known)


@given(
    rows=st.integers(1, 50),
    forgotten=st.sets(st.integers(0, 49), max_size=5),
    generation=st.integers(0, 2**40),
)
def test_documents_come_back_as_they_were(rows: int, forgotten: set[int], generation: int) -> None:
    segment = SegmentStatement(
        name="ab" * 16, rows=rows, crc32c=[7], forgotten=sorted(n for n in forgotten if n < rows)
    )
    document = _document(segments=[segment], generation=generation)
    assert parse_index(dump_index(document), "here") == document


@pytest.mark.parametrize(
    "segments",
    [
        [SegmentStatement(name="ab" * 16, rows=3, crc32c=[1], forgotten=[3])],
        [SegmentStatement(name="ab" * 16, rows=3, crc32c=[1], forgotten=[1, 1])],
        [SegmentStatement(name="ab" * 16, rows=3, crc32c=[1])] * 2,
    ],
)
def test_documents_that_contradict_themselves_are_refused(segments: Any) -> None:
    with pytest.raises(MetadataError):
        parse_index(dump_index(_document(segments=segments)), "here")


def test_names_of_segments_lead_nowhere_else() -> None:
    raw = dump_index(_document(segments=[SegmentStatement(name="ab" * 16, rows=3, crc32c=[1])]))
    with pytest.raises(MetadataError):
        parse_index(raw.replace(b"ab" * 16, b"../../etc"), "here")
