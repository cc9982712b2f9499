"""Windows as arrays: what X, y and groups hold, and that a split never divides a trial."""

import pickle
from copy import copy, deepcopy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import train_test_split

import neurotact as nt
from neurotact.data.spikes import from_rasters
from neurotact.data.windowed import SpikeArray, windows
from neurotact.errors import InputError


def trains(n_trials: int = 40, n_steps: int = 50):
    rng = np.random.default_rng(0)
    rasters = (rng.random((n_trials, n_steps, 4)) < 0.2).astype(np.uint8)
    conditions = pd.DataFrame(
        {"label": np.tile(["felt", "silk"], n_trials // 2), "force_N": np.arange(n_trials) % 4 // 2}
    )
    names = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")
    return from_rasters(rasters, 1000.0, names, conditions), rasters


def test_windows_hold_the_spikes_the_class_and_the_trial_of_each():
    spikes, rasters = trains()
    data = windows(spikes, nt.Window(length_ms=20, start_ms=5, hop_ms=10))
    assert data.X.shape == (40 * 3, 20, 4)
    assert data.X.sampling_rate_Hz == 1000.0
    for at in (0, 1, 119):
        trial, start = data.groups[at], data.start_steps[at]
        assert (data.X[at] == rasters[trial, start : start + 20]).all()
        assert data.y[at] == spikes.conditions["label"][trial]
    assert data.start_steps[:3].tolist() == [5, 15, 25]


@given(st.integers(0, 2**32 - 2))
def test_a_split_puts_each_trial_on_one_side_and_loses_no_window(seed):
    data = windows(trains()[0], nt.Window(length_ms=20))
    sides = data.split(nt.Split(seed=seed))
    groups = [set(side.groups.tolist()) for side in sides]
    assert sum(map(len, groups)) == len(set.union(*groups))
    assert sum(map(len, sides)) == len(data)
    assert all(set(side.y) == {"felt", "silk"} for side in sides)
    assert data.split(nt.Split(seed=seed)).test.groups.tolist() == sides.test.groups.tolist()


def test_a_split_balances_the_conditions_that_are_named():
    sides = windows(trains(80)[0], nt.Window(length_ms=20)).split(nt.Split(seed=0, stratify=["force_N"]))
    forces = sides.test.trains.conditions["force_N"].to_numpy()[sides.test.groups]
    assert np.bincount(forces).min() >= 0.4 * len(forces)


def test_a_split_leaves_trials_of_a_tested_value_aside_where_asked():
    spikes, _ = trains(80)
    table = spikes.conditions.assign(speed=np.arange(80) % 8 // 4)
    data = windows(replace(spikes, conditions=table), nt.Window(length_ms=20))
    sides = data.split(nt.Split(seed=0, test_where={"force_N": 1, "speed": 1}, leave_aside=True))
    seen = table.loc[np.unique(sides.train.groups), ["force_N", "speed"]]
    assert len(seen)
    assert (seen == 0).all(axis=None)
    with pytest.raises(InputError, match="leave_aside"):
        data.split(nt.Split(seed=0, test_where={"speed": 1}, leave_aside=True))


def test_trials_without_an_onset_are_warned_of():
    spikes, _ = trains(40, 300)
    with pytest.warns(UserWarning, match="38 of 40 trials have no onset of contact"):
        windows(spikes, nt.Window(length_ms=20, align="onset"))


def test_windows_are_chosen_by_mask_or_index_and_shown_in_a_notebook():
    data = windows(trains(4)[0], nt.Window(length_ms=20))
    chosen = data.select([7, 0])
    assert (data.X[[7, 0]] == chosen.X).all()
    assert chosen.y.tolist() == [data.y[7], data.y[0]]
    with pytest.raises(InputError, match=r"select: the mask has the shape \(1,\) where there are 8 windows"):
        data.select([True])
    assert "windows of each class" in data._repr_html_()
    assert "felt: 4, silk: 4" in data._repr_html_()


def test_the_clock_survives_indexing_splitting_and_pickling():
    X = SpikeArray.of(np.eye(6, dtype=np.uint8).reshape(6, 3, 2), 500.0)
    held, _ = train_test_split(X, test_size=2, random_state=0)
    copies = pickle.loads(pickle.dumps(X)), X.copy(), copy(X), deepcopy(X), X.astype(float), X > 0, 2 * X, X + X[0]
    for part in (X[1:3], X[[0, 2]], X[np.arange(6) > 2], np.take(X, [2, 0], axis=0), held, *copies):
        assert part.sampling_rate_Hz == 500.0
    assert (X + SpikeArray.of(np.asarray(X), 250.0)).sampling_rate_Hz is None
    assert type(np.asarray(X)) is np.ndarray


@pytest.mark.parametrize("wrong", [None, "spikes.h5", np.zeros((2, 3, 4))])
def test_another_type_is_refused_with_the_fix(wrong):
    with pytest.raises(InputError, match=r"as nt\.encode returns them"):
        windows(wrong)


def test_a_window_that_fits_no_trial_is_refused():
    with pytest.raises(InputError, match="shorten the window"):
        windows(trains()[0], nt.Window(length_ms=60))
    with pytest.raises(InputError, match="length_ms"):
        windows(trains()[0], nt.Window(length_ms=-1))


NAMES = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")


@given(st.integers(0, 30), st.integers(1, 40), st.integers(-4, 4).filter(bool))
def test_a_slice_of_the_time_has_the_clock_and_the_window_of_its_steps(first, length, step):
    X = windows(trains(4)[0], nt.Window(length_ms=40, start_ms=5, hop_ms=3)).X
    part = X[:, first : first + length : step] if step > 0 else X[:, first + length : first : step]
    assert part.sampling_rate_Hz == 1000.0 / abs(step)
    assert part.origin.afferents == NAMES
    if step == 1:
        n_steps = part.shape[1]
        assert part.origin.window.length_ms == pytest.approx(n_steps)
        assert part.origin.window.start_ms == pytest.approx(5 + first)
        assert part.origin.window.hop_ms == 3
    elif part.shape != X.shape:
        assert part.origin.encoder is part.origin.window is None


@pytest.mark.parametrize(
    "other",
    [
        lambda X: X.reshape(len(X), 5, 4, 4).max(2),
        lambda X: np.repeat(X, 2, axis=1),
        lambda X: X[:, [0, 3, 7]],
        lambda X: X[:, 3],
        lambda X: X[:, None],
        lambda X: X[X[..., 0] > 0],
        lambda X: np.concatenate([X, X], axis=2),
        lambda X: X.sum(1),
        lambda X: X[[0, 1], :, [0, 1]],
        lambda X: X[:, :4].swapaxes(1, 2),
        lambda X: X[:4, :4].T,
        lambda X: np.roll(X, 1, axis=2),
        lambda X: np.sort(X, axis=1),
        lambda X: np.take(X, np.arange(20)[::-1], axis=1),
        lambda X: X @ np.eye(4)[::-1],
        lambda X: X.dot(np.eye(4)[::-1]),
        lambda X: X.reshape(len(X), 4, 20).reshape(X.shape),
        lambda X: np.ma.masked_array(X, X > 0)[:, ::4],
    ],
)
def test_other_steps_or_afferents_have_no_clock(other):
    part = other(windows(trains(4)[0], nt.Window(length_ms=20)).X)
    assert getattr(part, "sampling_rate_Hz", None) is getattr(part, "origin", None) is None


@pytest.mark.parametrize("key", [[3, 1], slice(None, None, -1), np.array([True, False, True, True])])
def test_chosen_afferents_keep_their_names_and_not_the_encoder(key):
    X = windows(trains(4)[0], nt.Window(length_ms=20)).X
    part = X[..., key]
    assert part.origin.afferents == tuple(np.array(NAMES)[key])
    assert (part.sampling_rate_Hz, part.origin.encoder) == (1000.0, None)
    assert X[1:, :, :].origin is X.origin
    assert (X + X[..., ::-1]).origin is None
    if isinstance(key, list):
        assert np.take(X, key, axis=-1).origin == part.origin
