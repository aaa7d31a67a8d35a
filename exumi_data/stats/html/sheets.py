"""Section: contact sheets, the strongest contact of many episodes."""

import base64

from exumi_data.stats.html.layout import cards, missing, section
from exumi_data.stats.html.looking import Picture, Tile
from exumi_data.stats.html.markup import Html, element, join, shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.words import counted, percent
from exumi_data.wording import time_text

__all__ = ["sheets"]


def sheets(material: Material) -> Html | None:
    """Write the section; None without tactile streams.

    Parameters
    ----------
    material : Material
    """
    if not material.totals.holding["tactile"]:
        return None
    tiles = material.pictures.tiles
    title = "Contact sheet"
    if not tiles:
        why = "No frame could be read."
        return section("sheets", title, "", cards(missing("No pictures", why)))
    strongest = any(tile.activity is not None for tile in tiles)
    which = "each at its strongest contact" if strongest else "each in its middle"
    lead = (
        f"{counted(len(tiles), 'episode')} of {len(material.totals.rows):,}, {which}, beside the "
        "change from the reference image: "
    )
    legend = join(
        lead,
        element("span", "brighter", class_="brighter"),
        " and ",
        element("span", "darker", class_="darker"),
        " than without contact, seven times amplified. Active is the share of the image that "
        "changed.",
    )
    figures = [_tile(tile) for tile in tiles]
    return section(
        "sheets", title, "", element("p", legend, class_="lead"),
        element("div", *figures, class_="sheet"),
    )  # fmt: skip


def _tile(tile: Tile) -> Html:
    name = shortened(tile.name, 40)
    part = "" if tile.activity is None else f", {percent(tile.activity)} active"
    words = f"at {time_text(tile.time_s)}{part}"
    images = [_image(picture, name) for picture in tile.pictures]
    caption = element(
        "figcaption",
        element("b", name),
        " ",
        element("span", words),
        title=f"episode {tile.episode}",
    )
    several = " many" if len(images) > 2 else ""
    return element(
        "figure", element("div", *images, class_="pictures"), caption, class_=f"tile{several}"
    )


def _image(picture: Picture, name: str) -> Html:
    data = base64.b64encode(picture.jpeg).decode()
    return element(
        "img",
        src=f"data:image/jpeg;base64,{data}",
        alt=f"{name}: {picture.words}",
        title=picture.words,
        width=picture.width,
        height=picture.height,
        decoding="async",
        class_="camera" if picture.camera else None,
    )
