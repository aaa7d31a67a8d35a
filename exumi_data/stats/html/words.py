"""Numbers and lists as words, the same all over the page."""

from collections.abc import Iterable, Mapping, Sequence

from exumi_data.stats.html.markup import shortened
from exumi_data.wording import counted

__all__ = [
    "REGIMES",
    "among_top",
    "counted",
    "listed",
    "named",
    "parts_of_episodes",
    "percent",
    "top",
]

REGIMES = {"touch": "touch clip", "play": "play episode", "demonstration": "demonstration"}


def percent(share: float | None) -> str:
    """Write a share; nothing but all of it is 100 %, nothing but none of it 0 %.

    Parameters
    ----------
    share : float or None
        0 to 1.
    """
    if share is None:
        return "not known"
    if 0 < share < 0.001:
        return "< 0.1 %"
    if 0.999 < share < 1:
        return "> 99.9 %"
    return f"{share:.0%}".replace("%", " %") if share in (0, 1) else f"{share * 100:.1f} %"


def named(values: Iterable[str], most: int = 3, longest: int = 40) -> str:
    """List names in a sentence: ``a, b and 3 more``.

    Parameters
    ----------
    values : iterable of str
    most : int
        Names that are listed.
    longest : int
        Characters of each.
    """
    found = [shortened(value, longest) for value in values]
    shown, rest = found[:most], len(found) - most
    if rest > 0:
        return f"{', '.join(shown)} and {rest:,} more"
    return listed(shown)


def listed(words: Sequence[str]) -> str:
    """Join words as a sentence does: ``a``, ``a and b``, ``a, b and c``.

    Parameters
    ----------
    words : sequence of str
    """
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def parts_of_episodes(durations: Sequence[float]) -> tuple[tuple[float, float], str]:
    """Return the ends and the title of an axis of time within episodes.

    Parameters
    ----------
    durations : sequence of float
        Seconds. One episode has its own time, several are laid over each other.
    """
    if len(durations) == 1:
        return (0.0, durations[0]), "time (s)"
    return (0.0, 100.0), "time within the episode (% of its length)"


def top(counts: Mapping[str, int], most: int) -> tuple[list[tuple[str, int]], int, int]:
    """Return the largest counts, and of the others how many they are and their sum.

    Those that do not say (the empty string) are in neither.

    Parameters
    ----------
    counts : mapping of str to int
    most : int

    Returns
    -------
    (list of (str, int), int, int)
    """
    said = [(name, count) for name, count in counts.items() if name]
    order = sorted(said, key=lambda item: (-item[1], item[0]))
    if len(order) == most + 1:
        most += 1  # a row for "1 more" would take the place of that one
    rest = order[most:]
    return order[:most], len(rest), sum(count for _, count in rest)


def among_top(episodes: Mapping[str, int], most: int) -> str:
    """Say which of several groups `top` returns; nothing where it returns all.

    Where the last of them and the first of the others are alike, the name decided.

    Parameters
    ----------
    episodes : mapping of str to int
        Episodes of each group.
    most : int
    """
    shown, others, _ = top(episodes, most)
    if not others:
        return ""
    names = {name for name, _ in shown}
    next_one = max(n for name, n in episodes.items() if name and name not in names)
    which = "with most episodes" if shown[-1][1] > next_one else "shown"
    return f", among the {len(shown)} {which}"
