"""What an import costs."""

import subprocess
import sys

# Names of the third-party modules that an import brings along, seen from a bare interpreter.
PROBE = """
import sys
before = set(sys.modules)
import {names}
roots = {{name.partition(".")[0] for name in set(sys.modules) - before}}
others = roots - sys.stdlib_module_names
print(*sorted(name for name in others if not name.startswith("_sysconfigdata")))
"""

PYDANTIC = {
    "annotated_types",
    "pydantic",
    "pydantic_core",
    "typing_extensions",
    "typing_inspection",
}
FIVE = ("exumi_data", "exumi_converters", "exumi_validators", "exumi_loaders", "exumi_recorders")


def loaded_by(*names: str) -> set[str]:
    code = PROBE.format(names=", ".join(names))
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return set(done.stdout.split())


def test_the_core_loads_numpy_and_pydantic_only() -> None:
    assert loaded_by("exumi_data") <= {"exumi_data", "numpy", *PYDANTIC}


def test_the_five_packages_load_without_torch() -> None:
    loaded = loaded_by(*FIVE)
    assert set(FIVE) <= loaded
    assert "torch" not in loaded


def test_converting_and_validating_begin_without_scipy() -> None:
    """It takes as long as all the rest, and few episodes need it."""
    loaded = loaded_by("exumi_converters.conversion", "exumi_validators.validation")
    assert "scipy" not in loaded


def test_the_probe_sees_a_heavy_import() -> None:
    assert "zarr" in loaded_by("zarr")
