"""What taxels felt and how loud it was: the figures, and their cards on the page."""

from pathlib import Path

import numpy as np
import pytest

from exumi_data.episode import open_episode
from exumi_data.errors import DamagedDataError
from exumi_data.stats import measure
from exumi_data.stats.html import page_of
from exumi_data.stats.html.reading import read_figures
from exumi_data.stats.html.sound_figures import SoundTotal
from exumi_data.stats.html.taxel_figures import TaxelTotal
from exumi_data.store.episode_writer import EpisodeWriter
from tests.exumi_data.builders import CLOCK, metadata

ALIVE = np.array([[True, True, False], [True, True, True]])
TIME = np.arange(80, dtype=np.int64) * 50_000_000


@pytest.fixture(scope="module")
def felt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell that is pressed in the second half, and a dead one; noise, silence, a loud block."""
    path = tmp_path_factory.mktemp("felt") / "felt.zarr"
    values = np.full((80, 2, 3), 3500, np.int16)
    values[40:, 1, 2] -= 600
    values[:, 0, 2] = -7
    flags = np.zeros(80, np.uint32)
    flags[79] = 1 << 3
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        pads = writer.add_stream(
            "pads", kind="taxels", clock=CLOCK, grid=[2, 3], unit="adc", sign=-1, offset=3500.0
        )
        pads.append(TIME, values, flags=flags)
        pads.set_valid(ALIVE)
        writer.add_stream("bare", kind="taxels", clock=CLOCK, grid=[2, 3], unit="adc")
        mic = writer.add_stream("mic", kind="audio", clock=CLOCK, rate="8000", channels=2)
        loud = np.zeros((80, 400, 2), np.int16)
        loud[40:] = 3277  # -20 dB
        loud[79, :4, 1] = 32767
        mic.append(TIME, list(loud))
        quiet = writer.add_stream("quiet", kind="audio", clock=CLOCK, rate="8000", channels=1)
        quiet.append(TIME, [np.zeros((9, 1), np.int16)] * 80)
    return path


def test_figures_of_taxels(felt: Path) -> None:
    with open_episode(felt) as episode:
        bare, pads = sorted(read_figures(episode).taxels, key=lambda one: one.stream)
    assert sum(bare.samples) == 0
    total = TaxelTotal(pads.unit, pads.grid)
    total.add(pads)
    total.add(pads)
    assert total.left_out == 2
    assert total.peak == 600
    assert total.means[1, 2] == pytest.approx(600 * 39 / 79)
    assert np.count_nonzero(total.means) == 1
    assert (total.alive == ALIVE).all()
    assert total.over_time == [0.0] * 20 + [600.0] * 20


def test_figures_of_sound(felt: Path) -> None:
    with open_episode(felt) as episode:
        mic, quiet = sorted(read_figures(episode).sounds, key=lambda one: one.stream)
    assert (mic.clipped, quiet.clipped) == (4, 0)
    total = SoundTotal()
    total.add(mic)
    assert total.over_time[:20] == [-96.0] * 20
    assert total.over_time[20:-1] == pytest.approx([-20.0] * 19, abs=0.01)
    assert total.level_db == pytest.approx(-23.0, abs=0.2)


def test_blocks_that_are_longer_than_what_is_read_at_once(
    felt: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_episode(felt) as episode:
        whole = read_figures(episode).sounds
        monkeypatch.setattr("exumi_data.stats.html.sound_figures._CHUNK", 2 * 333)
        in_parts = read_figures(episode).sounds
    for one, other in zip(whole, in_parts, strict=True):
        assert (one.values, one.clipped) == (other.values, other.clipped)
        assert one.squares == pytest.approx(other.squares)


def test_the_page_of_an_episode(felt: Path) -> None:
    with open_episode(felt) as episode:
        page = page_of(episode, measure(episode))
    assert "Most in row 2, column 3: 296 adc in the mean" in page
    assert "Crossed out: 1 dead cell. 1 sample without a valid value." in page
    assert "All cells together feel 0 to 600 adc." in page
    assert "What bare felt" in page
    assert "loudest −20 dB" in page or "loudest −1" in page
    assert "4 samples at the end of the scale" in page
    assert "All of it is silence" in page
    assert 'href="#sound"' in page


def test_a_grid_that_is_too_large_to_be_drawn_is_named(
    felt: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("exumi_data.stats.html.taxel_figures.MOST_CELLS", 5)
    with open_episode(felt) as episode:
        figures = read_figures(episode)
        page = page_of(episode, measure(episode))
    assert (figures.taxels, sorted(figures.large_taxels)) == (
        (),
        [("bare", (2, 3)), ("pads", (2, 3))],
    )
    assert "What pads felt" in page
    assert "Its 2 × 3 cells are not drawn" in page


def test_a_mask_that_does_not_fit(felt: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_episode(felt) as episode:
        monkeypatch.setattr(
            "exumi_data.episode.StreamView.valid", property(lambda _: np.ones((3, 3), np.bool_))
        )
        with pytest.raises(DamagedDataError, match="not 2x3"):
            read_figures(episode)
