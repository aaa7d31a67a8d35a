"""What the data cannot be used for without a second thought, as far as the episodes say it."""

from collections.abc import Iterator

from exumi_data.release.facts import Facts
from exumi_data.release.markdown import amount
from exumi_data.stats import Statistics

__all__ = ["known_limits"]


def known_limits(numbers: Statistics, facts: Facts) -> list[str]:
    """List them as sentences.

    Parameters
    ----------
    numbers : Statistics
    facts : Facts
        Both of the same dataset.
    """
    return [*_times(numbers), *_touch(numbers, facts), *_words(numbers, facts), *_people(facts)]


def _times(numbers: Statistics) -> Iterator[str]:
    stated = [one.name for one in numbers.streams if not one.measured_times and one.n]
    if stated:
        yield (
            f"Times of {', '.join(stated)} were not measured: they follow from the rate that the "
            "source states."
        )
    gappy = [f"{one.name} ({one.gaps:,})" for one in numbers.streams if one.gaps]
    if gappy:
        yield f"There are gaps in: {', '.join(gappy)}."


def _touch(numbers: Statistics, facts: Facts) -> Iterator[str]:
    if numbers.active.unmeasured:
        yield f"Activity was not measured in {amount(numbers.active.unmeasured, 'episode')}."
    guessed = sum(count for (_, how), count in facts.references.items() if how == "selected")
    if guessed:
        yield (
            f"In {amount(guessed, 'tactile stream')} the image without contact was chosen from the "
            "stream's own frames."
        )
    lacking = sum(count for (_, how), count in facts.references.items() if not how)
    if lacking:
        yield f"Without an image without contact: {amount(lacking, 'tactile stream')}."


def _words(numbers: Statistics, facts: Facts) -> Iterator[str]:
    simulated = sum(count for (kind, *_), count in facts.sources.items() if kind == "simulated")
    if simulated:
        yield f"Simulated, and measured by no sensor: {amount(simulated, 'episode')}."
    lacking: dict[int, list[str]] = {}
    for label in numbers.labels:
        lacking.setdefault(label.missing, []).append(label.property)
    for count, names in sorted(lacking.items()):
        if count:
            yield f"Without a value of {', '.join(names)}: {amount(count, 'episode')}."
    unknown = numbers.content.licences.get("NOASSERTION", 0)
    if unknown:
        yield f"The licence of {amount(unknown, 'episode')} is not known."
    if numbers.unreadable:
        yield f"Unreadable: {amount(len(numbers.unreadable), 'episode')}."


def _people(facts: Facts) -> Iterator[str]:
    kinds = {stream.kind for stream in facts.streams}
    if "rgb" in kinds:
        yield "What the cameras show was not looked at: there may be people in it."
    if "audio" in kinds:
        yield "What the microphones recorded was not listened to: there may be voices in it."
