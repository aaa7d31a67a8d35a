"""The numbers that the text of signal quality states are those that are judged by."""

from pathlib import Path

import pytest

from exumi_data.standard import rules
from exumi_data.synchronisation import events, taps, touches
from exumi_validators import curves, episode_run


def power_of_two(value: int) -> str:
    """A power of two as the text writes it: 2 and its exponent, raised."""
    assert value.bit_count() == 1
    return "2" + str(value.bit_length() - 1).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))


TOUCH = {code: rule.limits for code, rule in rules().items() if rule.group == "TACT"}
WORDS: dict[float, str] = {2: "two", 4: "four", 8: "eight", 9: "nine"}
STATED = {
    "quality.md": [
        f"never below {touches._FLOOR_S * 1e3:g} ms for grasps and {taps._FLOOR_S * 1e3:g} ms",
        f"square of {touches._FLOOR_S * 1e3:g} ms (grasps) or {taps._FLOOR_S * 1e3:g} ms (taps)",
        f"first {power_of_two(curves._MOST_SAMPLES)} samples",
        f"above {events._QUIET:g} and above {events._QUIET_SHARE:.0%} of".replace("%", " %"),
        f"at least {events._LEAST_FRAMES} such frames with {events._LEAST_QUIET} quiet frames",
        f"median activity, at least {events._LEAST_LEVEL:g}",
        f"up to {events._QUIET_FRAMES} quiet frames before it to its first frame of "
        f"{events._TOP:g} levels",
        f"longer than {events._GAP_PERIODS:g} median intervals",
        f"width stays within {events._STILL_M * 1e3:g} mm",
        f"three times the smallest one{'' if events._JUMP_UNITS == 3 else '?'}",
        f"more than {touches._MOST_TOUCHES}, {taps._MOST_TAPS} evenly spread",
        f"from {taps._AROUND_NS / 1e6:g} ms before the first frame",
        f"from −{touches._REACH_S:g} s to {touches._REACH_S:g} s",
        f"{touches._COARSE_S * 1e3:g} ms apart, then {touches._FINE_S * 1e3:g} ms apart",
        f"one of {touches._CONTACT_STEPS} moments, evenly from {touches._EARLY_S * 1e3:g} ms",
        "(*d* + {:g}) + *f*₂ · 4 *d* / (*d* + {:g})".format(*touches._BENDS),
        f"1 / ({touches._ERROR:g} + {touches._ERROR_SHARE:g} *a*)",
        f"(*ρ*² + {touches._LEAST_RESIDUAL:g}²) / *c* + ({touches._MISMATCH_M * 1e6:g} µm / *v*)²",
        f"*ρ* is above {touches._MOST_RESIDUAL:g}",
        f"less than {touches._LEAST_TRAVEL_M * 1e3:g} mm long, or σ is above "
        f"{touches._MOST_SIGMA_S * 1e3:g} ms",
        f"about {TOUCH['TACT-011']['rows']} rows of each".capitalize(),
        f"{WORDS[TOUCH['TACT-011']['apart_px']]} apart in a row",
        f"{WORDS[TOUCH['TACT-006']['parts']]} parts give a frame each".capitalize(),
        f"{WORDS[TOUCH['TACT-011']['active_parts']]} parts give the frame of most",
        f"{WORDS[TOUCH['TACT-011']['parts']]} parts the middle one",
        f"√(height · width / {TOUCH['TACT-006']['thumbnail_pixels']}), at least 1",
        f"a grid of {TOUCH['TACT-012']['columns']} by {TOUCH['TACT-012']['rows']}",
    ],
    "dataset.md": [f"among the first {episode_run._MOST_LABELS} labels of each"],
}


@pytest.mark.parametrize(("page", "words"), [(p, w) for p, found in STATED.items() for w in found])
def test_a_number_is_that_of_the_program(spec: Path, page: str, words: str) -> None:
    text = " ".join((spec / "1.0" / page).read_text("utf-8").split())
    assert words in text
