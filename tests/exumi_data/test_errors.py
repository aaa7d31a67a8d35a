"""Errors carry what, where and what to do, also from one process to another."""

import copy
import multiprocessing
from typing import Any

import pytest

from exumi_data import errors
from exumi_data.errors import ExumiError, MetadataError, MissingExtraError

CLASSES: list[type[ExumiError]] = [getattr(errors, name) for name in errors.__all__]


@pytest.mark.parametrize("kind", CLASSES)
def test_the_message_says_where_and_what_to_do(kind: type[ExumiError]) -> None:
    error = kind("the shard is missing", where="a.zarr", fix="Copy it again.")
    assert str(error) == "a.zarr: the shard is missing. Copy it again."
    assert (error.what, error.where, error.fix) == (
        "the shard is missing",
        "a.zarr",
        "Copy it again.",
    )
    assert str(kind("it is missing")) == "it is missing"
    assert isinstance(error, ExumiError)


def test_a_missing_extra_is_an_import_error_too() -> None:
    assert issubclass(MissingExtraError, ImportError)


def same(left: ExumiError, right: ExumiError) -> bool:
    fields = ("what", "where", "fix", "problems")
    return type(left) is type(right) and all(
        getattr(left, field, None) == getattr(right, field, None) for field in fields
    )


@pytest.mark.parametrize("kind", CLASSES)
def test_an_error_can_be_copied(kind: type[ExumiError]) -> None:
    error = kind("what", where="where", fix="fix")
    assert same(copy.copy(error), error)
    assert str(copy.copy(error)) == str(error)


def test_an_error_crosses_processes_whole() -> None:
    sent: list[Any] = [kind("what", where="where", fix="fix") for kind in CLASSES]
    sent.append(MetadataError("many", where="x", problems=("a @ $.b", "c @ $.d")))
    receiver, sender = multiprocessing.Pipe(duplex=False)
    with receiver, sender:
        sender.send(sent)
        received = receiver.recv()
    assert all(map(same, received, sent))
    assert received[-1].problems == ("a @ $.b", "c @ $.d")
