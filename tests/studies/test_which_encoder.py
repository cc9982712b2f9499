"""A sweep over encoders: each with the study's conditioning, its own refractory period, one rate for all."""

import re
from fractions import Fraction
from math import ceil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from neurotact.data.conditioning import ConditioningSpec, conditioned_length
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import from_rasters
from neurotact.data.windows import WindowSpec, cut
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.model import usable
from neurotact.encoders.specs import load
from neurotact.errors import InputError
from neurotact.spec import read, to_toml
from neurotact.studies import loading, preparation, study
from neurotact.studies.study import value_at

TINY = Path(__file__).parent / "tiny.toml"


def resolved(tmp_path, changes=None, **parts):
    table = {**read(TINY), "quick": {}, **parts}
    (tmp_path / "mine.toml").write_text(to_toml(table), encoding="utf-8")
    found = loading.resolve(tmp_path / "mine.toml", changes or {})
    assert isinstance(found, study.StudySpec)
    return found


def test_encoders_are_swept_by_name_with_their_periods(tmp_path):
    sweep = {"encoder & t_ref_ms": [["sa1-ra1-lif", 5.0], ["send-on-delta", 3.0], ["burst", "own"]], "seed": [0]}
    what = resolved(tmp_path, calibrate=True, spikes_per_s=12.0, sweep=sweep)
    cells = list(study.cells(what))
    assert [value_at(cell, "encoder") for cell in cells] == ["lif", "send-on-delta", "burst"]
    assert [value_at(cell, "t_ref_ms") for cell in cells] == [5.0, 3.0, 0.0]
    assert all(cell.encoder.conditioning == what.encoder.conditioning for cell in cells)
    assert [cell.calibrate.model for cell in cells] == [cell.encoder.model for cell in cells]
    assert all(cell.conditioned_by == what.encoder and cell.spikes_per_s == 12.0 for cell in cells)
    assert len({cell.spikes_name for cell in cells}) == 3


def test_every_stands_for_all_models_that_are_compared(tmp_path):
    axis = "encoder & t_ref_ms"
    found = resolved(tmp_path, sweep={axis: "every", "seed": [0]}).sweep[axis]
    assert {load(name).model for name, _ in found} == set(usable()) - {"mechanoreceptor"}
    periods = {name: [period for other, period in found if other == name] for name, _ in found}
    assert periods["sa1-ra1-lif"] == ["own", 10.0]
    assert periods["burst"] == ["own"]


def test_spikes_of_windows_are_the_same_if_trials_are_encoded_no_further(tmp_path):
    window = {"length_ms": 50.0, "start_ms": 100.0, "per_trial": 2}
    sweep = {"encoder": ["sa1-ra1-lif", "send-on-delta"], "seed": [0]}
    part = [*study.cells(resolved(tmp_path, calibrate=True, window=window, sweep=sweep, past_windows=False))]
    whole = [*study.cells(resolved(tmp_path, calibrate=True, window=window, sweep=sweep))]
    assert [cell.encoded_ms for cell in (*part, *whole)] == [200.0, 200.0, None, None]
    assert part[0].spikes_name != whole[0].spikes_name
    felt = waves()
    for cell in part:
        encoder = cell.encoder.model_copy(update={"conditioning": ConditioningSpec(baseline="start"), "unit": "count"})
        early, late = (encode_recordings(preparation.encoded_part(felt, one), encoder) for one in (cell, whole[0]))
        assert early.raster(early.cut(cell.window)).any()
        np.testing.assert_array_equal(early.raster(early.cut(cell.window)), late.raster(late.cut(cell.window)))


@pytest.mark.parametrize("values", [{"length_ms": [20.0, 50.0]}, {"per_trial": [3, 1]}, {"start_ms": [0.0, 100.0]}])
def test_windows_that_are_swept_share_spikes_that_reach_as_far_as_all_of_them(tmp_path, values):
    """Else those of the first would cut the trials, and later cells would have fewer windows, or none."""
    ((key, swept),) = values.items()
    window = {"length_ms": 50.0, "per_trial": 2, "start_ms": 50.0}
    sweep = {f"window.{key}": swept, "seed": [0]}
    cells = [*study.cells(resolved(tmp_path, window=window, sweep=sweep, past_windows=False))]
    assert len({(cell.spikes_name, cell.encoded_ms) for cell in cells}) == 1
    felt = waves()
    for cell in cells:
        encoder = cell.encoder.model_copy(update={"conditioning": ConditioningSpec(baseline="start"), "unit": "count"})
        early = encode_recordings(preparation.encoded_part(felt, *cells), encoder)
        whole = encode_recordings(felt, encoder)
        np.testing.assert_array_equal(early.raster(early.cut(cell.window)), whole.raster(whole.cut(cell.window)))


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    return resolved(tmp_path_factory.mktemp("short"), past_windows=False)


@given(
    st.sampled_from([35.6, 100.0, 512.0, 2000.0]), st.none() | st.sampled_from([400.0, 1000.0]), st.integers(1, 12),
    st.floats(0, 3), st.floats(1.01, 4), st.none() | st.floats(1.01, 4), st.integers(1, 3),
)  # fmt: skip
def test_no_window_is_lost_that_is_no_whole_number_of_steps(
    short, rate_Hz, own_Hz, per_trial, start, length, hop, more
):
    """After a hop of 1.6 steps each window begins 2 steps after the one before, so that the last one ends later."""
    clock_Hz = own_Hz or rate_Hz
    start_ms, length_ms, hop_ms = (None if one is None else 1e3 * one / clock_Hz for one in (start, length, hop))
    exact = [Fraction(one) * Fraction(clock_Hz) / 1000 for one in (start_ms, length_ms, hop_ms or length_ms)]
    assume(all(abs(one % 1 - Fraction(1, 2)) > 1e-6 for one in exact))
    first, n_steps, after = map(round, exact)
    window = WindowSpec(length_ms=length_ms, start_ms=start_ms, hop_ms=hop_ms, per_trial=per_trial)
    conditioning = ConditioningSpec(baseline="none", resample_Hz=own_Hz)
    encoder = short.encoder.model_copy(update={"conditioning": conditioning})
    cells = [*study.cells(short.model_copy(update={"window": window, "encoder": encoder}))]
    n_samples = ceil((first + (per_trial - 1) * after + n_steps) / clock_Hz * rate_Hz) + more
    felt = Recordings([np.zeros((n_samples, 1))], rate_Hz, "count", pd.DataFrame({"label": ["slow"]}))
    (kept,) = preparation.encoded_part(felt, *cells).lengths.tolist()
    found = cut(np.array([conditioned_length(kept, rate_Hz, own_Hz)]), clock_Hz, window)
    assert found.start.tolist() == [first + number * after for number in range(per_trial)]
    assert found.n_steps == n_steps


@pytest.mark.parametrize("lengths_ms", [(100.0, 20.0), (20.0, 100.0)])
def test_varied_copies_reach_as_far_as_the_longest_of_the_windows_that_are_swept(tmp_path, lengths_ms):
    window, sweep = {"per_trial": 1}, {"window.length_ms": [*lengths_ms], "seed": [0]}
    what = resolved(tmp_path, window=window, sweep=sweep, augmentation={"kind": "gain"})
    cells = [*study.cells(what)]
    assert len({cell.spikes_name for cell in cells}) == 1
    encoder = cells[0].encoder.model_copy(update={"conditioning": ConditioningSpec(baseline="start"), "unit": "count"})
    trains = preparation.spikes_of(cells[-1], waves(), encoder, cells)
    (copies,) = trains.variations.source.blocks(trains.variations.places)
    for cell in cells:
        assert len(copies.cut(cell.window)) == len(copies)


def waves():
    """Trials of some 100 counts."""
    rng, time_s = np.random.default_rng(0), np.arange(800)[:, None] / 2000
    signals = [100 * np.sin(2 * np.pi * 20 * time_s + rng.uniform(0, 6, 3)) for _ in range(4)]
    return Recordings(signals, 2000.0, "count", pd.DataFrame({"label": ["slow", "fast"] * 2}))


def test_windows_that_begin_at_contact_need_whole_trials(tmp_path):
    window = {"length_ms": 50.0, "per_trial": 1, "align": "onset"}
    (cell,) = study.cells(resolved(tmp_path, window=window, sweep={"encoder": ["burst"]}, past_windows=False))
    assert cell.encoded_ms is None


def test_a_period_of_an_encoder_without_one_is_refused(tmp_path):
    with pytest.raises(InputError, match="'burst' has no refractory period"):
        resolved(tmp_path, sweep={"encoder & t_ref_ms": [["burst", 3.0]]})


def test_two_encoders_of_one_model_are_refused(tmp_path):
    with pytest.raises(InputError, match="two encoders have the same model"):
        resolved(tmp_path, sweep={"encoder": ["sa1-ra1-lif", "sa1-ra1-lif-graded"]})


@pytest.mark.parametrize(("encoder", "axis", "values"), [
    ("send-on-delta", "encoder.t_ref_ms", [1, 5, 10]),
    ("resonate-and-fire", "encoder.high.t_ref_ms & encoder.low.t_ref_ms", [[1, 1], [5, 5], [1, 10]]),
    ("burst", None, None),
])  # fmt: skip
def test_pairs_become_the_periods_that_an_encoder_has(encoder, axis, values, tmp_path):
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [5, 5], [1, 10]], "seed": [0]}
    found = resolved(tmp_path, {"encoder": encoder}, sweep=sweep).sweep
    assert found == {**({axis: values} if axis else {}), "seed": [0]}


@pytest.mark.parametrize(("encoder", "given", "axis", "values"), [
    ("send-on-delta", {"encoder.t_ref_ms": 3}, "encoder.t_ref_ms", [3]),
    ("send-on-delta", {"sweep.encoder.t_ref_ms": [2, 4]}, "encoder.t_ref_ms", [2, 4]),
    ("resonate-and-fire", {"sweep.encoder.high.t_ref_ms & encoder.low.t_ref_ms": [[2, 4]]},
     "encoder.high.t_ref_ms & encoder.low.t_ref_ms", [[2, 4]]),
])  # fmt: skip
def test_periods_of_an_encoder_can_be_given(encoder, given, axis, values, tmp_path):
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [5, 5]], "seed": [0]}
    what = resolved(tmp_path, {"encoder": encoder, **given}, sweep=sweep)
    assert what.sweep == {axis: values, "seed": [0]}
    assert study.setting_columns(what) == []


def test_one_period_of_a_pair_is_refused_with_the_pair(tmp_path):
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [5, 5]]}
    with pytest.raises(InputError, match=re.escape("'sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms': [[3, 3]]")):
        resolved(tmp_path, {"encoder.sa1.t_ref_ms": 3}, sweep=sweep)


def test_the_first_population_is_counted_apart_from_the_others():
    """Of ON and OFF as of SA-I and RA-I; the columns of tables have the names of the latter."""
    rasters = np.zeros((1, 5, 2), np.uint8)
    rasters[0, :3, 0] = 1
    for names in (("ON a", "OFF a"), ("SA-I a", "RA-I a")):
        trains = from_rasters(rasters, 1000.0, names, pd.DataFrame({"label": ["felt"]}))
        assert trains.is_sa.tolist() == [True, False]
    only_ra = from_rasters(rasters[..., :1], 1000.0, ("RA-I a",), pd.DataFrame({"label": ["felt"]}))
    assert not only_ra.is_sa.any()
