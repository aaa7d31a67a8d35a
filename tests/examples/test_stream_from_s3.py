"""The example of object storage runs as it stands, from a real S3 server."""

import os
import subprocess
import sys
from pathlib import Path

from tests.servers import S3, S3_ENVIRONMENT, pack_dataset

FORKS = "ignore::DeprecationWarning:multiprocessing.popen_fork"
EXAMPLE = Path(__file__).parents[2] / "examples" / "stream_from_s3.py"


def test_it_streams_windows_from_a_bucket(play: Path, tmp_path: Path) -> None:
    server = S3()
    try:
        url = server.upload(pack_dataset(play, tmp_path / "packed"), "play")
        done = subprocess.run(
            # Python 3.12 and later warn of forks of processes with threads, which is provided for.
            [sys.executable, "-W", "error", "-W", FORKS, str(EXAMPLE), url, "--batches", "3"],
            env={
                **os.environ,
                **S3_ENVIRONMENT,
                "AWS_ENDPOINT_URL": server.endpoint,
                "EXUMI_CACHE": str(tmp_path / "cache"),
            },
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
    finally:
        server.stop()
    assert done.returncode == 0, done.stderr
    assert f"{url}: 2 episodes" in done.stdout
    assert "of kind tactile" in done.stdout
    assert "192 of" in done.stdout
