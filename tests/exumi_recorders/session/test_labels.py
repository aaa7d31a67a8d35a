"""Labels of touch sessions: ids from words, trials, pads that mix."""

import pytest

from exumi_data.errors import UsageError
from exumi_data.model import Annotations
from exumi_recorders.session.labels import TouchLabels, TrialCounter

HANDLE = TouchLabels("Coffee mug", "Handle 1.2", "slide", "plain")


def test_words_become_ids() -> None:
    said = HANDLE.annotations(3)
    assert said is not None
    assert (said.object, said.object_id) == ("Coffee mug", "coffee-mug")
    assert said.part_id == "coffee-mug/handle-1.2"
    assert (said.procedure, said.pad_type, said.trial) == ("slide", "plain", 3)


@pytest.mark.parametrize(
    ("words", "known"),
    [
        ("杯子", "杯子"),
        ("Tasse für Öl", "tasse-für-öl"),
        ("कप", "कप"),
        ("Ｍｕｇ № 1_b", "mug-no-1-b"),
        ("../etc/\n\x1b[31m", "..-etc-31m"),
    ],
)
def test_words_of_all_languages_become_ids(words: str, known: str) -> None:
    said = TouchLabels(words).annotations(1)
    assert said is not None
    assert (said.object, said.object_id) == (words, known)


def test_nothing_said() -> None:
    assert TouchLabels().annotations(1) is None


def test_only_a_pad() -> None:
    said = TouchLabels(pad_type="dotted").annotations(1)
    assert said is not None
    assert said.model_dump(exclude_unset=True) == {"pad_type": "dotted"}


@pytest.mark.parametrize("labels", [{"part": "handle"}, {"object": "?! 😀"}])
def test_words_that_do_not_do(labels: dict[str, str]) -> None:
    with pytest.raises(UsageError):
        TouchLabels(**labels)  # type: ignore[arg-type]  # only words


def test_trials_go_on_where_the_dataset_ends() -> None:
    earlier = [HANDLE.annotations(1), HANDLE.annotations(2), None]
    counter = TrialCounter(earlier)
    assert counter.next_trial(HANDLE) == 3
    assert counter.next_trial(TouchLabels("coffee MUG", "handle 1.2", "press")) == 1
    counter.add(HANDLE.annotations(3))
    assert counter.next_trial(HANDLE) == 4


def test_a_missing_trial_is_not_given_twice() -> None:
    counter = TrialCounter([HANDLE.annotations(5)])
    assert counter.next_trial(HANDLE) == 6


def test_pads_that_mix() -> None:
    counter = TrialCounter([HANDLE.annotations(1), Annotations(pad_type="plain")])
    assert counter.warning(HANDLE) is None
    said = counter.warning(TouchLabels("Coffee mug", pad_type="dotted"))
    assert said is not None
    assert "2 with plain pads" in said
    assert "dotted" in said
    assert counter.warning(TouchLabels()) is not None
