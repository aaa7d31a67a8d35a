"""What must not be in the project's files."""

import re
import subprocess
from pathlib import Path

import pytest

# Folders of one machine, wherever they are written: a user has none of them.
MACHINE_PATH = re.compile(r"(?<![\w.~}])/(?:work|farm|root|home|Users|tmp/venv|opt/\w+)/")
# Where packages come from is the user's choice, not the project's.
PACKAGE_HOST = re.compile(r"find[-_]links|index-url|PIP_\w*INDEX_URL", re.IGNORECASE)
MAY_NAME_A_HOST = {".github/workflows/ci.yml", "CONTRIBUTING.md"}  # PyTorch's own, for CPU builds
# Nothing outside the checkout is needed; CI alone looks for recordings beside it.
OUTSIDE = re.compile(r"\.\./shared")
MAY_LOOK_OUTSIDE = {".ci/run"}
THIS_FILE = "tests/house/test_hygiene.py"


@pytest.fixture(scope="module")
def texts(root: Path) -> dict[str, str]:
    """The text files of the project that git tracks or would track, by path."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    done = subprocess.run(command, cwd=root, check=False, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("not a git checkout: which files are the project's is not known")
    found = {}
    for name in filter(None, done.stdout.split("\0")):
        content = (root / name).read_bytes() if (root / name).is_file() else b"\0"
        if b"\0" not in content and name != THIS_FILE:
            found[name] = content.decode("utf-8", errors="replace")
    return found


def lines_with(pattern: re.Pattern[str], texts: dict[str, str], *, allowed: set[str]) -> list[str]:
    return [
        f"{name}:{number}: {line.strip()}"
        for name, text in texts.items()
        if name not in allowed
        for number, line in enumerate(text.splitlines(), start=1)
        if pattern.search(line)
    ]


def test_the_files_are_found(texts: dict[str, str]) -> None:
    assert {"pyproject.toml", "Makefile", ".ci/run"} <= set(texts)


def test_no_path_of_one_machine(texts: dict[str, str]) -> None:
    assert lines_with(MACHINE_PATH, texts, allowed=set()) == []


def test_no_host_or_folder_of_packages(texts: dict[str, str]) -> None:
    assert lines_with(PACKAGE_HOST, texts, allowed=MAY_NAME_A_HOST) == []


def test_nothing_outside_the_checkout(texts: dict[str, str]) -> None:
    assert lines_with(OUTSIDE, texts, allowed=MAY_LOOK_OUTSIDE) == []


@pytest.mark.parametrize(
    ("pattern", "line"),
    [
        (MACHINE_PATH, "open('/home/me/data')"),
        (MACHINE_PATH, f"see /{'root'}/x"),
        (PACKAGE_HOST, "pip install --extra-index-url http://host/simple"),
        (PACKAGE_HOST, "PIP_FIND_LINKS=wheels"),
        (OUTSIDE, "cp ../shared/data ."),
    ],
)
def test_it_is_found_where_it_is(pattern: re.Pattern[str], line: str) -> None:
    assert lines_with(pattern, {"a.py": f"first\n{line}\n"}, allowed=set()) == [f"a.py:2: {line}"]
