"""Exact search finds what sorting all products would; FAISS finds most of it."""

from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_data.errors import MissingExtraError
from exumi_loaders.retrieval import search as module
from exumi_loaders.retrieval.faiss_search import FaissSearch
from exumi_loaders.retrieval.search import ExactSearch
from exumi_loaders.retrieval.space import unit


def rows(count: int, width: int = 16, seed: int = 0) -> np.ndarray:
    return unit(np.random.default_rng(seed).normal(size=(count, width)))


@given(
    sizes=st.lists(st.integers(0, 40), max_size=5),
    queries=st.integers(1, 4),
    k=st.integers(1, 12),
    seed=st.integers(0, 99),
    levels=st.integers(1, 3),
)
def test_search_is_sorting_all_products(
    sizes: list[int], queries: int, k: int, seed: int, levels: int
) -> None:
    """With few levels, many rows are equal: the earlier comes first, whatever the blocks."""
    random = np.random.default_rng(seed)
    whole = random.integers(-levels, levels + 1, (sum(sizes), 3)).astype(np.float32)
    asked = random.integers(-levels, levels + 1, (queries, 3)).astype(np.float32)
    alive = random.random(len(whole)) < 0.7
    blocks = np.split(whole, np.cumsum(sizes)[:-1]) if sizes else []
    for mask in (None, alive):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "_SCORES", 16)
            similarity, row = ExactSearch(blocks, mask).nearest(asked, k)
        numbers = np.arange(len(whole)) if mask is None else np.flatnonzero(mask)
        products = asked @ whole[numbers].T
        order = np.argsort(-products, axis=1, kind="stable")[:, :k]
        np.testing.assert_array_equal(row, numbers[order])
        np.testing.assert_array_equal(similarity, np.take_along_axis(products, order, axis=1))


def test_a_damaged_row_does_not_hide_the_others() -> None:
    whole = rows(50)
    asked = whole[7:8].copy()
    whole[3] = np.nan
    assert ExactSearch([whole]).nearest(asked, 1)[1].tolist() == [[7]]


def test_memory_does_not_grow_with_the_rows() -> None:
    import tracemalloc

    whole = rows(200_000, 8)
    asked = rows(64, 8, seed=1)
    search = ExactSearch([whole])
    tracemalloc.start()
    search.nearest(asked, 5)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 << 20  # all products would take 51 MB


def test_faiss_finds_most_of_it_or_says_what_is_missing() -> None:
    whole = rows(25_000, seed=2)
    if find_spec("faiss") is None:
        with pytest.raises(MissingExtraError, match=r"exumi-data\[faiss\]"):
            FaissSearch([whole])
        return
    alive = np.ones(len(whole), dtype=bool)
    alive[::10] = False
    asked = unit(whole[1:400:4] + 0.1 * rows(100, seed=3))
    exact = ExactSearch([whole], alive).nearest(asked, 5)
    for blocks in ([whole], np.split(whole, 5)):
        similarity, row = FaissSearch(blocks, alive).nearest(asked, 5)
        assert alive[row[row >= 0]].all()
        assert (row[:, 0] == exact[1][:, 0]).mean() > 0.9
        np.testing.assert_allclose(similarity[:, 0], exact[0][:, 0], atol=0.3)
    few = FaissSearch([whole[:100]]).nearest(asked, 5)
    np.testing.assert_array_equal(few[1], ExactSearch([whole[:100]]).nearest(asked, 5)[1])
