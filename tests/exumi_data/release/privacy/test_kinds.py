import pytest

from exumi_data.errors import UsageError
from exumi_data.release.privacy import PrivateItem, counted, unresolved
from exumi_data.release.privacy.kinds import shortened

ITEMS = [
    PrivateItem("operator", "a", "zarr.json#/x", "Ada", "who"),
    PrivateItem("operator", "b", "zarr.json#/x", "Ada", "who"),
    PrivateItem("gps", "a", "streams/rgb: x.avi", "48.1, 11.6", "where", removable=False),
]


def test_that_every_kind_is_decided() -> None:
    assert unresolved(ITEMS, [], []) == ITEMS
    assert unresolved(ITEMS, ["gps"], ["operator"]) == []
    assert unresolved(ITEMS, ["operator"], []) == ITEMS[2:]
    assert unresolved(ITEMS, ["operator"], ["gps"]) == ITEMS[2:]  # it cannot be removed


@pytest.mark.parametrize(
    ("keep", "remove", "said"),
    [(["gps"], ["gps"], "both"), (["gsp"], [], "gsp"), ([], ["all"], "operator, site")],
)
def test_a_decision_that_makes_no_sense(keep: list[str], remove: list[str], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        unresolved(ITEMS, keep, remove)


def test_counting_what_says_the_same() -> None:
    assert [len(group) for group in counted(ITEMS).values()] == [2, 1]


def test_a_long_value_on_one_line() -> None:
    text = shortened("x" * 100 + "\n\x1b[2J")
    assert len(text) <= 48
    assert text.isprintable()
