"""What all metadata models share: strictness, patterns, and how unknown keys are treated."""

import re
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    StringConstraints,
    model_validator,
)
from pydantic_core import PydanticCustomError
from pydantic_core.core_schema import ValidationInfo

__all__ = [
    "EXTENSION_KEY",
    "STREAM_NAME",
    "VERSION",
    "WHOLE_NUMBER",
    "ArrayName",
    "Count",
    "EpisodeId",
    "ExtensionKind",
    "Identifier",
    "Int64",
    "Model",
    "Positive",
    "Rational",
    "Sha256",
    "StreamName",
    "Timestamp",
    "Version",
]

EXTENSION_KEY = r"^[a-z][a-z0-9-]*:[A-Za-z][A-Za-z0-9_.-]*$"
"""Keys and kinds of third parties look like ``vendor:name``."""

_EXTENSION_KEY = re.compile(EXTENSION_KEY)

STREAM_NAME = r"^[a-z][a-z0-9_]{0,63}$"
StreamName = Annotated[str, StringConstraints(pattern=STREAM_NAME)]
ArrayName = Annotated[str, StringConstraints(pattern=STREAM_NAME)]
ExtensionKind = Annotated[str, StringConstraints(pattern=EXTENSION_KEY)]
Identifier = Annotated[str, StringConstraints(pattern=r"^\S(.{0,253}\S)?$")]
EpisodeId = Annotated[
    str,
    StringConstraints(pattern=r"^[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}$"),
]
VERSION = r"^(0|[1-9][0-9]{0,8})\.(0|[1-9][0-9]{0,8})$"
"""Versions are ``major.minor``."""
Version = Annotated[str, StringConstraints(pattern=VERSION)]
Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
# Nanoseconds do not survive a datetime (it holds microseconds), so times are patterned strings.
Timestamp = Annotated[
    str,
    StringConstraints(
        # Not \d, which takes the digits of all scripts.
        pattern=r"^[0-9]{4}-(0[1-9]|1[0-2])-(0[1-9]|[12][0-9]|3[01])"
        r"T([01][0-9]|2[0-3]):[0-5][0-9]:([0-5][0-9]|60)(\.[0-9]{1,9})?Z$"
    ),
]
# 60000/1001 is a rate; 59.94 is a rounding of it.
Rational = Annotated[str, StringConstraints(pattern=r"^[1-9][0-9]{0,17}(/[1-9][0-9]{0,17})?$")]


def _extension_schema(schema: dict[str, Any]) -> None:
    schema["additionalProperties"] = False
    schema["patternProperties"] = {EXTENSION_KEY: {}}


class Model(BaseModel):
    """Base of all metadata models.

    Strict (no silent conversion), no NaN or infinity, and unknown keys are *kept*: a key
    ``vendor:name`` is an extension; any other unknown key is an error in a document of a known
    version and is kept in a document of a newer minor version (validation context
    ``{"newer_minor": True}``).
    """

    model_config = ConfigDict(
        strict=True,
        extra="allow",
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        validate_assignment=True,
        json_schema_extra=_extension_schema,
        ser_json_inf_nan="constants",
    )

    _newer_minor: bool = PrivateAttr(default=False)

    @property
    def is_newer_minor(self) -> bool:
        """Whether it was read from a document of a newer minor version, with any unknown keys."""
        return self._newer_minor

    @model_validator(mode="after")
    def _unknown_keys(self, info: ValidationInfo) -> "Model":
        if (info.context or {}).get("newer_minor"):
            # Remembered, because this also runs whenever a field is assigned to.
            self._newer_minor = True
        if self.model_extra and not self._newer_minor:
            unknown = [key for key in self.model_extra if not _EXTENSION_KEY.fullmatch(key)]
            if unknown:
                msg = (
                    f"unknown key {', '.join(sorted(unknown))!r}; "
                    "keys of third parties are named vendor:name"
                )
                raise ValueError(msg)
        return self


def _whole_number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int):
        raise PydanticCustomError("int_type", "Input should be a valid integer")
    return value


WHOLE_NUMBER = BeforeValidator(_whole_number)
"""For a `Literal` of integers, which would take ``true`` for 1 and 3.0 for 3."""

Int64 = Annotated[int, Field(ge=-(2**63), le=2**63 - 1)]
"""What a 64-bit integer holds: times in ns, and what becomes a column of the catalog."""
Count = Annotated[int, Field(ge=0, le=2**63 - 1)]
Positive = Annotated[int, Field(ge=1, le=2**63 - 1)]
