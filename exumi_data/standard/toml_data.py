"""Reading the TOML files beside this module."""

import tomllib
from importlib import resources
from typing import Any

__all__ = ["read_toml"]


def read_toml(name: str) -> dict[str, Any]:
    """Parse one of the standard's TOML files.

    Parameters
    ----------
    name : str
        File name, or path below this folder.
    """
    return tomllib.loads(resources.files("exumi_data.standard").joinpath(name).read_text("utf-8"))
