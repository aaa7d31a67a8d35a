"""Building HTML that cannot be broken by what is in it: text is escaped unless it is `Html`."""

import html
import unicodedata

__all__ = ["Content", "Html", "element", "fitted", "join", "shortened", "text"]

_EMPTY = frozenset({"br", "img", "input", "meta"})
_SHAPES = frozenset({"circle", "line", "path", "rect"})


class Html(str):
    """A piece of HTML, made here."""

    __slots__ = ()


Content = str | int | None
"""What may stand in an element: text, a number, `Html`, or nothing."""


def text(value: object) -> Html:
    """Escape a text for an element or an attribute.

    What is not printable (control characters, lone surrogates, marks that turn the direction of
    writing) is shown as an escape, as in a terminal.

    Parameters
    ----------
    value : object
        `Html` stays as it is; of anything else the `str` is taken.
    """
    if isinstance(value, Html):
        return value
    return Html(html.escape(_visible(str(value)), quote=True))


def _visible(value: str) -> str:
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in value)


def shortened(value: str, longest: int = 60) -> str:
    """Cut a text in its middle: both ends of names tell them apart.

    Parameters
    ----------
    value : str
    longest : int
        Characters, at least 3.
    """
    if len(value) <= longest:
        return value
    head = longest // 2
    return f"{value[:head]}…{value[len(value) - (longest - head - 1) :]}"


def fitted(value: str, columns: int) -> str:
    """Cut a text in its middle to what fits into a width, as it will be shown.

    Parameters
    ----------
    value : str
    columns : int
        The width in average letters, at least 3. Letters of the far East and emoji take two.
    """
    visible = _visible(value)
    if sum(map(_columns, visible)) <= columns:
        return visible
    head = _begin(visible, columns // 2)
    tail = _begin(visible[: len(head) - 1 : -1], columns - columns // 2 - 1)[::-1]
    return f"{head}…{tail}"


def _columns(letter: str) -> int:
    return 2 if unicodedata.east_asian_width(letter) in "WF" else 1


def _begin(value: str, columns: int) -> str:
    for place, letter in enumerate(value):
        columns -= _columns(letter)
        if columns < 0:
            return value[:place]
    return value


def element(name: str, /, *content: Content, **attributes: str | float | bool | None) -> Html:
    """Write an element.

    Parameters
    ----------
    name : str
    *content : str, int or None
        None is left out.
    **attributes
        An underscore at the end is dropped (``class_``), others become hyphens. None and False
        are left out, True stands without a value. Numbers have at most two decimals.
    """
    words = [name]
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        written = key.rstrip("_").replace("_", "-")
        words.append(written if value is True else f'{written}="{_attribute(value)}"')
    opening = " ".join(words)
    if name in _EMPTY:
        return Html(f"<{opening}>")
    inner = join(*content)
    if not inner and name in _SHAPES:
        return Html(f"<{opening}/>")
    return Html(f"<{opening}>{inner}</{name}>")


def _attribute(value: str | float) -> str:
    if isinstance(value, str):
        return text(value)
    return f"{value:.2f}".rstrip("0").rstrip(".")


def join(*content: Content) -> Html:
    """Write pieces one after the other.

    Parameters
    ----------
    *content : str, int or None
    """
    return Html("".join(text(part) for part in content if part is not None))
