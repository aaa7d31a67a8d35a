"""Options that only one format has: ``--option name=value`` on the command line."""

from collections.abc import Mapping
from typing import Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from exumi_data.errors import UsageError

__all__ = ["FormatOptions", "describe_options", "parse_options"]


class FormatOptions(BaseModel):
    """Base of a format's own options: fields with a default and a description.

    A format that has none uses this class itself.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


Options = TypeVar("Options", bound=FormatOptions)


def parse_options(model: type[Options], given: Mapping[str, str], form: str) -> Options:
    """Read a format's own options.

    Parameters
    ----------
    model : type of FormatOptions
    given : mapping of str to str
        As the user wrote them.
    form : str
        Name of the format, for messages.

    Returns
    -------
    FormatOptions

    Raises
    ------
    UsageError
        Naming everything that is wrong, and the options that there are.
    """
    try:
        return model.model_validate(dict(given))
    except ValidationError as error:
        wrong = [_mistake(item, given) for item in error.errors()]
        known = ", ".join(model.model_fields) or "none"
        raise UsageError("; ".join(wrong), fix=f"Options of {form}: {known}.") from None


def _mistake(item: object, given: Mapping[str, str]) -> str:
    assert isinstance(item, dict)  # noqa: S101  # pydantic's error details
    name = ".".join(str(part) for part in item["loc"])
    if item["type"] == "extra_forbidden":
        return f"there is no option {name!r}"
    message = str(item["msg"])
    return f"Invalid {name} ({given.get(name)}): {message[0].lower()}{message[1:]}"


def describe_options(model: type[FormatOptions]) -> dict[str, str]:
    """Return name and one line for each option of a format.

    Parameters
    ----------
    model : type of FormatOptions
    """
    lines = {}
    for name, field in model.model_fields.items():
        default = "" if field.default in (None, "") else f" Default: {_said(field.default)}."
        lines[name] = f"{field.description or ''}{_choices(field.annotation)}{default}".strip()
    return lines


def _choices(annotation: object) -> str:
    """Name the values that an option can have, where they are few."""
    if annotation is bool:
        return " One of: yes, no."
    if get_origin(annotation) is Literal:
        return f" One of: {', '.join(map(str, get_args(annotation)))}."
    return ""


def _said(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)
