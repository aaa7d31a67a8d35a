"""Cards: where taxels are pressed, and how much over time."""

import numpy as np

from exumi_data.stats.html.charts import line_chart
from exumi_data.stats.html.layout import card, missing
from exumi_data.stats.html.maps import taxel_map
from exumi_data.stats.html.markup import Html, shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.svg import number_text
from exumi_data.stats.html.taxel_figures import MOST_CELLS, TaxelTotal
from exumi_data.stats.html.words import counted, parts_of_episodes

__all__ = ["taxels"]

_MOST = 4


def taxels(material: Material) -> list[Html]:
    """Draw two cards for each stream of taxels; say which are not drawn.

    Parameters
    ----------
    material : Material
    """
    found = sorted(material.totals.taxels.items())
    names = [name for name, _, _ in material.totals.taxels]
    charts: list[Html] = []
    for (name, _, _), total in found[:_MOST]:
        shown = shortened(name, 30)
        if names.count(name) > 1:
            shown += f" ({total.grid[0]}×{total.grid[1]}, {shortened(total.unit, 12)})"
        if not total.samples.sum():
            charts.append(missing(f"What {shown} felt", "No valid sample."))
            continue
        charts += [_map(shown, total), _over_time(material, shown, total)]
    if len(found) > _MOST:
        more = f"{counted(len(found) - _MOST, 'more stream')} of taxels: not drawn."
        charts.append(missing("More taxels", more))
    large = sorted(material.totals.large_taxels.items())
    for name, (rows, columns) in large[:_MOST]:
        why = f"Its {rows:,} × {columns:,} cells are not drawn: {MOST_CELLS:,} are, at most."
        charts.append(missing(f"What {shortened(name, 30)} felt", why))
    if len(large) > _MOST:
        more = f"{counted(len(large) - _MOST, 'more stream')} of too many taxels: not drawn."
        charts.append(missing("More large taxels", more))
    return charts


def _map(name: str, total: TaxelTotal) -> Html:
    title, unit = f"Mean of {name}", shortened(total.unit, 20)
    means = total.means
    highest = np.where(total.alive, means, -np.inf)
    row, column = (int(i) for i in np.unravel_index(int(highest.argmax()), means.shape))
    takeaway = "No cell is above its value without contact in the mean."
    if means[row, column] > 0:
        takeaway = (
            f"Most in row {row + 1}, column {column + 1}: {number_text(means[row, column])} {unit} "
            f"in the mean; the most that any cell ever felt is {number_text(total.peak)} {unit}."
        )
    note = f"From {counted(int(total.samples.sum()), 'sample')}, above the value without contact."
    dead = int((~total.alive).sum())
    if dead:
        note += f" Crossed out: {counted(dead, 'dead cell')}."
    if total.left_out:
        note += f" {counted(total.left_out, 'sample')} without a valid value."
    chart = taxel_map(title, takeaway, means, total.alive, unit=unit)
    return card(title, takeaway, chart, note=note)


def _over_time(material: Material, name: str, total: TaxelTotal) -> Html:
    title, unit = f"{name} over time", shortened(total.unit, 20)
    values = total.over_time
    known = [value for value in values if value == value]  # noqa: PLR0124  # NaN: no sample there
    takeaway = (
        f"All cells together feel {number_text(min(known))} to {number_text(max(known))} {unit}."
    )
    if min(known) == max(known):
        takeaway = f"All cells together feel {number_text(known[0])} {unit}, all the time."
    x_range, x_title = parts_of_episodes([row.duration_s for row in material.totals.rows])
    chart = line_chart(
        title, takeaway, values, x_range=x_range, x_title=x_title,
        y_title=f"sum of all cells ({unit})", y_range=(min(0.0, *known), max(0.0, *known)),
    )  # fmt: skip
    return card(title, takeaway, chart)
