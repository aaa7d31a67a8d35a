"""How many files the readers of one dataset keep open."""

import resource

import pytest

from exumi_loaders.readers import _most_open_files


@pytest.mark.parametrize(("allowed", "most"), [(300, 128), (2048, 128), (4096, 256)])
def test_open_files_are_a_small_part_of_what_is_allowed(allowed: int, most: int) -> None:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, before[1]))
        assert _most_open_files() == most
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_they_are_never_many() -> None:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (before[1], before[1]))
        assert 128 <= _most_open_files() <= 1024
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
