"""Every rule stands in the text, is judged by a check, and has a case: all three, or none."""

import json
import re
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path
from string import Formatter
from typing import Any

import pytest

from exumi_data.standard import rules
from exumi_validators.episode_run import archive_checks, episode_checks, root_checks
from exumi_validators.registry import Check
from exumi_validators.validation import dataset_checks

SPEC = Path(__file__).resolve().parents[2] / "spec"
ANCHOR = re.compile(r'<a id="([A-Z]+-\d{3})"></a>')
PAGES = ("episode.md", "dataset.md", "quality.md")


def in_text() -> list[str]:
    return [code for page in PAGES for code in ANCHOR.findall((SPEC / "1.0" / page).read_text())]


def in_checks() -> dict[str, list[str]]:
    """Rules judged, by what is judged: each of these must judge a rule once at most."""
    targets: dict[str, tuple[tuple[Check[Any], ...], ...]] = {
        "episode": (root_checks(), episode_checks()),
        "archive": (archive_checks(),),
        "dataset": (dataset_checks(),),
    }
    return {
        target: [code for checks in groups for check in checks for code in check.rules]
        for target, groups in targets.items()
    }


def in_corpus() -> set[str]:
    """Rules that a case of their own name breaks."""
    found = set()
    for path in (SPEC / "conformance" / "1.0" / "invalid").glob("*/expected.json"):
        codes = {finding["code"] for finding in json.loads(path.read_bytes())["findings"]}
        found |= codes & {path.parent.name.partition("__")[0]}
    return found


def gaps(
    table: Collection[str],
    text: Collection[str],
    checks: Mapping[str, Collection[str]],
    corpus: Collection[str],
) -> list[str]:
    """What is missing, superfluous or there twice, each as one line."""
    found = []
    judged = {code for codes in checks.values() for code in codes}
    for where, codes in (("text", text), ("checks", judged), ("corpus", corpus)):
        found += [f"{code} is not in the {where}" for code in sorted(set(table) - set(codes))]
        found += [f"{code} of the {where} is no rule" for code in sorted(set(codes) - set(table))]
    for where, several in (("text", text), *checks.items()):
        found += [f"{code} is twice in {where}" for code, n in Counter(several).items() if n > 1]
    return found


def test_text_checks_and_corpus_have_the_same_rules() -> None:
    assert len(rules()) > 100
    assert gaps(list(rules()), in_text(), in_checks(), in_corpus()) == []


@pytest.mark.parametrize(
    ("text", "checks", "corpus", "message"),
    [
        (["A-001"], ["A-001", "A-002"], ["A-001", "A-002"], "A-002 is not in the text"),
        (["A-001", "A-002"], ["A-002"], ["A-001", "A-002"], "A-001 is not in the checks"),
        (["A-001", "A-002"], ["A-001", "A-002"], ["A-002"], "A-001 is not in the corpus"),
        (["A-001", "A-002"], ["A-001", "A-002", "A-001"], ["A-001", "A-002"], "A-001 is twice"),
        (["A-001", "A-002", "B-001"], ["A-001", "A-002"], ["A-001", "A-002"], "B-001 of the text"),
    ],
)
def test_a_gap_is_found(
    text: list[str], checks: list[str], corpus: list[str], message: str
) -> None:
    (found,) = gaps(["A-001", "A-002"], text, {"episode": checks}, corpus)
    assert message in found


@pytest.mark.parametrize("rule", rules().values(), ids=lambda rule: rule.id)
def test_words_of_a_rule_can_be_filled_in(rule: Any) -> None:
    """A title and a suggestion are said as they are; a message has fields that checks fill in."""
    for text in (rule.title, rule.suggestion):
        assert [field for _, field, _, _ in Formatter().parse(text) if field is not None] == []
    fields = [field for _, field, _, _ in Formatter().parse(rule.message) if field is not None]
    assert all(re.fullmatch(r"[a-z_]+", field) for field in fields), fields
    for name, value in rule.limits.items():
        assert re.fullmatch(r"[a-z][a-z0-9_]*", name)
        assert isinstance(value, int | float)


def test_the_corpus_has_the_features_that_the_standard_names() -> None:
    """Valid cases name the feature they are there for."""
    names = {path.name for path in (SPEC / "conformance" / "1.0" / "valid").iterdir()}
    assert len(names) >= 35
    features = {name.partition("__")[0] for name in names}
    assert features >= {
        "arrays", "audio", "calibration", "dataset", "derived", "extension", "images", "packed",
        "pose", "source", "streams", "tactile", "taxels", "time", "version", "width", "wrench",
    }  # fmt: skip
    encodings: set[str] = set()
    kinds: set[str] = set()
    for root in (SPEC / "conformance" / "1.0" / "valid").glob("*/store.zarr/zarr.json"):
        streams = json.loads(root.read_bytes())["attributes"]["exumi"]["streams"].values()
        kinds |= {stream["kind"] for stream in streams}
        encodings |= {stream["images"]["encoding"] for stream in streams if "images" in stream}
    assert encodings == {"array", "encoded", "video"}
    assert kinds >= {
        "rgb",
        "tactile",
        "pose",
        "width",
        "wrench",
        "taxels",
        "audio",
        "acme:motor-current",
    }
