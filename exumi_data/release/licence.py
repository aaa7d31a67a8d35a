"""The licence of a release: an SPDX expression that somebody chose, and its text."""

import re
from pathlib import Path

from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

from exumi_data.errors import DamagedDataError, LimitError, UsageError
from exumi_data.model.episode import UNKNOWN_LICENCE
from exumi_data.store.plain_files import read_plain

__all__ = ["LICENCE_NAME", "NO_LICENCE", "canonical_licence", "find_licence_text", "stated_licence"]

LICENCE_NAME = "LICENSE"
"""The name that everybody looks for."""

NO_LICENCE = (UNKNOWN_LICENCE, "NONE")
"""SPDX's words for data that nobody may use: it is not known under which licence, or under none."""

_NAMES = ("LICENSE", "LICENCE", "LICENSE.txt", "LICENCE.txt", "LICENSE.md", "LICENCE.md")
_MAX_BYTES = 1 << 20
_OWN = "LicenseRef-"
# Words that stand in the text of a licence and in no other's: the wrong file is found at once.
_WORDS = {
    "CC0-1.0": "CC0 1.0 Universal",
    "CC-BY-4.0": "Attribution 4.0 International",
    "CC-BY-SA-4.0": "Attribution-ShareAlike 4.0 International",
    "CC-BY-NC-4.0": "Attribution-NonCommercial 4.0 International",
    "CC-BY-NC-SA-4.0": "Attribution-NonCommercial-ShareAlike 4.0 International",
    "CC-BY-ND-4.0": "Attribution-NoDerivatives 4.0 International",
    "CC-BY-NC-ND-4.0": "Attribution-NonCommercial-NoDerivatives 4.0 International",
    "ODbL-1.0": "Open Database License",
    "ODC-By-1.0": "Open Data Commons Attribution License",
    "PDDL-1.0": "Public Domain Dedication",
    "CDLA-Permissive-2.0": "Community Data License Agreement",
    "CDLA-Sharing-1.0": "Community Data License Agreement",
    "Apache-2.0": "Apache License",
    "MIT": "Permission is hereby granted, free of charge",
}


def canonical_licence(text: str) -> str:
    """Return an SPDX licence expression in its usual spelling.

    Parameters
    ----------
    text : str
        Such as ``cc-by-4.0``, ``MIT OR Apache-2.0`` or ``LicenseRef-our-lab``.

    Raises
    ------
    UsageError
        It is none, or the licence is not known.
    """
    if text.strip().upper() in (*NO_LICENCE, ""):
        raise UsageError(
            f"the licence is {text.strip() or 'empty'}: nobody may use what is published so",
            fix="Ask who owns the data, and say --licence, such as CC-BY-4.0.",
        )
    try:
        return str(canonicalize_license_expression(text))
    except InvalidLicenseExpression:
        raise UsageError(
            f"{text!r} is no SPDX licence expression",
            fix="Say one of https://spdx.org/licenses, such as CC-BY-4.0, or LicenseRef-<name> "
            "for a licence of your own.",
        ) from None


def stated_licence(text: str) -> str:
    """Return what data may state as their licence, released or not: it may also be not known.

    Parameters
    ----------
    text : str
        Such as ``cc-by-4.0``, or SPDX's words ``NOASSERTION`` and ``NONE``.

    Raises
    ------
    UsageError
        It is no SPDX licence expression.
    """
    word = text.strip().upper()
    return word if word in NO_LICENCE else canonical_licence(text)


def find_licence_text(source: Path, file: Path | None, expression: str) -> bytes:
    """Return the text of a licence: from a file that was named, or from beside the data.

    No text is made up: a licence holds by its very words.

    Parameters
    ----------
    source : pathlib.Path
        The dataset that is released.
    file : pathlib.Path or None
        The file that was named.
    expression : str
        The licence, as `canonical_licence` writes it.

    Returns
    -------
    bytes
        UTF-8, lines end with a line feed.

    Raises
    ------
    UsageError
        There is none, or it is that of another licence.
    """
    path = file or next((source / name for name in _NAMES if (source / name).is_file()), None)
    if path is None:
        raise UsageError(
            f"the text of the licence {expression} is missing",
            where=source,
            fix=f"Put it there as {LICENCE_NAME}, or name it with --licence-file. "
            + _advice(expression),
        )
    try:
        text = read_plain(path, _MAX_BYTES).decode()
    except FileNotFoundError:
        raise UsageError("no such file", where=path) from None
    except (UnicodeDecodeError, DamagedDataError, LimitError) as error:
        what = getattr(error, "what", "is no UTF-8 text")
        raise UsageError(f"{what}: not the text of a licence", where=path) from None
    said = " ".join(text.split()).lower()
    if not said:
        raise UsageError("is empty: not the text of a licence", where=path)
    for licence in _ids(expression):
        words = _WORDS.get(licence)
        if words and words.lower() not in said:
            raise UsageError(
                f"is not the text of {licence}: {words!r} does not stand in it",
                where=path,
                fix=_advice(licence),
            )
    return "".join(f"{line.rstrip()}\n" for line in text.splitlines()).encode()


def _ids(expression: str) -> list[str]:
    words = re.split(r"[()\s]+", expression)
    return [word for word in words if word and word not in ("AND", "OR", "WITH")]


def _advice(expression: str) -> str:
    listed = [one for one in _ids(expression) if not one.startswith(_OWN)]
    if not listed:
        return "It is your own."
    return "The official text: " + ", ".join(
        f"https://spdx.org/licenses/{one.removesuffix('+')}.html" for one in listed
    )
