"""The page: one file that needs nothing else, and runs no script."""

from importlib import resources

from exumi_data.stats.html.content import content
from exumi_data.stats.html.findings import findings
from exumi_data.stats.html.labels import labels
from exumi_data.stats.html.markup import Html, element, join, shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.motion import motion
from exumi_data.stats.html.origin import origin
from exumi_data.stats.html.overview import overview, summary
from exumi_data.stats.html.sheets import sheets
from exumi_data.stats.html.sound import sound
from exumi_data.stats.html.timing import timing
from exumi_data.stats.html.touch import touch

__all__ = ["GENERATOR", "render"]

GENERATOR = "exumi-data stats"
"""By which a page is known to be one of these."""

# Nothing may be loaded and nothing may run, whatever names the data has.
_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'none'"
)
_LINKS = (
    ("overview", "Overview"),
    ("content", "What it holds"),
    ("touch", "Touch"),
    ("sheets", "Contact sheet"),
    ("timing", "Time"),
    ("motion", "Width, force, pose"),
    ("sound", "Sound"),
    ("labels", "Labels"),
    ("findings", "Findings"),
    ("origin", "Origin"),
)


def render(material: Material) -> str:
    """Write the page.

    Parameters
    ----------
    material : Material

    Returns
    -------
    str
        The same for the same material, to the byte.
    """
    name = shortened(material.statistics.name, 80)
    body = element("body", element("div", *_body(material, name), class_="page"))
    html = element("html", _head(material, name), body, lang="en")
    return f"<!DOCTYPE html>\n{html}\n"


def _head(material: Material, name: str) -> Html:
    style = resources.files("exumi_data.stats.html").joinpath("style.css").read_text("utf-8")
    return element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="generator", content=GENERATOR),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("meta", name="referrer", content="no-referrer"),
        element("title", f"{name}: exUMI {material.statistics.what}"),
        element("meta", name="description", content=summary(material)),
        element("style", Html(style)),
    )


def _body(material: Material, name: str) -> list[Html]:
    found: dict[str, Html | None] = {
        "overview": overview(material),
        "content": content(material),
    }
    if material.totals.rows:
        found |= {
            "touch": touch(material),
            "sheets": sheets(material),
            "timing": timing(material),
            "motion": motion(material),
            "sound": sound(material),
            "labels": labels(material),
        }
    found |= {
        "findings": findings(material),
        "origin": origin(material),
    }
    shown = {anchor: part for anchor, part in found.items() if part is not None}
    links = [element("a", title, href=f"#{a}") for a, title in _LINKS if a in shown]
    main = element("main", *shown.values())
    return [_header(material, name), element("nav", *links, aria_label="Sections"), main]


def _header(material: Material, name: str) -> Html:
    statistics, dataset = material.statistics, material.dataset
    description = dataset.description if dataset else None
    words = element(
        "div",
        element("p", f"exUMI {statistics.what}", class_="eyebrow"),
        element("h1", name),
        element("p", summary(material), class_="summary"),
        element("p", shortened(description, 600), class_="description") if description else None,
    )
    return element("header", words, _theme())


def _theme() -> Html:
    choices = []
    for name, title in (("auto", "Auto"), ("light", "Light"), ("dark", "Dark")):
        box = element("input", type="radio", name="theme", id=name, checked=name == "auto")
        choices.append(join(box, element("label", title, for_=name)))
    legend = element("legend", "Colours of the page", class_="unseen")
    return element("fieldset", legend, *choices, class_="theme")
