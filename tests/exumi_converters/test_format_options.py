"""Options of one format: everything that is wrong is said at once."""

from typing import Literal

import pytest
from pydantic import Field

from exumi_converters import FormatOptions, parse_options
from exumi_converters.format_options import describe_options
from exumi_data.errors import UsageError


class Options(FormatOptions):
    """Of a format that does not exist."""

    size: int = Field(224, ge=1, description="Pixels a side.")
    codec: Literal["jpeg", "png"] = Field("jpeg", description="Of the frames.")
    decode: bool = Field(False, description="Store frames.")


def test_words_become_values() -> None:
    told = parse_options(Options, {"size": "64", "codec": "png", "decode": "yes"}, "toy")
    assert told == Options(size=64, codec="png", decode=True)
    assert parse_options(Options, {}, "toy") == Options()


def test_all_mistakes_are_told_with_what_there_is() -> None:
    with pytest.raises(UsageError) as caught:
        parse_options(Options, {"size": "0", "codec": "gif", "speed": "1"}, "toy")
    said = str(caught.value)
    for part in (
        "Invalid size (0)",
        "Invalid codec (gif)",
        "no option 'speed'",
        "Options of toy: size, codec, decode",
    ):
        assert part in said


def test_options_describe_themselves() -> None:
    assert describe_options(Options) == {
        "size": "Pixels a side. Default: 224.",
        "codec": "Of the frames. One of: jpeg, png. Default: jpeg.",
        "decode": "Store frames. One of: yes, no. Default: no.",
    }
    assert describe_options(FormatOptions) == {}
