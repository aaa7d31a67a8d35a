"""The pieces that sections are made of: cards, tables, lists of facts."""

from collections.abc import Sequence

from exumi_data.stats.html.charts import Bar, bar_chart
from exumi_data.stats.html.markup import Content, Html, element, join
from exumi_data.stats.html.words import top

__all__ = ["card", "cards", "count_bars", "facts", "missing", "section", "table"]


def section(anchor: str, title: str, lead: str, *content: Content) -> Html:
    """Write a section.

    Parameters
    ----------
    anchor, title, lead : str
        Its id; its heading; one sentence.
    *content : str
    """
    heading = element("h2", title, id=f"{anchor}-title")
    words = element("p", lead, class_="lead") if lead else None
    return element(
        "section", heading, words, *content, id=anchor, aria_labelledby=f"{anchor}-title"
    )


def card(title: str, takeaway: str, *content: Content, note: str | None = None) -> Html:
    """Write a chart with its heading and what it shows in one sentence.

    Parameters
    ----------
    title, takeaway : str
    *content : str
    note : str, optional
        How it was made.
    """
    return element(
        "figure",
        element("figcaption", element("h3", title), element("p", takeaway, class_="takeaway")),
        *content,
        element("p", note, class_="note") if note else None,
        class_="card",
    )


def missing(title: str, why: str) -> Html:
    """Write a card for what is not there.

    Parameters
    ----------
    title, why : str
    """
    return element(
        "figure",
        element("figcaption", element("h3", title), element("p", why, class_="takeaway")),
        class_="card missing",
    )


def cards(*content: Content) -> Html:
    """Put cards side by side, as many as fit.

    Parameters
    ----------
    *content : str or None
    """
    return element("div", *content, class_="cards")


def table(
    caption: str,
    titles: Sequence[str],
    rows: Sequence[Sequence[Content]],
    *,
    left: int = 1,
    wide: int | None = None,
) -> Html:
    """Write a table; on a phone each row becomes a list.

    Parameters
    ----------
    caption : str
        For those who cannot see it.
    titles : sequence of str
        Of the columns.
    rows : sequence of sequence
        Cells; None where there is nothing.
    left : int
        How many columns hold words; the others hold numbers.
    wide : int, optional
        The column that gets a line of its own on a phone.
    """
    head = element("tr", *(element("th", title, scope="col") for title in titles))
    body = []
    for row in rows:
        cells = []
        for number, (title, cell) in enumerate(zip(titles, row, strict=True)):
            kind = "words" if number < left else "number"
            if number == wide:
                kind = "words wide"
            shown = "–" if cell is None else cell
            cells.append(element("td", shown, class_=kind, data_title=title))
        body.append(element("tr", *cells))
    return element(
        "table",
        element("caption", caption, class_="unseen"),
        element("thead", head),
        element("tbody", *body),
    )


def facts(rows: Sequence[tuple[str, Content]]) -> Html:
    """Write a list of names with what belongs to each; empty ones are left out.

    Parameters
    ----------
    rows : sequence of (str, str or None)
    """
    parts = [
        element("div", element("dt", name), element("dd", value)) for name, value in rows if value
    ]
    return element("dl", *parts, class_="facts")


def count_bars(
    title: str, counts: dict[str, int], *, most: int = 8, unit: str = "episodes"
) -> Html:
    """Draw how often each value occurs; the rare ones as one bar.

    Parameters
    ----------
    title : str
    counts : dict of str to int
        The empty string stands for those that do not say.
    most : int
        Bars, besides that of the rest.
    unit : str
    """
    shown, others, rest = top(counts, most)
    bars = [Bar(name, count, f"{count:,}") for name, count in shown]
    if others:
        bars.append(Bar(f"{others:,} more", rest, f"{rest:,}", rest=True))
    silent = counts.get("", 0)
    if silent:
        bars.append(Bar("not said", silent, f"{silent:,}", rest=True))
    words = "; ".join(f"{bar.name[:60]} {bar.note}" for bar in bars)
    # The rest may be longer than any bar: it is cut at twice the longest that has a name.
    longest = max((bar.value for bar in bars if not bar.rest), default=1)
    most_shown = max(longest, min(longest * 2, max((bar.value for bar in bars), default=1)))
    cut = [Bar(b.name, min(b.value, most_shown), b.note, b.rest) for b in bars]
    return join(bar_chart(title, f"Bars: {words}.", cut, unit=unit, most=most_shown))
