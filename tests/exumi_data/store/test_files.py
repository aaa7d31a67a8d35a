"""Small files that are there whole or not at all."""

from pathlib import Path

import pytest

from exumi_data.store.files import write_atomic


def test_what_cannot_be_written_is_told_by_its_own_name(tmp_path: Path) -> None:
    (tmp_path / "there.json").mkdir()
    with pytest.raises(IsADirectoryError) as caught:
        write_atomic(tmp_path / "there.json", b"{}")
    assert caught.value.filename == str(tmp_path / "there.json")
    with pytest.raises(OSError, match="too long") as long:
        write_atomic(tmp_path / f"{'n' * 300}.json", b"{}")
    assert long.value.filename == str(tmp_path / f"{'n' * 300}.json")
    assert [path.name for path in tmp_path.iterdir()] == ["there.json"]
