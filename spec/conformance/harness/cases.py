"""The cases of the corpus, as files."""

import fnmatch
import json
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

__all__ = [
    "CORPUS",
    "Case",
    "chosen_cases",
    "chosen_descriptions",
    "chosen_edits",
    "json_at",
    "rules",
]

CORPUS = Path(__file__).resolve().parents[1] / "1.0"
"""The corpus beside this program."""
_RULES = Path(__file__).resolve().parents[2] / "1.0" / "rules.json"


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes
    ----------
    name : str
        ``<side>/<rule or feature>__<defect>``.
    folder : pathlib.Path
    """

    name: str
    folder: Path

    @cached_property
    def expected(self) -> dict[str, Any]:
        """``expected.json``."""
        document: dict[str, Any] = json.loads((self.folder / "expected.json").read_bytes())
        return document

    @property
    def store(self) -> Path:
        """What a program is given."""
        return self.folder / str(self.expected["store"])

    @property
    def dump(self) -> dict[str, Any] | None:
        """``dump.json``: what a reader has to print; None where the case has none."""
        path = self.folder / "dump.json"
        return json.loads(path.read_bytes()) if path.is_file() else None

    @property
    def findings(self) -> list[dict[str, Any]]:
        """What a validator has to find."""
        return list(self.expected["findings"])


def chosen_cases(corpus: Path, *, only: list[str], side: str = "*") -> list[Case]:
    """List the cases of a corpus, in order of their names.

    Parameters
    ----------
    corpus : pathlib.Path
        The folder that holds ``valid`` and ``invalid``.
    only : list of str
        Patterns such as ``TIME-*``, of which a case has to match one; all cases, if there are none.
    side : {"valid", "invalid", "*"}
    """
    folders = sorted(path.parent for path in corpus.glob(f"{side}/*/expected.json"))
    cases = [Case(f"{folder.parent.name}/{folder.name}", folder) for folder in folders]
    return [case for case in cases if not only or any(_matches(case, pat) for pat in only)]


def _matches(case: Case, pattern: str) -> bool:
    return any(fnmatch.fnmatchcase(name, pattern) for name in (case.name, case.folder.name))


def chosen_descriptions(corpus: Path, *, only: list[str]) -> list[Path]:
    """List the folders of the episodes that a writer is to write, in order of their names."""
    return _chosen_folders(corpus, "writing/*/description.json", only)


def chosen_edits(corpus: Path, *, only: list[str]) -> list[Path]:
    """List the folders of the changes that an editor is to make, in order of their names."""
    return _chosen_folders(corpus, "editing/*/edit.json", only)


def _chosen_folders(corpus: Path, pattern: str, only: list[str]) -> list[Path]:
    folders = sorted(path.parent for path in corpus.glob(pattern))
    return [
        folder
        for folder in folders
        if not only or any(fnmatch.fnmatchcase(folder.name, chosen) for chosen in only)
    ]


def rules() -> dict[str, dict[str, Any]]:
    """Return the rule table by id."""
    found: dict[str, dict[str, Any]] = json.loads(_RULES.read_bytes())["rules"]
    return found


def json_at(store: Path, path: str, pointer: str) -> Any:
    """Return a value of a JSON document of a store, folder or zip."""
    if store.is_file():
        with zipfile.ZipFile(store) as archive:
            value: Any = json.loads(archive.read(path))
    else:
        value = json.loads((store / path).read_bytes())
    for part in pointer.split("/")[1:]:
        key = part.replace("~1", "/").replace("~0", "~")
        value = value[int(key)] if isinstance(value, list) else value[key]
    return value
