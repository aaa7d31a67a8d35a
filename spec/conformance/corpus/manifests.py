"""Datasets with a manifest: as it should be, and with one thing wrong."""

import hashlib
import json
from collections.abc import Callable, Iterator
from typing import Any

from corpus.case import Case, Finding
from corpus.datasets import EGG, RICE, dataset, place
from corpus.draft import dumps

__all__ = ["manifest_cases", "valid_manifest"]

NAME = "manifest.json"
HEAD = "dataset.json"
OTHER = "018f0000-0000-7000-8000-0000000000c3"


def _manifest(files: dict[str, bytes]) -> dict[str, Any]:
    """Return the manifest of a dataset's files."""
    listed = [
        {"path": path, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
        for path, data in sorted(files.items())
    ]
    episodes = [
        {"id": episode_id, "path": place(episode_id), "digest": _digest(files, place(episode_id))}
        for episode_id in (EGG, RICE)
    ]
    return {"format": "exumi-manifest", "version": "1.0", "files": listed, "episodes": episodes}


def _digest(files: dict[str, bytes], episode: str) -> str:
    state = hashlib.sha256()
    for path, data in sorted(files.items()):
        if path.startswith(f"{episode}/"):
            inner = path.removeprefix(f"{episode}/")
            state.update(f"{hashlib.sha256(data).hexdigest()} {len(data)} {inner}\n".encode())
    return state.hexdigest()


def valid_manifest() -> Case:
    """Return a release: version, preview, manifest, and a hidden file that it need not list."""
    name, about = "dataset__manifest", "A released dataset, with its preview."
    case = dataset(name, about, release={"version": "1.10.0", "previous": "1.9.3"})
    copies = dataset(name, about).files.items()
    case.files.update({f"preview/{path}": data for path, data in copies})
    case.files[NAME] = dumps(_manifest(case.files))
    case.files[".note"] = b"not for anybody\n"
    return case


def _with(
    name: str,
    about: str,
    change: Callable[[dict[str, Any], dict[str, bytes]], object],
    *findings: Finding,
) -> Case:
    """Make a case: `change` gets the manifest and the files, and spoils one of them."""
    case = dataset(name, about, *findings)
    manifest = _manifest(case.files)
    change(manifest, case.files)
    case.files[NAME] = dumps(manifest)
    return case


def _entry(manifest: dict[str, Any], path: str) -> dict[str, Any]:
    found: dict[str, Any] = next(entry for entry in manifest["files"] if entry["path"] == path)
    return found


def _crushed(files: dict[str, bytes]) -> None:
    """Change a byte and no size."""
    head = json.loads(files[HEAD])
    files[HEAD] = dumps({**head, "name": head["name"].swapcase()})


def manifest_cases() -> Iterator[Case]:
    """Yield the cases of manifests."""
    gone = {"path": "README.md", "bytes": 3, "sha256": "0" * 64}
    about = "A listed file that is not there."
    at = Finding("MAN-001", NAME)
    yield _with("MAN-001__no_readme", about, lambda m, _: m["files"].append(gone), at)
    about = "A file that is not listed."
    at = Finding("MAN-002", NAME)
    yield _with("MAN-002__notes", about, lambda _, f: f.update({"notes.txt": b"hi\n"}), at)
    about = "A file that has grown."
    at = Finding("MAN-003", HEAD)
    yield _with(
        "MAN-003__longer", about, lambda _, f: f.update({HEAD: f[HEAD].replace(b"\n", b" \n")}), at
    )
    at = Finding("MAN-004", HEAD)
    yield _with("MAN-004__other_name", "Another name.", lambda _, f: _crushed(f), at)
    entry = {"id": OTHER, "path": place(OTHER), "digest": "0" * 64}
    about = "An episode that is not there."
    at = Finding("MAN-005", NAME, "/episodes/2/path")
    yield _with("MAN-005__ghost", about, lambda m, _: m["episodes"].append(entry), at)
    at = Finding("MAN-005", NAME, "/episodes/0/id")
    about = "An episode under another id."
    yield _with("MAN-005__other_id", about, lambda m, _: m["episodes"][0].update(id=OTHER), at)
    at = Finding("MAN-005", NAME)
    about = "An episode that is not listed."
    yield _with("MAN-005__not_listed", about, lambda m, _: m["episodes"].pop(), at)
    at = Finding("MAN-006", NAME, "/episodes/1/digest")
    about = "Another digest of an episode."
    yield _with("MAN-006__digest", about, lambda m, _: m["episodes"][1].update(digest="0" * 64), at)
    away = {"path": "../../secret.txt", "bytes": 3, "sha256": "0" * 64}
    found = (Finding("MAN-007", NAME, "/files/16/path"), Finding("MAN-001", NAME))
    about = "A path that leads out."
    yield _with("MAN-007__parent_folder", about, lambda m, _: m["files"].append(away), *found)
    at = Finding("MAN-007", NAME, "/files/16/path")
    about = "A file that is listed twice."
    yield _with("MAN-007__twice", about, lambda m, _: m["files"].append(_entry(m, HEAD)), at)
    at = Finding("META-001", NAME, "/files/0/sha256")
    about = "A file without its digest."
    yield _with("META-001__no_sha256", about, lambda m, _: m["files"][0].pop("sha256"), at)
    at = Finding("DOC-003", NAME, "/format")
    about = "A manifest of something else."
    yield _with("DOC-003__manifest", about, lambda m, _: m.update(format="manifest"), at)
