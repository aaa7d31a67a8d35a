"""What the charts share: the frame of a picture, its text, axes with round numbers."""

import math
from collections.abc import Sequence

from exumi_data.stats.html.markup import Content, Html, element, fitted, shortened, text

__all__ = [
    "LEVELS",
    "WIDTH",
    "label",
    "level_cells",
    "number_text",
    "picture",
    "round_ticks",
    "tick_text",
    "x_axis",
]

WIDTH = 360
"""Units across of every chart: about the pixels that it gets on a phone."""

_LETTER = 5.7  # units, of the average letter
LEVELS = 8
"""Steps of the scale of heat maps, above nothing."""


def picture(title: str, description: str, height: float, *content: Content) -> Html:
    """Write a chart.

    Parameters
    ----------
    title, description : str
        For those who cannot see it.
    height : float
        Units.
    *content : str
        Pieces of SVG.
    """
    return element(
        "svg",
        element("title", title),
        element("desc", description),
        *content,
        viewBox=f"0 0 {WIDTH} {height:.0f}",
        role="img",
        aria_label=f"{title}. {description}",
        class_="chart",
    )


def label(
    x: float,
    y: float,
    words: object,
    *,
    anchor: str | None = None,
    quiet: bool = False,
    width: float | None = None,
) -> Html:
    """Write text, cut to a width; the whole of it is shown when pointed at.

    Parameters
    ----------
    x, y : float
        Of its base line.
    words : object
    anchor : {"start", "middle", "end"}, optional
    quiet : bool
        In the colour of axes.
    width : float, optional
        Units.
    """
    whole = str(words)
    shown = whole if width is None else fitted(whole, max(3, int(width / _LETTER)))
    note = element("title", shortened(whole, 200)) if shown != whole else None
    return element(
        "text",
        note,
        text(shown),
        x=float(x),
        y=float(y),
        text_anchor=anchor,
        class_="q" if quiet else None,
    )


def round_ticks(low: float, high: float, about: int = 4) -> list[float]:
    """Return round numbers between two ends.

    Parameters
    ----------
    low, high : float
        Finite.
    about : int
        How many are wanted.
    """
    if not high > low:
        return [low]
    rough = (high - low) / about
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [number * step for number in range(first, last + 1)]


def tick_text(value: float) -> str:
    """Write a number of an axis.

    Parameters
    ----------
    value : float
    """
    if value == 0:
        return "0"
    if abs(value) >= 1e6:
        return f"{value:.3g}".replace("e+0", "e").replace("-", "−")
    return f"{value:,.10g}".replace("-", "−") if abs(value) >= 1e-3 else f"{value:.1g}"


def number_text(value: float) -> str:
    """Write a number with three digits that count.

    Parameters
    ----------
    value : float
    """
    return tick_text(float(f"{value:.3g}"))


def x_axis(  # what an axis has
    ticks: Sequence[tuple[float, str]], *, left: float, right: float, y: float, title: str
) -> Html:
    """Write a horizontal axis.

    Parameters
    ----------
    ticks : sequence of (float, str)
        Where, in units, and what stands there.
    left, right : float
        Ends of its line.
    y : float
        Of its line; it takes 32 units below.
    title : str
        What it shows, with the unit.
    """
    parts = [element("line", x1=left, x2=right, y1=y, y2=y, class_="axis")]
    for x, words in ticks:
        parts.append(element("line", x1=float(x), x2=float(x), y1=y, y2=y + 3, class_="axis"))
        anchor = "end" if x > right - 8 else "start" if x < left + 4 and left < 10 else "middle"
        parts.append(label(x, y + 14, words, anchor=anchor, quiet=True))
    parts.append(label((left + right) / 2, y + 29, title, anchor="middle", quiet=True))
    return Html("".join(parts))


def level_cells(
    levels: Sequence[Sequence[int]], *, left: float, top: float, cell: tuple[float, float]
) -> Html:
    """Write the cells of a heat map, one path a level: runs of equal cells become one rectangle.

    Parameters
    ----------
    levels : sequence of sequence of int
        Row by row from the top, 0 (nothing, not drawn) to 8.
    left, top : float
    cell : (float, float)
        Width and height of a cell.
    """
    runs: dict[int, list[str]] = {}
    for row, values in enumerate(levels):
        start = 0
        for column in range(1, len(values) + 1):
            if column < len(values) and values[column] == values[start]:
                continue
            if values[start]:
                path = f"M{start} {row}h{column - start}v1h{start - column}z"
                runs.setdefault(values[start], []).append(path)
            start = column
    paths = [element("path", d="".join(runs[level]), class_=f"q{level}") for level in sorted(runs)]
    move = f"translate({left:.2f} {top:.2f}) scale({cell[0]:.4f} {cell[1]:.4f})"
    return element("g", *paths, transform=move, class_="cells")
