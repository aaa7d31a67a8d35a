#!/bin/sh
# Make a virtual environment with LeRobot 0.4.4, to be measured by lerobot_windows.py.
#
# usage: install_lerobot.sh TARGET [PYTHON]      PYTHON defaults to python3.11
set -eu

if [ "$#" -lt 1 ] || [ "$#" -gt 2 ]; then
    echo "usage: install_lerobot.sh TARGET [PYTHON]" >&2
    exit 2
fi
target=$1
python=${2:-python3.11}

if ! command -v "$python" >/dev/null 2>&1; then
    echo "install_lerobot.sh: no such Python: $python. Name one (3.11 to 3.13) as second argument." >&2
    exit 2
fi
if ! "$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))'; then
    echo "install_lerobot.sh: $python is not Python 3.11 to 3.13, which these pinned wheels need." >&2
    exit 2
fi

"$python" -m venv "$target"
pip="$target/bin/python -m pip --disable-pip-version-check"

# The newest releases that LeRobot 0.4.4 itself allows: torch < 2.11, torchvision < 0.26,
# torchcodec < 0.11, av < 16, huggingface-hub < 0.36, packaging < 26. torch, torchvision and
# torchcodec must match one another. torchvision from PyPI is linked against CUDA, so torch has to
# be the PyPI wheel too: a CPU-only torch refuses it ("operator torchvision::nms does not exist").
# shellcheck disable=SC2086  # $pip is a command with arguments, meant to be split
$pip install --quiet \
    torch==2.10.0 torchvision==0.25.0 torchcodec==0.10.0 av==15.1.0 \
    datasets==4.8.5 huggingface-hub==0.35.3 accelerate==1.14.0 packaging==25.0 \
    numpy==2.2.6 pandas==3.1.1 pyarrow==26.0.1 pillow==13.0.0 fsspec==2026.2.0 safetensors==0.8.0

# Without its dependencies: the rest of them (simulators, robots, viewers, trackers) is never
# imported by its dataset class, and some need a compiler.
# shellcheck disable=SC2086
$pip install --quiet --no-deps lerobot==0.4.4

# torchcodec loads FFmpeg's shared libraries only when it is imported: find out now.
if ! "$target/bin/python" -c 'import torchcodec.decoders, lerobot.datasets.lerobot_dataset'; then
    echo "install_lerobot.sh: installed, but it does not import (see above). If torchcodec could not" >&2
    echo "be loaded, install FFmpeg 4 to 8 with shared libraries, e.g. apt-get install ffmpeg." >&2
    exit 1
fi
echo "LeRobot 0.4.4 is in $target"
