"""What every test gets: real data where there is some, and a cache folder of its own."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Tests run side by side, and have the cores to themselves; libraries ask when they are imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Each of the many programs that the tests start would compile the project anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# The same examples on every run (a failure is the change's own), and no time limit for one of them
# (how fast a test runs says nothing on a shared machine).
settings.register_profile("exumi", derandomize=True, deadline=None)
settings.load_profile("exumi")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder with recordings of real sensors, which are not part of the project."""
    folder = os.environ.get("EXUMI_REAL_DATA")
    if not folder:
        pytest.skip("EXUMI_REAL_DATA is not set: it names a folder of real recordings")
    path = Path(folder)
    if not path.is_dir():
        pytest.fail(f"EXUMI_REAL_DATA names {folder}, which is not a folder")
    return path


@pytest.fixture(autouse=True, scope="session")
def _own_cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests, and the programs that they start, leave the user's cache folder alone."""
    with pytest.MonkeyPatch.context() as patch:
        folder = str(tmp_path_factory.mktemp("cache"))
        patch.setenv("EXUMI_CACHE", folder)
        patch.setenv("XDG_CACHE_HOME", folder)
        yield
