"""Checks and stream kinds of other packages: found, checked, and refused with a clear message."""

import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from exumi_data.cli.failures import stop_on_signals
from exumi_data.errors import UsageError
from exumi_data.extensions import stream_kind_plugins
from exumi_data.stopping import Stopped
from exumi_validators import read_config, validate
from exumi_validators.plugins import installed
from exumi_validators.testing import check_checks
from tests.exumi_data.builders import write_dataset

RULE = """
from exumi_data.standard import Rule
from exumi_validators.findings import problem
from exumi_validators.registry import check

RULE = Rule(
    id="{code}", level="{level}", severity="warning", title="t", message="{{path}} is {{found}}",
    suggestion="s", anchor="{anchor}", since="1", limits={{"most": 1.0}},
)

@check(RULE, scope="{scope}")
def judge({context}):
    {body}
"""

Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install packages in a folder of their own; forget them afterwards."""
    folder = tmp_path / "installed"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    made: list[str] = []

    def add(package: str, source: str, group: str = "exumi.checks", name: str = "") -> None:
        module = package.replace("-", "_")
        made.append(module)
        (folder / f"{module}.py").write_text(source)
        info = folder / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        value = f"{module}:KIND" if group == "exumi.stream_kinds" else module
        (info / "entry_points.txt").write_text(f"[{group}]\n{name or package} = {value}\n")
        forget()

    def forget() -> None:
        installed.cache_clear()
        stream_kind_plugins.cache_clear()

    yield add
    forget()
    for module in made:
        sys.modules.pop(module, None)


def source(
    body: str = "yield problem(RULE, 'zarr.json', found=1)",
    *,
    code: str = "acme:X-001",
    level: str = "document",
    scope: str = "episode",
    anchor: str = "https://acme.example/x",
) -> str:
    return RULE.format(body=body, code=code, level=level, scope=scope, anchor=anchor, context=scope)


def test_nothing_is_installed_here() -> None:
    assert installed().extensions == ()
    assert installed().rules == {}


def test_a_check_takes_part(install: Install, good: Path) -> None:
    install("acme-checks", source())
    before = validate(good, levels=["hierarchy"])
    assert before.codes() == {}
    assert [item.distribution for item in before.extensions] == ["acme-checks"]
    report = validate(good)
    (found,) = report.problems
    assert (found.code, found.severity, found.rule) == (
        "acme:X-001",
        "warning",
        "https://acme.example/x",
    )
    assert found.message == "zarr.json is 1"
    assert report.conformant
    assert "with the checks acme-checks of acme-checks 1.0" in report.to_text()
    assert "acme:X-001" in report.to_sarif()
    assert "acme:X-001 t (warning)" in report.to_junit()


def test_a_broken_rule_of_a_third_party_is_no_matter_of_the_standard(
    install: Install, good: Path
) -> None:
    install("acme-checks", source().replace('"warning"', '"error"'))
    report = validate(good)
    assert (report.valid, report.conformant) == (False, True)


def test_checks_run_in_other_processes_and_on_datasets(install: Install, tmp_path: Path) -> None:
    install("acme-episodes", source("yield problem(RULE, '.', found=episode.limit(RULE, 'most'))"))
    found_by = "[len(dataset.episodes), dataset.limit(RULE, 'most')]"
    body = f"yield problem(RULE, '.', found={found_by})"
    install("acme-datasets", source(body, code="acme:D-001", scope="dataset"))
    dataset = write_dataset(tmp_path / "dataset", 8)
    file = tmp_path / "exumi.toml"
    changed = (f'"acme:{name}-001" = {{limits = {{most = 5}}}}' for name in "XD")
    file.write_text("\n".join(("[validate.rules]", *changed)))
    report = validate(dataset, levels=["document"], config=read_config(file), workers=2)
    assert report.coverage.unchecked == ()
    found = Counter((p.code, p.found) for p in report.problems if p.code.startswith("acme:"))
    assert found == {("acme:X-001", "5.0"): 8, ("acme:D-001", "[8, 5.0]"): 1}


def test_a_check_that_fails_is_not_a_pass(install: Install, good: Path) -> None:
    install("acme-checks", source("yield 1 / 0"))
    report = validate(good)
    assert not report.valid
    (unchecked,) = report.coverage.unchecked
    assert (unchecked.what, unchecked.reason) == (
        "acme:X-001",
        "ZeroDivisionError: division by zero",
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import nothing_like_it", "acme-checks 1.0 cannot be loaded: ModuleNotFoundError"),
        ("raise RuntimeError('no')", "cannot be loaded: RuntimeError: no"),
        ("", "there are none"),
        (source(code="X-001"), r"the rule id 'X-001' is not like vendor:NAME-001"),
        (source(anchor="rules.md"), "the anchor of acme:X-001 is 'rules.md', not an address"),
        (
            source().replace("check(RULE", "check('TIME-001'"),
            "judge judges TIME-001 of the standard",
        ),
    ],
)
def test_what_cannot_be_used_is_refused(
    text: str, message: str, install: Install, good: Path
) -> None:
    install("acme-checks", text)
    with pytest.raises(UsageError, match=message):
        validate(good)


def test_two_packages_with_one_rule_are_both_named(install: Install, good: Path) -> None:
    install("acme-one", source())
    install("acme-two", source())
    with pytest.raises(
        UsageError, match=r"acme:X-001 is registered twice: by acme-one .* acme-two"
    ):
        validate(good)


def test_two_packages_with_one_name_are_both_named(install: Install, good: Path) -> None:
    install("acme-one", source(), name="acme")
    install("acme-two", source(code="acme:Y-001"), name="acme")
    with pytest.raises(UsageError, match=r"'acme' is registered twice: by acme-one .* acme-two"):
        validate(good)


KIND = """
from exumi_data.extensions import StreamKind
from exumi_data.standard import ArraySpec

KIND = StreamKind(
    name="acme:smell", version="{version}", schema_url="https://acme.example/smell.json", text="x",
    arrays=(ArraySpec(
        name="data", dtype=("{dtype}",), shape=("N",), dimensions=("{axis}",), required=True,
        text="x",
    ),),
)
"""


def kind(version: str = "1", dtype: str = "float64", axis: str = "time") -> str:
    return KIND.format(version=version, dtype=dtype, axis=axis)


@pytest.mark.parametrize(
    ("text", "codes", "skipped"),
    [
        (kind(), {}, 0),
        (kind(dtype="float32"), {"ARR-002": 1}, 0),
        (kind(version="2", dtype="float32"), {}, 1),
    ],
)
def test_a_kind_is_judged_as_it_is_described(
    text: str, codes: dict[str, int], skipped: int, install: Install, good: Path
) -> None:
    install("acme-smell", text, "exumi.stream_kinds", "acme:smell")
    report = validate(good)
    assert report.codes() == codes
    assert sum(item.code == "META-002" for item in report.coverage.skipped) == skipped


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        (kind(), "acme:scent", "'acme:scent': does not bear that name, but 'acme:smell'"),
        (kind(axis="row"), "acme:smell", "has no first axis, or one that is not named time"),
        (kind(dtype="text"), "acme:smell", "has a data type that episodes have not"),
        ("KIND = 3", "acme:smell", "is int, not a StreamKind"),
    ],
)
def test_a_wrong_description_is_refused(
    text: str, name: str, message: str, install: Install, good: Path
) -> None:
    install("acme-smell", text, "exumi.stream_kinds", name)
    with pytest.raises(UsageError, match=message):
        validate(good)


def test_the_contract_of_checks_finds_what_is_wrong(install: Install, good: Path) -> None:
    install("acme-checks", source())
    import acme_checks  # type: ignore[import-not-found]  # written a moment ago

    with pytest.raises(AssertionError, match="in what is said to be good"):
        check_checks(acme_checks, good=[good], bad={good: {"acme:X-001": 1}})
    with pytest.raises(AssertionError, match="does it ever speak"):
        check_checks(acme_checks, good=[good], bad={})
    with pytest.raises(AssertionError, match=r"found \{'acme:X-001': 1\}, expected \{"):
        check_checks(acme_checks, good=[], bad={good: {"acme:X-001": 2}})


def test_a_check_that_ends_its_process_is_not_a_pass(install: Install, good: Path) -> None:
    install("acme-checks", source("yield exit(3)"))
    (unchecked,) = validate(good).coverage.unchecked
    assert unchecked.what == "acme:X-001"


@pytest.mark.parametrize("scope", ["episode", "dataset"])
def test_a_signal_ends_the_program_also_within_a_check(
    install: Install, tmp_path: Path, scope: str
) -> None:
    body = "import os, signal, time; os.kill(os.getpid(), signal.SIGTERM); yield time.sleep(9)"
    install("acme-checks", source(body, scope=scope))
    dataset = write_dataset(tmp_path / "dataset", 1)
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        stop_on_signals()
        with pytest.raises(Stopped) as caught:
            validate(dataset, levels=["document"], workers=1)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert caught.value.code == 128 + signal.SIGTERM
