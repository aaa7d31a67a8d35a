"""A beep that a hook can make."""

import io
import sys
import wave
from pathlib import Path

import numpy as np
import pytest

from exumi_recorders.session.beep import main, wav


def test_tones_and_pauses() -> None:
    with wave.open(io.BytesIO(wav([(1000.0, 0.1), (0.0, 0.05)]))) as file:
        assert (file.getframerate(), file.getnchannels()) == (48_000, 1)
        samples = np.frombuffer(file.readframes(file.getnframes()), "<i2")
    assert len(samples) == 7200
    assert int(np.abs(np.fft.rfft(samples[:4800])).argmax()) == 100  # of 10 Hz each
    assert not samples[4800:].any()
    # No click at either end.
    assert abs(int(samples[1])) < 200


def test_it_is_given_to_the_player(tmp_path: Path) -> None:
    played = tmp_path / "played.wav"
    copy = f"import pathlib,sys; pathlib.Path({str(played)!r}).write_bytes(sys.stdin.buffer.read())"
    assert main(["880", "0.05"], player=(sys.executable, "-c", copy)) == 0
    assert played.read_bytes() == wav([(880.0, 0.05)])
    assert main(["880", "0.05"], player=("no-such-player",)) == 1


@pytest.mark.parametrize("words", ["", "880", "880 x", "880 -1", "880 6", "nan 1", "1 inf"])
def test_what_it_does_not_understand(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split(), player=("no-such-player",)) == 2
    assert "frequencies" in capsys.readouterr().err.lower()
