"""Rules judged in another way: what is read, what it does, and what the report says of it."""

import re
from pathlib import Path

import pytest

from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.standard import LEVELS
from exumi_validators import Problem, find_config, read_config, validate
from exumi_validators.findings import Collector, problem
from tests.exumi_data.builders import edit_metadata

ROOT = Path(__file__).parents[2]


def written(folder: Path, text: str, name: str = "exumi.toml") -> Path:
    file = folder / name
    file.write_text(text)
    return file


@pytest.fixture
def spoiled(episode: Path) -> Path:
    """An episode with one error (an unknown key) and one warning (a licence in prose)."""
    edit_metadata(episode, lambda exumi: exumi.update(colour="red", licence="free for research"))
    return episode


def test_a_rule_of_another_severity(spoiled: Path, tmp_path: Path) -> None:
    config = read_config(written(tmp_path, '[validate.rules]\n"META-003" = "info"\n'))
    report = validate(spoiled, config=config)
    assert {p.code: p.severity for p in report.problems} == {
        "META-003": "info",
        "LIC-002": "warning",
    }
    assert (report.valid, report.exit_code) == (True, 0)
    assert report.conformant is False
    text = report.to_text()
    assert "valid as configured (1 warning)" in text.splitlines()[0]
    assert "META-003: info (standard: error)" in text
    assert "does NOT conform to exUMI 1.0" in text


def test_a_stricter_rule_makes_conforming_data_invalid(spoiled: Path, tmp_path: Path) -> None:
    edit_metadata(spoiled, lambda exumi: exumi.pop("colour"))
    config = read_config(written(tmp_path, '[validate.rules]\n"LIC-002" = "error"\n'))
    report = validate(spoiled, config=config)
    assert (report.valid, report.conformant) == (False, True)
    assert "by the standard's own rules it conforms" in report.to_text()
    assert validate(spoiled).to_dict()["configuration"] is None


def test_what_is_off_or_suppressed_stays_listed(spoiled: Path, tmp_path: Path) -> None:
    text = """
    [validate.rules]
    "LIC-002" = "off"
    [[validate.suppress]]
    rule = "META-003"
    path = "zarr.*"
    reason = "an old writer"
    """
    file = written(tmp_path, text)
    report = validate(spoiled, config=read_config(file))
    assert {p.code: p.suppressed for p in report.suppressed} == {
        "META-003": "an old writer",
        "LIC-002": f"switched off in {file}",
    }
    assert (report.valid, report.conformant, report.codes()) == (True, False, {})
    assert report.to_dict()["counts"] == {"error": 0, "warning": 0, "info": 0, "suppressed": 2}
    for verbose in (False, True):
        shown = report.to_text(verbose=verbose)
        assert "suppressed, listed but not counted:" in shown
        assert "an old writer" in shown


def test_a_pattern_that_covers_something_else(spoiled: Path, tmp_path: Path) -> None:
    text = '[[validate.suppress]]\nrule = "META-003"\npath = "episodes/*"\nreason = "x"\n'
    report = validate(spoiled, config=read_config(written(tmp_path, text)))
    assert report.suppressed == ()
    assert not report.valid


def test_a_suppression_in_vain_is_said(spoiled: Path, tmp_path: Path) -> None:
    asked = (("META-003", "zarr.*"), ("LIC-002", "episodes/*"), ("META-003", "*"), ("IMG-007", "*"))
    text = "".join(
        f'[[validate.suppress]]\nrule = "{rule}"\npath = "{path}"\nreason = "x"\n'
        for rule, path in asked
    )
    config = read_config(written(tmp_path, text))
    report = validate(spoiled, config=config, levels=["document"])
    assert report.configuration is not None
    # The third covers what the first covers already; frames were not looked at.
    unused = [item.unused for item in report.configuration.suppress]
    assert unused == [False, True, True, False]
    assert "LIC-002 at episodes/* has nothing to suppress: x" in report.to_text()
    assert "META-003 at zarr.* suppressed: x" in report.to_text()
    written_out = report.to_dict()["configuration"]["suppress"]
    assert [item["unused"] for item in written_out] == unused
    assert not any(item.unused for item in config.configuration.suppress)


def test_a_suppression_of_more_than_is_listed_is_not_called_vain(tmp_path: Path) -> None:
    text = '[[validate.suppress]]\nrule = "TIME-001"\npath = "streams/b/*"\nreason = "known"\n'
    config = read_config(written(tmp_path, text))
    for not_listed, unused in (((), True), (("TIME-001",), False)):
        (item,) = config.told([], not_listed, LEVELS).suppress
        assert item.unused is unused


def test_suppressed_findings_do_not_push_others_out_of_the_list(tmp_path: Path) -> None:
    text = '[[validate.suppress]]\nrule = "TIME-001"\npath = "streams/a/*"\nreason = "known"\n'
    config = read_config(written(tmp_path, text))
    collector = Collector(config.revised)
    for index in range(150):
        collector.add(problem("TIME-001", "streams/a/time", index=index))
    collector.add(problem("TIME-001", "streams/b/time", index=7))
    counted = [p for p in collector.problems if p.suppressed is None]
    assert [p.location.path for p in counted] == ["streams/b/time"]
    assert len(collector.problems) == 101
    assert collector.suppressed_not_listed == {"TIME-001": 50}
    assert collector.not_listed == {}


def test_a_pattern_names_an_episode_of_a_dataset(tmp_path: Path) -> None:
    text = '[[validate.suppress]]\nrule = "TIME-001"\npath = "episodes/a1/*"\nreason = "known"\n'
    config = read_config(written(tmp_path, text))
    found: Problem = problem("TIME-001", "streams/a/time", index=1)
    assert config.revised(found, "episodes/a1/x.zarr").suppressed == "known"
    assert config.revised(found, "episodes/b2/x.zarr").suppressed is None
    assert config.revised(found).suppressed is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('"TIME-999" = "info"', r"there is no rule TIME-999, but TIME-\d{3}"),
        ('"TIME-001" = "warn"', r"TIME-001\.severity: warn is not error, warning, info or off"),
        ('"TIME-001" = 3', r"rules\.TIME-001: 3 is not a table"),
        ('"TIME-001" = {limits = {speed = 1.0}}', "TIME-001 has no limit speed; it has none"),
        ('"TIME-001" = {limits = {speed = "x"}}', r"limits\.speed: x is not a number"),
        (
            '"TIME-001" = {severty = "info"}',
            "known here: severity, limits, reason",
        ),
        ('[[validate.suppress]]\nrule = "TIME-001"', r"suppress\.0\.reason: is missing"),
        ('[[validate.suppress]]\nrule = "NO-001"\nreason = "x"', "there is no rule NO-001"),
        ("[validat]", "validat: no such key; known here: validate"),
        ('"TIME-001" = {limits = {speed = nan}}', "NaN is not a finite number"),
        ('[validate.suppress]\nrule = "TIME-001"', "is not a list of tables"),
        (
            '[[validate.suppress]]\nrule = "ID-002"\nreason = ""',
            "is not a text that says",
        ),
        ('[[validate.suppress]]\nrule = "ID-002"\nfile = "x"', "known here: rule, path, reason"),
        ("[validate.rulez]", "rulez: no such key; known here: rules, suppress"),
        ("[tool.exumi.validate]", r"\[tool.exumi\] is for a pyproject.toml"),
        ('"TIME-001" = ', "is no TOML"),
        ("x = " + "[" * 100_000, "is no TOML"),
    ],
)
def test_mistakes_are_named(text: str, message: str, tmp_path: Path) -> None:
    file = written(tmp_path, f"[validate.rules]\n{text}\n")
    with pytest.raises(UsageError, match=message) as caught:
        read_config(file)
    assert caught.value.where == str(file)
    assert "pydantic" not in str(caught.value)


def test_the_advice_names_the_tables_as_the_file_has_them(tmp_path: Path) -> None:
    for name, table in (("lab.toml", "[validate"), ("pyproject.toml", "[tool.exumi.validate")):
        file = written(tmp_path, f"{table}.rules]\n'TIME-001' = 'warn'\n", name)
        with pytest.raises(UsageError) as caught:
            read_config(file)
        assert f"Known are {table}.rules]" in str(caught.value.fix)
        assert f"[{table}.suppress]]" in str(caught.value.fix)


def test_a_file_that_is_not_there_or_no_text(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such file"):
        read_config(tmp_path / "lab.toml")
    (tmp_path / "lab.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(UsageError, match="is no TOML"):
        read_config(tmp_path / "lab.toml")


def test_a_misspelt_table_is_not_passed_over(tmp_path: Path) -> None:
    file = written(tmp_path, "[tool.exumi.validat.rules]\n'ID-002' = 'off'\n", "pyproject.toml")
    assert find_config(tmp_path) == file
    with pytest.raises(UsageError, match=r"tool\.exumi\.validat: no such key"):
        read_config(file)


def test_the_nearest_file_counts(tmp_path: Path) -> None:
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    written(tmp_path, "", "exumi.toml")
    assert find_config(inner) == tmp_path / "exumi.toml"
    written(inner, "[tool.other]\n", "pyproject.toml")
    assert find_config(inner) == tmp_path / "exumi.toml"
    ours = written(
        tmp_path / "a", "[tool.exumi.validate.rules]\n'ID-002' = 'off'\n", "pyproject.toml"
    )
    assert find_config(inner) == ours
    assert read_config(ours).configuration.rules[0].code == "ID-002"


def test_data_does_not_say_how_it_is_judged(tmp_path: Path) -> None:
    data = tmp_path / "my-dataset"
    (data / "episodes").mkdir(parents=True)
    written(data, "")
    mine = written(tmp_path, "")
    assert find_config(data / "episodes", data=data) == mine
    assert find_config(data, data=data) == mine
    assert find_config(data) == data / "exumi.toml"
    written(data, "{}", "dataset.json")
    assert find_config(data, data=data / "episodes" / "a1" / "x.zarr") == mine


def test_the_example_of_the_manual_is_right(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "validating.md").read_text("utf-8")
    blocks = re.findall(r"^```toml\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert read_config(written(tmp_path, blocks[0])).configuration.suppress


def test_a_link_that_leads_in_a_circle(tmp_path: Path) -> None:
    loop = tmp_path / "loop"
    loop.symlink_to("loop")
    mine = written(tmp_path, "")
    assert find_config(tmp_path, data=loop) == mine
    with pytest.raises(DamagedDataError, match="is a link"):
        read_config(loop)
