"""ST-MNIST: matrices of -1, 0 and 1 with a row of times, by its own reader, by events, and refused as signals."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.readers.events.signed_matrix import holds_events

import neurotact as nt
from neurotact.data.dataset import expand
from neurotact.errors import InputError

SAMPLE = expand("$NEUROTACT_DATA/st-mnist-sample/LUT_1.mat")
TIMES = np.array([0.1, 0.1000001, 0.25, 0.3])


def matrix(n_taxels: int = 100) -> np.ndarray:
    """One event a column: ON of taxel 0 twice, OFF of taxel 2, ON of taxel 98; the last taxel is silent."""
    made = np.zeros((n_taxels + 1, 4))
    made[[0, 0, 2, n_taxels - 2], range(4)] = 1, 1, -1, 1
    made[-1] = TIMES
    return made


def written(folder: Path, made: np.ndarray, digits: str = "17") -> Path:
    for number, digit in enumerate(digits):
        (folder / digit).mkdir(exist_ok=True)
        shifted = made.copy()
        shifted[-1] += 0.05 * number  # no copies
        scipy.io.savemat(folder / digit / f"LUT_{number}.mat", {"spiketrain": shifted})
    return folder


def test_each_entry_is_an_event_of_its_taxel_polarity_and_time(tmp_path: Path):
    trains = nt.read("st-mnist", written(tmp_path, matrix()))
    assert len(trains.afferents) == 200
    assert trains.sampling_rate_Hz == 1000.0
    assert trains.conditions["label"].tolist() == ["1", "7"]
    named = [(int(step), trains.afferents[unit]) for step, unit in zip(trains.steps[0], trains.units[0], strict=True)]
    assert named == [(100, "ON taxel1"), (250, "OFF taxel3"), (300, "ON taxel99")]  # a burst is one spike


def test_events_read_the_same_files(tmp_path: Path):
    folder = written(tmp_path, matrix(6))
    trains = nt.read_events(folder, events=nt.Events(merge_events=True))
    assert len(trains.afferents) == 12  # the silent taxel is one, too
    assert [row.tolist() for row in trains.steps] == [[100, 250, 300], [150, 300, 350]]
    with pytest.raises(InputError, match="give a folder that holds a folder of such files per class"):
        nt.read_events(folder / "1" / "LUT_0.mat")


def _rising_down(made: np.ndarray) -> np.ndarray:
    made[-1] = made[-1][::-1]
    return made


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda made: np.vstack([made[:1], made]), "has 102 rows, not 100 taxels and a time"),
        (lambda made: made[:-1], "where a matrix of -1, 0 and 1 with the times of its columns"),
        (_rising_down, "where a matrix of -1, 0 and 1 with the times of its columns"),
        (lambda made: made.T, "is expected; turn it"),
        (lambda made: made * [[2]] * 100 + [[1]], "where a matrix of -1, 0 and 1"),
    ],
)
def test_a_file_that_differs_is_refused(tmp_path: Path, change, said: str):
    with pytest.raises(InputError, match=said):
        nt.read("st-mnist", written(tmp_path, change(matrix())))


def test_a_folder_that_is_no_digit_or_all_digits_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="is the folder of one digit"):
        nt.read("st-mnist", written(tmp_path, matrix()) / "7")
    (tmp_path / "7").rename(tmp_path / "seven")
    with pytest.raises(InputError, match="the folder 'seven' is no digit"):
        nt.read("st-mnist", tmp_path)


def test_it_is_never_read_as_signals(tmp_path: Path):
    with pytest.raises(InputError, match="events, not samples; read it with neurotact import events"):
        nt.read_folder(written(tmp_path, matrix()), 1000.0, "V")


@examples(20)
@given(st.integers(2, 6), st.integers(2, 8), st.integers(0, 2**32 - 1))
def test_signals_are_not_taken_for_events(n_rows: int, n_columns: int, seed: int):
    signals = np.random.default_rng(seed).normal(size=(n_rows, n_columns))
    assert not holds_events(signals)
    assert not holds_events(np.sign(signals))


@pytest.mark.skipif(not SAMPLE.exists(), reason="the sample of ST-MNIST is not at $NEUROTACT_DATA/st-mnist-sample")
def test_the_published_file(tmp_path: Path):
    for digit in "12":
        (tmp_path / digit).mkdir()
        (tmp_path / digit / "LUT_1.mat").write_bytes(SAMPLE.read_bytes())
    trains = nt.read("st-mnist", tmp_path, step_ms=0.01)
    published = scipy.io.loadmat(SAMPLE)["spiketrain"]
    channel, column = published[:-1].nonzero()
    population = np.where(published[channel, column] > 0, 100, 0)
    expected = {*zip((published[-1, column] * 1e5).astype(int).tolist(), (population + channel).tolist(), strict=True)}
    assert {*zip(trains.steps[0].tolist(), trains.units[0].tolist(), strict=True)} == expected
    assert len(trains.afferents) == 200
    assert trains.trial_steps.tolist() == [89575, 89575]
