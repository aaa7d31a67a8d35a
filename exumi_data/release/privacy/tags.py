"""What a tag of a video file tells: its name and its text."""

import re
from collections.abc import Iterator, Mapping

from exumi_data.release.privacy.kinds import Kind
from exumi_data.release.privacy.text import matches_in

__all__ = ["Names", "told_by_tag"]

Names = Mapping[str, Kind]
"""Words that are private wherever they stand."""

_MEANINGS: tuple[tuple[re.Pattern[str], Kind, str], ...] = (
    (re.compile(r"location|gps|latitude|longitude"), "gps", "the clip's position"),
    (re.compile(r"serial|identifier|uuid"), "serial", "an id of camera or clip"),
    (
        re.compile(r"artist|author|director|producer|composer|performer|engineer|technician"),
        "operator",
        "who made the clip",
    ),
)


def told_by_tag(name: str, text: str, names: Names) -> Iterator[tuple[Kind, str, str]]:
    """Yield kind, part and reason of what may be private in a tag.

    Parameters
    ----------
    name : str
        Of the tag, in whatever letters.
    text : str
    names : mapping of str to str
        People whom the dataset names.
    """
    if not text.strip():
        return
    for pattern, kind, why in _MEANINGS:
        if pattern.search(name.lower()):
            yield kind, text, why
            return
    for match in matches_in(text, names):
        yield (
            match.kind,
            text[match.start : match.stop],
            f"{match.why} in the file's own description",
        )
