"""The version of the library (the format has a version of its own, see ``spec/``)."""

__all__ = ["__version__"]

__version__ = "0.1.0"
