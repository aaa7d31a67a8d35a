"""``python -m exumi_data.cli``: the same as the program ``exumi``."""

from exumi_data.cli import main

__all__: list[str] = []

if __name__ == "__main__":
    main()
