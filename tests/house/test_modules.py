"""What every module has."""

import ast
from pathlib import Path

FORBIDDEN = {"_pickle", "cloudpickle", "dill", "joblib", "marshal", "pickle", "shelve"}


def unsafe_uses(source: str) -> list[str]:
    """Places in a program that can run a stranger's code by reading a stranger's data."""
    found = []
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        elif isinstance(node, ast.Call):
            names = [
                word.arg
                for word in node.keywords
                if word.arg == "allow_pickle" and ast.unparse(word.value) != "False"
            ]
        if any(name == "allow_pickle" or name.partition(".")[0] in FORBIDDEN for name in names):
            found.append(ast.unparse(node))
    return found


def test_no_pickle_in_any_form(modules: dict[str, Path]) -> None:
    found = {name: unsafe_uses(path.read_text("utf-8")) for name, path in modules.items()}
    assert len(found) > len({name.partition(".")[0] for name in found}) == 5
    assert {name: uses for name, uses in found.items() if uses} == {}


def test_pickle_is_found_where_it_is() -> None:
    planted = (
        "import pickle",
        "from pickle import loads",
        "import torch, shelve",
        "np.load(path, allow_pickle=True)",
        "np.load(path, allow_pickle=trusted)",
    )
    assert [line for line in planted if not unsafe_uses(line)] == []
    assert unsafe_uses("np.load(path, allow_pickle=False)") == []


def has_all(path: Path) -> bool:
    tree = ast.parse(path.read_text("utf-8"))
    targets: list[ast.expr] = []
    for node in tree.body:
        if isinstance(node, ast.Assign):
            targets += node.targets
        elif isinstance(node, ast.AnnAssign):
            targets.append(node.target)
    return any(isinstance(t, ast.Name) and t.id == "__all__" for t in targets)


def test_every_public_module_has_all(modules: dict[str, Path]) -> None:
    public = {
        name: path
        for name, path in modules.items()
        if not any(part.startswith("_") for part in name.split("."))
    }
    assert public
    assert [name for name, path in public.items() if not has_all(path)] == []


def test_every_package_is_marked_as_typed(package: Path) -> None:
    assert (package / "py.typed").is_file()
    assert (package / "__init__.py").is_file()
