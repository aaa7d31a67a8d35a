"""One number, one spoiled store: always the same one."""

import io
from collections.abc import Callable, Sequence
from random import Random

import pyarrow as pa
import pyarrow.parquet as pq

from tests.fuzz.spoil_arrays import arrays_of, spoil_index, spoil_values
from tests.fuzz.spoil_bytes import spoil_bytes, spoil_word
from tests.fuzz.spoil_json import spoil_document
from tests.fuzz.spoil_zips import spoil_zip
from tests.fuzz.stores import Draft, Special, Store, as_zip, unzipped

__all__ = ["spoiled"]

CATALOG = "catalog.parquet"
ODD_NAMES = (
    "streams/x", ".hidden", "streams/é", "streams/a\\b", "streams/a\nb", "notes.txt", "c/0",
    "derived/zarr.json", "derived/x/y/zarr.json", "calibration/map/zarr.json", "zarr.json.bak",
    "streams/width/time/c/1", "streams/width/time/c/00", "streams/width/time/c/-1",
    "episodes/a1/x.zarr/zarr.json", "episodes/a1/x.zarr.zip", "episodes/.x/y", "episodes/x",
    "splits/x.json", "splits/ .json", "manifest.json", "a" * 250, "/".join("abcdefgh" * 30),
)  # fmt: skip

Way = Callable[[Draft, Random], str]


def _json(draft: Draft, random: Random) -> str:
    paths = draft.paths(".json")
    if not paths:
        return "nothing"
    roots = [path for path in paths if path.count("/") == 0 or "attributes" in path]
    path = random.choice(roots if roots and random.random() < 0.5 else paths)
    draft.files[path], done = spoil_document(draft.data(path), random)
    return f"{path}: {done}"


def _bytes(draft: Draft, random: Random) -> str:
    path = random.choice(draft.paths() or [""])
    if path not in draft.files:
        return "nothing"
    draft.files[path] = spoil_bytes(draft.data(path), random)
    return f"bytes of {path}"


def _index(draft: Draft, random: Random) -> str:
    arrays = arrays_of(draft)
    return spoil_index(draft, random.choice(arrays), random) if arrays else "nothing"


def _values(draft: Draft, random: Random) -> str:
    arrays = arrays_of(draft)
    return spoil_values(draft, random.choice(arrays), random) if arrays else "nothing"


def _pictures(draft: Draft, random: Random) -> str:
    """Change bytes of JPEG and video files, most of them where their headers are."""
    shards = [path for path in draft.paths() if "/data/c/" in path and len(draft.data(path)) > 400]
    if not shards:
        return "nothing"
    path = random.choice(shards)
    data = draft.data(path)
    marks = [data.find(mark) for mark in (b"moov", b"stbl", b"stsd", b"\xff\xc0", b"\xff\xd8")]
    starts = [mark for mark in marks if mark >= 0] or [0]
    for _ in range(random.choice((1, 1, 2, 5))):
        start = random.choice(starts)
        data = spoil_word(data, random, start, min(len(data), start + random.choice((40, 600))))
    draft.files[path] = data
    return f"picture in {path}"


def _without(draft: Draft, one: str, two: str, random: Random) -> str:
    del draft.files[one]
    return f"without {one}"


def _swapped(draft: Draft, one: str, two: str, random: Random) -> str:
    draft.files[one], draft.files[two] = draft.files[two], draft.files[one]
    return f"{one} and {two} swapped"


def _copied(draft: Draft, one: str, two: str, random: Random) -> str:
    draft.files[one] = draft.files[two]
    return f"{one} is {two}"


def _emptied(draft: Draft, one: str, two: str, random: Random) -> str:
    draft.files[one] = random.choice((b"", b"{}", b"[]", b"null", b"\0" * 1000))
    return f"{one} is nothing"


def _special(draft: Draft, one: str, two: str, random: Random) -> str:
    special = random.choice(tuple(Special))
    draft.files[one] = special
    return f"{one} is a {special.value}"


def _folder_gone(draft: Draft, one: str, two: str, random: Random) -> str:
    parts = one.split("/")
    folder = "/".join(parts[: random.randrange(1, len(parts))]) if len(parts) > 1 else one
    for path in [path for path in draft.files if path.startswith(f"{folder}/")]:
        del draft.files[path]
    if random.random() < 0.5:
        draft.files[folder] = random.choice((Special.LINK, Special.PIPE, b"x"))
        return f"{folder} is no folder"
    return f"without {folder}"


def _added(draft: Draft, one: str, two: str, random: Random) -> str:
    name = random.choice(ODD_NAMES)
    draft.files[name] = random.choice((b"x", b"{}", draft.data(one), Special.PIPE, Special.LINK))
    return f"and {name[:40]}"


_FILE_WAYS = (_without, _swapped, _copied, _emptied, _special, _folder_gone, _added)


def _files(draft: Draft, random: Random) -> str:
    paths = draft.paths()
    if not paths:
        return "nothing"
    one, two = random.choice(paths), random.choice(paths)
    return random.choice(_FILE_WAYS)(draft, one, two, random)


def _catalog(draft: Draft, random: Random) -> str:
    if not isinstance(draft.files.get(CATALOG), bytes):  # none, or a link or a pipe by now
        return _json(draft, random)
    try:
        table = pq.read_table(io.BytesIO(draft.data(CATALOG)))
    except (pa.ArrowException, OSError):
        return _bytes(draft, random)
    if not table.column_names:  # all were dropped before
        return _bytes(draft, random)
    column = random.choice(table.column_names)
    place = table.column_names.index(column)
    way = random.randrange(7)
    count = table.num_rows
    if way == 0:
        table = table.drop_columns([column])
    elif way == 1:
        values: Sequence[object] = random.choice(
            ([None] * count, [1] * count, ["../x"] * count, [1.5] * count, [b"\xff"] * count)
        )
        table = table.set_column(place, column, pa.array(values))
    elif way == 2:
        table = pa.concat_tables([table] * random.choice((2, 3)))
    elif way == 3:
        table = table.slice(random.randrange(count + 1))
    elif way == 4:
        table = table.append_column(column, table.column(column))
    elif way == 5:
        other = random.choice(table.column_names)
        table = table.set_column(place, column, table.column(other))
    else:
        rows = table.to_pylist()
        for row in rows:
            row[column] = None
        table = pa.Table.from_pylist(rows)
    buffer = io.BytesIO()
    kind = random.choice(("zstd", "snappy", "gzip", "none", "brotli"))
    pq.write_table(table, buffer, compression=kind, write_page_checksum=random.random() < 0.5)
    draft.files[CATALOG] = buffer.getvalue()
    return f"catalog, {column}, way {way}"


_FOLDER_WAYS: tuple[tuple[Way, int], ...] = (
    (_json, 36), (_values, 18), (_index, 9), (_bytes, 12), (_pictures, 10), (_files, 12),
    (_catalog, 3),
)  # fmt: skip


def _folder(draft: Draft, random: Random) -> str:
    ways, weights = zip(*_FOLDER_WAYS, strict=True)
    if CATALOG in draft.files and random.random() < 0.15:
        return _catalog(draft, random)
    return str(random.choices(ways, weights)[0](draft, random))


def _zip(draft: Draft, random: Random) -> str:
    if random.random() < 0.1:
        draft.files[""] = spoil_bytes(draft.data(""), random)
        return "bytes of the zip"
    if random.random() < 0.6:
        draft.files[""], done = spoil_zip(draft.data(""), random)
        return done
    try:
        inner = Draft(draft.store, dict(unzipped(draft.data(""))))
    except Exception:  # noqa: BLE001  # it was spoiled before
        return "nothing"
    done = _folder(inner, random)
    draft.files[""] = as_zip({path: inner.data(path) for path in inner.paths()})
    return f"in the zip: {done}"


def spoiled(stores: Sequence[Store], seed: int, number: int) -> Draft:
    """Return the spoiled store of a number."""
    random = Random(f"{seed} {number}")  # noqa: S311  # the same every time is what it is for
    store = random.choice(stores)
    draft = Draft(store, dict(store.files))
    for _ in range(random.choice((1, 1, 1, 1, 2, 3))):
        draft.done.append((_zip if draft.is_zip else _folder)(draft, random))
    return draft
