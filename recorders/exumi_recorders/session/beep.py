"""A beep, for ``[hooks]``: ``["exumi-beep", "880", "0.15"]``.

Frequencies in Hz, each followed by its seconds; 0 Hz is a pause. The tones go to ALSA's ``aplay``.
"""

import io
import math
import subprocess
import sys
import wave
from array import array
from collections.abc import Sequence

__all__ = ["NAME", "PLAYER", "main", "wav"]

NAME = "exumi-beep"
"""As which hooks name it."""
PLAYER = ("aplay", "-q", "-")
"""What plays it."""

_RATE_HZ = 48_000
_LOUD = 0.5
_EDGE_S = 0.005
_MOST_S = 5.0


def wav(tones: Sequence[tuple[float, float]]) -> bytes:
    """Return tones as a WAV file, 16-bit mono.

    Parameters
    ----------
    tones : sequence of (float, float)
        Frequency in Hz and length in seconds of each.
    """
    samples = array("h")
    for hertz, seconds in tones:
        count = round(seconds * _RATE_HZ)
        for i in range(count):
            # Edges that are not sharp: a loudspeaker would click.
            edge = min(1.0, i / (_EDGE_S * _RATE_HZ), (count - 1 - i) / (_EDGE_S * _RATE_HZ))
            samples.append(
                round(32767 * _LOUD * edge * math.sin(2 * math.pi * hertz * i / _RATE_HZ))
            )
    if sys.byteorder == "big":
        samples.byteswap()
    file = io.BytesIO()
    with wave.open(file, "wb") as out:
        out.setnchannels(1)
        out.setsampwidth(2)
        out.setframerate(_RATE_HZ)
        out.writeframes(samples.tobytes())
    return file.getvalue()


def main(arguments: Sequence[str], player: Sequence[str] = PLAYER) -> int:
    """Play what the command line says; return the exit code.

    Parameters
    ----------
    arguments : sequence of str
    player : sequence of str
        The program that takes a WAV file on stdin.
    """
    try:
        numbers = [float(text) for text in arguments]
    except ValueError:
        numbers = []
    tones = list(zip(numbers[::2], numbers[1::2], strict=False))
    is_odd = not numbers or len(numbers) % 2 or not all(0 <= each < math.inf for each in numbers)
    if is_odd or sum(seconds for _, seconds in tones) > _MOST_S:
        sys.stderr.write(f"{__doc__}\nAt most {_MOST_S:g} seconds in all.\n")
        return 2
    try:
        done = subprocess.run(  # noqa: S603  # a list of words; there is no shell
            list(player), input=wav(tones), check=False
        )
    except OSError as error:
        sys.stderr.write(f"{player[0]} cannot be started ({error.strerror})\n")
        return 1
    return done.returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
