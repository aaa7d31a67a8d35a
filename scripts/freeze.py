"""Print the versions installed in this environment as constraints (see CONTRIBUTING.md).

What holds only on the machine that made them is left out: GPU libraries that PyTorch's Linux build
brings along, local builds' suffixes (``+cpu``), and the project itself.
"""

import subprocess
import sys

HEADER = """\
# The versions that CI runs with; `make setup` installs exactly these. Made by scripts/freeze.py
# from `pip install .[train,record,mcap,umi,view,ray,cloud,release,test,docs]` on Python 3.11.
# PyTorch's GPU libraries are left out: torch pins them.
"""
GPU_PREFIXES = ("cuda-", "nvidia-", "triton")
NOT_OURS = ("exumi-data", "pip")  # the project itself, and the tool that asks


def constraints(freeze: str) -> list[str]:
    """Portable pins out of the output of ``pip freeze``.

    Parameters
    ----------
    freeze : str
        Lines ``name==version``.

    Returns
    -------
    list of str
        Lines ``name==version`` with lower-case names, sorted.

    Raises
    ------
    ValueError
        If a package comes from a path or an address: such a pin holds on this machine only.
    """
    pins = []
    for line in freeze.splitlines():
        name, separator, version = line.partition("==")
        name = name.lower().replace("_", "-")
        if name in NOT_OURS:
            continue
        if not separator:
            raise ValueError(f"{line!r} is not name==version: install it from the package index")
        if not name.startswith(GPU_PREFIXES):
            pins.append(f"{name}=={version.partition('+')[0]}")
    return sorted(pins)


def main() -> None:
    """Print the constraints of this interpreter's environment."""
    command = [sys.executable, "-m", "pip", "freeze", "--all", "--exclude-editable"]
    freeze = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    print(HEADER + "\n".join(constraints(freeze)))


if __name__ == "__main__":
    main()
