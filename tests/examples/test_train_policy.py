"""The policy example runs as it stands, its episodes are valid, and its task is what it says."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from exumi_data.episode import Episode
from exumi_data.store import jpeg
from exumi_validators import validate

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = ("--demonstrations", "3", "--play", "3", "--encoder-steps", "2", "--attempts", "2")


def start(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / "train_policy.py"), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
