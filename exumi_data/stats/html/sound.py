"""Section: how loud it was."""

import math

from exumi_data.stats.html.charts import line_chart
from exumi_data.stats.html.layout import card, cards, missing, section
from exumi_data.stats.html.markup import Html, shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.sound_figures import FLOOR_DB, SoundTotal
from exumi_data.stats.html.words import counted, parts_of_episodes

__all__ = ["sound"]

_MOST = 6


def sound(material: Material) -> Html | None:
    """Write the section; None without sound.

    Parameters
    ----------
    material : Material
    """
    found = sorted(material.totals.sounds.items())
    if not found:
        return None
    charts = [_level(material, shortened(name, 40), total) for name, total in found[:_MOST]]
    if len(found) > _MOST:
        more = f"{counted(len(found) - _MOST, 'more stream')} of sound: not drawn."
        charts.append(missing("More sound", more))
    return section("sound", "Sound", "How loud it was.", cards(*charts))


def _level(material: Material, name: str, total: SoundTotal) -> Html:
    title = f"Level of {name}"
    if math.isnan(total.level_db):
        return missing(title, "There is no sample of sound.")
    values = total.over_time
    known = [value for value in values if not math.isnan(value)]
    if max(known) <= FLOOR_DB:
        return missing(title, "All of it is silence: no sample differs from 0.")
    takeaway = (
        f"{total.level_db:.0f} dB in the mean; the quietest part {min(known):.0f} dB, the loudest "
        f"{max(known):.0f} dB."
    ).replace("-", "−")
    if total.clipped:
        takeaway += f" {counted(total.clipped, 'sample')} at the end of the scale."
    x_range, x_title = parts_of_episodes([row.duration_s for row in material.totals.rows])
    low = 10.0 * math.floor(min(known) / 10)
    chart = line_chart(
        title, takeaway, values, x_range=x_range, x_title=x_title,
        y_title="root mean square (dB of full scale)", y_range=(low, 0.0),
    )  # fmt: skip
    return card(title, takeaway, chart)
