"""Groups, arrays and files: names, types, shapes and codecs. No chunk is read."""

import re
from collections.abc import Iterator

from exumi_data.model.description import CalibrationItem
from exumi_data.model.streams import images_of
from exumi_validators.context import CALIBRATION_PATH, ROOT, EpisodeContext
from exumi_validators.expected_shapes import fits, shape_words
from exumi_validators.findings import problem
from exumi_validators.nodes import array_problems, node_mistake
from exumi_validators.registry import check
from exumi_validators.report import Problem

__all__ = [
    "array_documents",
    "attributes",
    "byte_chunks",
    "calibration_arrays",
    "consolidated",
    "data_types",
    "derived_arrays",
    "foreign_files",
    "frame_chunks",
    "groups",
    "layouts",
    "links",
    "listed_arrays",
    "names_of_axes",
    "paths",
    "shapes",
    "unlisted_arrays",
]

_BYTE_CHUNK = 64 << 10
_SHARD = re.compile(r"c/(0|[1-9][0-9]{0,18})((?:/0)*)")


@check("SAFE-001")
def paths(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that names are safe wherever the episode is copied to."""
    for path in episode.listing.unsafe:
        yield problem("SAFE-001", path, found=path)


@check("SAFE-002")
def links(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that there are only files and folders."""
    for path in episode.listing.links:
        yield problem("SAFE-002", path, found=path)


@check("HIER-002")
def groups(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that every group has a document, so that plain readers find what is below."""
    for path in episode.group_paths:
        if f"{path}/zarr.json" not in episode.listing.files:
            yield problem("HIER-002", path)


@check("ZARR-001")
def array_documents(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the documents of groups and arrays are what their place asks for."""
    if episode.root is not None and episode.root.value is not None and episode.document is not None:
        mistake = node_mistake(episode.root.value, "group")
        if mistake is not None:
            yield problem("ZARR-001", ROOT, detail=mistake)
    wanted = dict.fromkeys(episode.group_paths, "group")
    wanted |= dict.fromkeys(episode.expected_arrays, "array")
    for path, node_type in wanted.items():
        loaded = episode.array_document(path)
        # The document of `derived` is judged by the rules for documents.
        if loaded is None or (path == "derived" and loaded.value is None):
            continue
        mistake = loaded.mistake
        if loaded.value is not None:
            mistake = node_mistake(loaded.value, node_type)
        if mistake is None and loaded.duplicates and path != "derived":
            mistake = f"the key {loaded.duplicates[0][-1]} stands twice"
        if mistake is None and node_type == "array" and path not in episode.array_nodes:
            mistake = "`shape` is not a list of sizes, at least one"
        if mistake is not None:
            yield problem("ZARR-001", f"{path}/zarr.json", detail=mistake)


@check("ZARR-006")
def consolidated(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that no group holds a copy of its members' metadata."""
    for path in ("", *episode.group_paths):
        loaded = episode.array_document(path) if path else episode.root
        if loaded and loaded.value and loaded.value.get("consolidated_metadata") is not None:
            yield problem("ZARR-006", loaded.path, pointer=("consolidated_metadata",))


@check("ZARR-007")
def attributes(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that only the root, and ``derived`` for itself, carry metadata."""
    allowed = {"": {"zarr_conventions", "exumi"}, "derived": {"exumi"}}
    for path in ("", *episode.group_paths, *episode.expected_arrays):
        loaded = episode.array_document(path) if path else episode.root
        found = loaded.value.get("attributes") if loaded and loaded.value else None
        if not loaded or found is None:
            continue
        names = set(found) if isinstance(found, dict) else {str(type(found).__name__)}
        extra = {name for name in names - allowed.get(path, set()) if not _is_extension(path, name)}
        if extra:
            yield problem(
                "ZARR-007", loaded.path, pointer=("attributes",), found=", ".join(sorted(extra))
            )


def _is_extension(path: str, name: str) -> bool:
    """Other conventions of Zarr may describe the root beside ours."""
    return path == "" and name != "exumi"


@check("ARR-001")
def listed_arrays(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that every array that a stream lists is there."""
    for path in episode.expected_arrays:
        if path.startswith("streams/") and f"{path}/zarr.json" not in episode.listing.files:
            yield problem("ARR-001", path)


@check("CAL-001")
def calibration_arrays(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that arrays of calibration items are there."""
    for pointer, item in episode.parts(CalibrationItem, "calibration"):
        path = item.array
        if path is None:
            continue
        if not CALIBRATION_PATH.fullmatch(path) or episode.is_missing_calibration(path):
            yield problem("CAL-001", ROOT, pointer=(*pointer, "array"), found=path)


@check("DRV-002")
def derived_arrays(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that derived arrays and their descriptions come together."""
    for key in episode.derived:
        if f"derived/{key}/zarr.json" not in episode.listing.files:
            yield problem("DRV-002", f"derived/{key}", detail="it is described, but not there")
    for key in _undescribed(episode):
        yield problem("DRV-002", f"derived/{key}", detail="it is there, but not described")


def _undescribed(episode: EpisodeContext) -> list[str]:
    """Keys of derived arrays that are there without a description."""
    described = (episode.derived_document or {}).get("items")
    known = described if isinstance(described, dict) else {}
    found = []
    for path in episode.listing.files:
        parts = path.split("/")
        if len(parts) == 4 and parts[0] == "derived" and parts[3] == "zarr.json":
            key = f"{parts[1]}/{parts[2]}"
            if key not in known:
                found.append(key)
    return sorted(found)


@check("ZARR-002", "ZARR-003", "ZARR-004", "ZARR-008", "ZARR-009", "ZARR-010")
def layouts(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge types, codecs, shards and chunks of every array."""
    for node in episode.array_nodes.values():
        yield from array_problems(node)


@check("ZARR-005")
def names_of_axes(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that axes have names, and the first one that of the registry."""
    for path, node in episode.array_nodes.items():
        names = node.document.get("dimension_names")
        spec = episode.expected_arrays[path]
        first = spec.dimensions[0] if spec else None
        is_list = isinstance(names, list) and len(names) == len(node.shape)
        # Zarr also takes null for an axis without a name; the registry's arrays have none.
        is_list = is_list and all(
            isinstance(name, str) or (name is None and spec is None)
            for name in names  # type: ignore[union-attr]  # a list by then
        )
        if first is None and (names is None or is_list):
            continue
        if not is_list or (first is not None and names[0] != first):  # type: ignore[index]  # a list by then
            expected = f"{len(node.shape)} names" + (f", the first is {first}" if first else "")
            pointer = ("dimension_names",)
            yield problem("ZARR-005", node.file, pointer=pointer, expected=expected, found=names)


@check("ARR-002")
def data_types(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge data types by the registry."""
    for path, node in episode.array_nodes.items():
        spec = episode.expected_arrays[path]
        if spec and node.dtype and node.dtype not in spec.dtype:
            expected = " or ".join(spec.dtype)
            pointer = ("data_type",)
            yield problem(
                "ARR-002", node.file, pointer=pointer, expected=expected, found=node.dtype
            )


@check("ARR-003")
def shapes(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge shapes by the registry and the stream's metadata, but for the number of samples."""
    for path, node in episode.array_nodes.items():
        spec = episode.expected_arrays[path]
        if spec is None:
            continue
        stream = episode.stream_of(path)
        if not fits(node.shape, spec, stream):
            expected = shape_words(spec, stream)
            pointer = ("shape",)
            found = list(node.shape)
            yield problem("ARR-003", node.file, pointer=pointer, expected=expected, found=found)


@check("IMG-002")
def frame_chunks(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a frame can be read alone."""
    for name, stream in episode.streams.items():
        images = images_of(stream)
        node = episode.array_nodes.get(f"streams/{name}/data")
        if images is None or images.encoding != "array" or node is None or not node.chunk:
            continue
        if node.chunk[0] != 1:
            pointer = ("codecs", "0", "configuration", "chunk_shape")
            found = node.chunk[0]
            yield problem("IMG-002", node.file, pointer=pointer, expected=1, found=found)


@check("IMG-003")
def byte_chunks(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that stored files can be read in pieces, at their offset."""
    for name, stream in episode.streams.items():
        images = images_of(stream)
        node = episode.array_nodes.get(f"streams/{name}/data")
        if images is None or images.encoding == "array" or node is None or not node.chunk:
            continue
        pointer = ("codecs", "0", "configuration", "chunk_shape")
        wanted = max(1, min(_BYTE_CHUNK, node.shape[0]))
        if node.zstd:
            yield problem("IMG-003", node.file, pointer=pointer, detail="they are compressed")
        elif node.chunk[0] != wanted:
            detail = f"an inner chunk has {node.chunk[0]} bytes, expected {wanted}"
            yield problem("IMG-003", node.file, pointer=pointer, detail=detail)


@check("HIER-003")
def unlisted_arrays(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a stream's folder holds no array that the stream does not list."""
    for path in _unlisted(episode):
        yield problem("HIER-003", path)


def _unlisted(episode: EpisodeContext) -> list[str]:
    found = set()
    for path in episode.listing.files:
        parts = path.split("/")
        is_array = len(parts) == 4 and parts[0] == "streams" and parts[3] == "zarr.json"
        node = path.removesuffix("/zarr.json")
        if is_array and parts[1] in episode.streams and node not in episode.expected_arrays:
            found.add(node)
    return sorted(found)


@check("HIER-001")
def foreign_files(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that every file is metadata or a shard of something that is named."""
    known = {ROOT, *(f"{path}/zarr.json" for path in episode.group_paths)}
    known |= {f"{path}/zarr.json" for path in episode.expected_arrays}
    if episode.load("derived/zarr.json") is not None:
        known.add("derived/zarr.json")
    elsewhere = _judged_elsewhere(episode)
    for path in episode.listing.files:
        if path in known or _is_shard(episode, path):
            continue
        if not any(folder in elsewhere for folder in _folders_of(path)):
            yield problem("HIER-001", path)


def _folders_of(path: str) -> Iterator[str]:
    at = path.find("/")
    while at >= 0:
        yield path[:at]
        at = path.find("/", at + 1)


def _judged_elsewhere(episode: EpisodeContext) -> set[str]:
    """Folders of which another rule speaks: not listed, not described, or not understood."""
    found = [f"streams/{name}" for name in episode.stream_names - set(episode.streams)]
    found += _unlisted(episode)
    found += [f"derived/{key}" for key in _undescribed(episode)]
    found += [f"{path}/c" for path in episode.expected_arrays if path not in episode.array_nodes]
    items = (episode.derived_document or {}).get("items")
    if not isinstance(items, dict) or len(episode.derived) < len(items):
        found.append("derived")
    if "calibration" in (episode.document or {}) and episode.section("calibration") is None:
        found.append("calibration")
    return set(found)


def _is_shard(episode: EpisodeContext, path: str) -> bool:
    array, found, rest = path.partition("/c/")
    node = episode.array_nodes.get(array)
    match = _SHARD.fullmatch(f"c/{rest}") if found else None
    if node is None or match is None:
        return False
    if match[2] != "/0" * (len(node.shape) - 1):
        return False
    # Where the grid is not understood, another rule says so.
    return not node.shard or not node.shard[0] or int(match[1]) < -(-node.shape[0] // node.shard[0])
