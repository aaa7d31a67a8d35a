"""Print the public names of the five packages, one a line, or record them (``--write``).

The recorded list is ``tests/house/public_api.txt``: a test compares the two, so that a name comes
or goes only on purpose.
"""

import argparse
import importlib
from pathlib import Path

RECORDED = Path(__file__).resolve().parent.parent / "tests" / "house" / "public_api.txt"
PACKAGES = (
    "exumi_data",
    "exumi_converters",
    "exumi_validators",
    "exumi_loaders",
    "exumi_recorders",
)


def public_names() -> list[str]:
    """Names in the ``__all__`` of the five packages, each of which must really be there.

    Returns
    -------
    list of str
        ``package.name``, sorted within each package.

    Raises
    ------
    AttributeError
        If a package promises a name that it does not have.
    """
    names = []
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in sorted(module.__all__):
            getattr(module, name)
            names.append(f"{package}.{name}")
    return names


def main() -> None:
    """Print or record the names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--write", action="store_true", help=f"write {RECORDED.name}")
    text = "\n".join(public_names()) + "\n"
    if parser.parse_args().write:
        RECORDED.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
