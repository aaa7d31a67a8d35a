"""Arrow columns and tables of LeRobot's types."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["vector_column", "write_tasks"]


def vector_column(values: np.ndarray) -> "pa.Array":
    """Return a column: plain numbers of (N,) and (N, 1), lists of fixed length of (N, C).

    Parameters
    ----------
    values : (N,) or (N, C)
    """
    import pyarrow as pa

    flat = pa.array(values.reshape(-1))
    if values.ndim == 1 or values.shape[1] == 1:
        return flat
    element = pa.field("element", flat.type)
    return pa.FixedSizeListArray.from_arrays(flat, type=pa.list_(element, values.shape[1]))


def write_tasks(tasks: Sequence[str], path: Path) -> None:
    """Write the table of tasks: pandas finds their texts as its index, as LeRobot expects.

    Parameters
    ----------
    tasks : sequence of str
        In the order of their numbers.
    path : pathlib.Path
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    index = "__index_level_0__"
    columns: dict[str, Any] = {
        "task_index": pa.array(range(len(tasks)), pa.int64()),
        index: pa.array(tasks, pa.string()),
    }
    said = {
        "index_columns": [index],
        "column_indexes": [
            {
                "name": None,
                "field_name": None,
                "pandas_type": "unicode",
                "numpy_type": "object",
                "metadata": {"encoding": "UTF-8"},
            }
        ],
        "columns": [
            _described("task_index", "task_index", "int64", "int64"),
            _described(None, index, "unicode", "object"),
        ],
        "creator": {"library": "exumi-data", "version": "1"},
        "pandas_version": "2.2.0",
    }
    table = pa.table(columns).replace_schema_metadata({"pandas": json.dumps(said)})
    pq.write_table(table, path)


def _described(name: str | None, field: str, kind: str, numpy: str) -> dict[str, Any]:
    return {
        "name": name,
        "field_name": field,
        "pandas_type": kind,
        "numpy_type": numpy,
        "metadata": None,
    }
