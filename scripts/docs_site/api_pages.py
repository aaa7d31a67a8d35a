"""Pages of the API reference: one a public module, filled from the docstrings."""

__all__ = ["API_MODULES", "api_pages"]

API_MODULES = {
    "The core": (
        "exumi_data",
        "exumi_data.model",
        "exumi_data.time",
        "exumi_data.geometry",
        "exumi_data.tactile",
        "exumi_data.camera",
        "exumi_data.calibration",
        "exumi_data.catalog",
        "exumi_data.splits",
        "exumi_data.manifest",
        "exumi_data.standard",
        "exumi_data.errors",
    ),
    "Loading": ("exumi_loaders",),
    "Converting": ("exumi_converters",),
    "Validating": (
        "exumi_validators",
        "exumi_validators.registry",
        "exumi_validators.findings",
        "exumi_validators.context",
    ),
    "Recording": ("exumi_recorders.contract",),
    "For packages of others": (
        "exumi_data.extensions",
        "exumi_data.testing",
        "exumi_converters.testing",
        "exumi_validators.testing",
        "exumi_recorders.testing",
    ),
    "Simulation": ("exumi_data.simulation", "exumi_data.demo"),
}
"""The modules by what they are for."""


def api_pages() -> dict[str, str]:
    """Return the pages by their place on the site."""
    found = {"api/index.md": _index()}
    for modules in API_MODULES.values():
        for module in modules:
            found[f"api/{module}.md"] = f"# {module}\n\n::: {module}\n"
    return found


def _index() -> str:
    lines = [
        "# API reference\n",
        "Made from the docstrings. Units are in the names: `_s`, `_ns`, `_m`; quaternions are",
        "x y z w; a pose `T_a_b` takes coordinates in `b` to coordinates in `a`. Errors that a",
        "user can mend are of [`ExumiError`](exumi_data.errors.md)'s family.\n",
    ]
    for heading, modules in API_MODULES.items():
        lines += [f"## {heading}\n", *(f"- [`{name}`]({name}.md)" for name in modules), ""]
    return "\n".join(lines)
