"""Contracts of the extension points, for other packages to run on their own extensions.

Each is a function that raises `AssertionError` with everything that is wrong. They need no pytest.
The contract of checks is `exumi_validators.testing`.
"""

from exumi_data.testing.stream_kinds import check_stream_kind

__all__ = ["check_stream_kind"]
