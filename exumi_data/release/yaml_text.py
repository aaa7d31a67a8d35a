"""Texts as scalars of YAML."""

import json

__all__ = ["yaml_text"]


def yaml_text(text: str) -> str:
    """Return a text as a quoted scalar: JSON's strings are YAML's, but for what YAML forbids.

    Parameters
    ----------
    text : str
    """
    quoted = json.dumps(text, ensure_ascii=False)
    return "".join(one if one.isprintable() else _escaped(ord(one)) for one in quoted)


def _escaped(code: int) -> str:
    if 0xD800 <= code < 0xE000:  # half a letter, which no file can hold
        code = 0xFFFD
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
