"""What an episode could not say is refused before anything is opened, all of it at once."""

import pytest

from exumi_data.errors import UsageError
from exumi_recorders.session.labels import TouchLabels
from exumi_recorders.session.plan import Plan, check_plan


def test_what_can_be_said() -> None:
    labels = TouchLabels("Tasse für Öl", "Henkel 😀 1", "press", "plain")
    check_plan(Plan(task="öffne das Glas 😀", instruction="two\nlines", labels=labels, operator=""))


def test_the_licence_is_one_that_spdx_knows() -> None:
    check_plan(Plan(task="press", licence="noassertion"))
    with pytest.raises(UsageError, match="--licence: 'bogus' is no SPDX licence expression"):
        check_plan(Plan(task="press", licence="bogus"))


def test_all_that_is_wrong_is_said_at_once() -> None:
    labels = TouchLabels("a" * 300, "b" * 300, "pr\ness")
    plan = Plan(task="", instruction="\udcff", labels=labels, licence=" ", site="\udcff")
    with pytest.raises(UsageError) as caught:
        check_plan(plan)
    said = str(caught.value).split("; ")
    assert [one.split()[0].rstrip(":") for one in said] == [
        "--instruction",
        "--site",
        "--task",
        "--object",
        "--part",
        "--procedure",
        "--licence",
    ]
    assert "UTF-8" in said[0]
    assert "one line of 1 to 255 characters" in said[2]
