"""What the conformance corpus is built from: see ``spec/conformance/README.md``."""

__all__: list[str] = []
