"""The registry, the models and the writers name the same things."""

from typing import get_args

import pytest

from exumi_data import standard
from exumi_data.model.clock import STAMP_POINTS
from exumi_data.model.images import Images
from exumi_data.model.streams import Stream, StreamModel
from exumi_data.store.zarr_document import DTYPES


def models() -> dict[str, type[StreamModel]]:
    """The models of the kinds of streams, by kind."""
    branches = [get_args(branch)[0] for branch in get_args(get_args(Stream)[0])]
    kinds = {get_args(model.model_fields["kind"].annotation): model for model in branches}
    return {str(kind[0]): model for kind, model in kinds.items() if kind}


def test_core_kinds_are_the_models() -> None:
    core = {kind.name for kind in standard.kinds().values() if kind.status == "core"}
    assert core == set(models())


def test_image_kinds_are_those_with_images() -> None:
    for name, model in models().items():
        assert standard.kinds()[name].images == ("images" in model.model_fields)


def test_encodings_are_the_models() -> None:
    (union, _) = get_args(Images)
    named = {get_args(model.model_fields["encoding"].annotation)[0] for model in get_args(union)}
    assert named == set(standard.encodings())


def test_stamp_points_are_the_models() -> None:
    assert tuple(standard.stamp_points()) == STAMP_POINTS


def test_arrays_have_core_types_and_named_axes() -> None:
    specs = [*standard.common_arrays().values(), *standard.derived_arrays().values()]
    specs += [spec for kind in standard.kinds().values() for spec in kind.arrays.values()]
    specs += [spec for way in standard.encodings().values() for spec in way.arrays.values()]
    assert len(specs) > 15
    for spec in specs:
        assert set(spec.dtype) <= DTYPES
        assert 1 <= len(spec.dimensions) <= len(spec.shape)
        assert (spec.dimensions[0] == "time") == spec.per_sample or spec.shape[0] == "N+1"


def test_units_of_arrays_are_registered() -> None:
    for spec in standard.common_arrays().values():
        assert spec.unit is None or spec.unit in standard.units()


def test_units_of_time_agree_with_themselves() -> None:
    times = [unit for unit in standard.units().values() if unit.ns is not None]
    assert {unit.name for unit in times} == {"s", "ms", "us", "ns"}
    for unit in times:
        assert unit.si is not None
        assert unit.ns == round(unit.si * 1e9)


def test_flags_have_bits_of_their_own() -> None:
    masks = [flag.mask for flag in standard.flags().values()]
    assert len(masks) == len(set(masks))
    assert max(masks) < 1 << 32


def test_sensors_are_of_known_kinds() -> None:
    assert {sensor.kind for sensor in standard.sensors().values()} <= set(standard.kinds())


def test_rules_are_complete() -> None:
    for rule in standard.rules().values():
        assert rule.level in standard.LEVELS
        assert rule.severity in ("error", "warning", "info")
        assert rule.since == "1.0"
        assert rule.title
        assert not rule.title.endswith(".")
        assert rule.message
        assert rule.suggestion.endswith((".", "?")) or "exumi" in rule.suggestion


def test_every_rule_says_why_and_how_to_mend() -> None:
    table = standard.rules().values()
    for rule in table:
        assert len(rule.why.split()) >= 12, rule.id
        assert rule.why.endswith("."), rule.id
        assert rule.why != rule.mend
        # "Report it" helps the reader of a finding, but not who wrote the data.
        if "maker of the program" in rule.suggestion or len(rule.suggestion) < 30:
            assert rule.mend, f"{rule.id} says too little about mending"
        if rule.mend:
            assert rule.mend.endswith("."), rule.id
    whys = [rule.why for rule in table]
    assert len(set(whys)) == len(whys)


def test_rules_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        standard.rules()["X-001"] = standard.rules()["TIME-001"]  # type: ignore[index]
    with pytest.raises(AttributeError):
        standard.rules()["TIME-001"].title = "another"  # type: ignore[misc]
