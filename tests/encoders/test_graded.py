"""Several afferents a taxel: each is a plain one of its own gain, and all keep the laws of plain ones."""

from functools import partial
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from test_afferents import RATE_HZ, in_pieces, touches
from test_calibration import RULE, slides

from neurotact import spec as specs
from neurotact.backend import native
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import populations_of
from neurotact.encoders import calibration, firing
from neurotact.encoders.afferents import AfferentSpec, encode
from neurotact.encoders.alternatives import compare
from neurotact.encoders.calibration import calibrate
from neurotact.encoders.cost import encoding_cost
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.specs import afferent_names, n_afferents, taxels_of
from neurotact.errors import InputError

load = partial(specs.load, AfferentSpec)
BACKENDS = ["reference", *(["native"] if native else [])]
grades = st.lists(st.sampled_from([0.1, 0.3, 0.7, 1.0, 1.5, 4.0]), min_size=1, max_size=4, unique=True).map(
    lambda values: sorted(values) if len(values) > 1 else [1.0]
)


def spec(sa1=(1.0,), ra1=(1.0,), *, opposite=False, **changes) -> AfferentSpec:
    table = {
        "sa1": {"gain": 3.2, "t_ref_ms": 1.0, "grades": sa1, "opposite": opposite},
        "ra1": {"gain": 16.0, "t_ref_ms": 5.0, "grades": ra1},
    }
    return specs.build(AfferentSpec, specs.override(table, changes), "a test")


@pytest.mark.parametrize("backend", BACKENDS)
@given(signal=touches(), sa1=grades, ra1=grades, opposite=st.booleans())
@examples(30)
def test_each_population_is_a_plain_one_whose_gain_is_multiplied(backend, signal, sa1, ra1, opposite):
    whole, state = encode(signal, RATE_HZ, spec(sa1, ra1, opposite=opposite), backend=backend)
    n = signal.shape[2]
    parts = iter(np.split(whole, whole.shape[2] // n, axis=2))
    membranes = iter(np.split(state.sa1.membrane_mV, state.sa1.membrane_mV.shape[1] // n, axis=1))
    for sign in (1, -1)[: 1 + opposite]:
        for grade in sa1:
            alone, after = encode(sign * signal, RATE_HZ, spec(**{"sa1.gain": 3.2 * grade}), backend=backend)
            assert np.array_equal(next(parts), alone[..., :n])
            assert np.array_equal(next(membranes), after.sa1.membrane_mV)
    for grade in ra1:
        alone, _ = encode(signal, RATE_HZ, spec(**{"ra1.gain": 16.0 * grade}), backend=backend)
        assert np.array_equal(next(parts), alone[..., n:])
    assert next(parts, None) is None


@given(signal=touches(), sa1=grades, ra1=grades, opposite=st.booleans(), cuts=st.lists(st.floats(0, 1), max_size=3))
@examples(30)
def test_pieces_equal_the_whole_by_the_kernel_and_by_the_definition(signal, sa1, ra1, opposite, cuts):
    encoder = spec(sa1, ra1, opposite=opposite)
    whole, _ = encode(signal, RATE_HZ, encoder, backend="reference")
    assert np.array_equal(in_pieces(signal, encoder, cuts)[0], whole)


@given(signal=touches(), sa1=grades)
@examples(20)
def test_a_signal_and_its_negative_swap_the_polarities(signal, sa1):
    n, encoder = signal.shape[2] * len(sa1), spec(sa1, opposite=True)
    one, other = (encode(each, RATE_HZ, encoder)[0] for each in (signal, -signal))
    assert np.array_equal(one[..., :n], other[..., n : 2 * n])
    assert np.array_equal(one[..., n : 2 * n], other[..., :n])
    assert np.array_equal(one[..., 2 * n :], other[..., 2 * n :])


def test_one_grade_is_the_plain_encoder():
    plain, graded = (load("sa1-ra1-lif", changes) for changes in ({}, {"sa1.grades": [1.0]}))
    assert plain == graded
    two = load("sa1-ra1-lif", {"sa1.grades": [1.0, 2.0], "sa1.opposite": True})
    assert two.model_dump(mode="json")["sa1"]["grades"] == [1.0, 2.0]
    assert len({plain.digest(), two.digest(), load("sa1-ra1-lif", {"sa1.opposite": True}).digest()}) == 3


@given(
    taxels=st.lists(st.text("ab x12.", min_size=1, max_size=6), min_size=1, max_size=4, unique=True),
    sa1=grades, ra1=grades, opposite=st.booleans(),
)  # fmt: skip
def test_names_are_unique_and_keep_their_populations(taxels, sa1, ra1, opposite):
    encoder = spec(sa1, ra1, opposite=opposite)
    names = afferent_names(taxels, encoder.model_dump())
    n_sa1 = len(taxels) * len(sa1) * (1 + opposite)
    assert len(set(names)) == len(names) == n_afferents(encoder, len(taxels))
    assert {kind: its.tolist() for kind, its in populations_of(names).items()} == {
        "SA-I": list(range(n_sa1)), "RA-I": list(range(n_sa1, len(names)))
    }  # fmt: skip
    assert taxels_of(len(names), encoder.model_dump(mode="json")) == len(taxels)


def test_names_stand_in_the_order_of_the_columns():
    """A taxel alone in touch: what fires is what bears its name, the strongest grade most."""
    skin = Recordings([np.array([[0.0, 4.0]] * 400)], 2000.0, "mV", pd.DataFrame({"label": ["felt"]}), ("a", "b"))
    encoder = load("sa1-ra1-lif-graded", {"conditioning.baseline": "none", "conditioning.ema_cutoff_Hz": 100})
    trains = encode_recordings(
        skin, encoder.model_copy(update={"sa1": encoder.sa1.model_copy(update={"opposite": True})})
    )
    counts = dict(zip(trains.afferents, np.bincount(trains.units[0], minlength=len(trains.afferents)), strict=True))
    fired = {name: int(count) for name, count in counts.items() if count}
    assert [*fired] == ["SA-I b rising x1", "SA-I b rising x2"]
    assert fired["SA-I b rising x2"] > fired["SA-I b rising x1"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sa1.grades": [2.0, 1.0]}, "must rise from each to the next"),
        ({"sa1.grades": [1.0, 1.0]}, "must rise from each to the next"),
        ({"sa1.grades": [0.0, 1.0]}, "must be > 0"),
        ({"sa1.grades": []}, "at least 1 value"),
        ({"sa1.grades": [0.1 * k for k in range(1, 18)]}, "at most 16 items"),
        ({"sa1.grades": [2.0]}, "change the gain"),
        ({"ra1.opposite": True}, "rise and fall drive RA-I equally"),
        ({"sa1.opposite": True, "conditioning.rectify": True}, "no signal is below zero"),
    ],
)
def test_what_no_taxel_can_have_is_refused(changes, message):
    with pytest.raises(InputError, match=message):
        load("sa1-ra1-lif", changes)


# --- calibration ----------------------------------------------------------------------------------


def test_calibration_sets_thresholds_at_even_quantiles_of_what_is_felt():
    recordings = slides()
    start = load("sa1-ra1-lif-graded", {"conditioning.baseline": "none", "ra1.grades": [1.0, 2.0]})
    plain = load("sa1-ra1-lif", {"conditioning.baseline": "none"})
    found, alone = (calibrate(recordings, each, rule=RULE).encoder for each in (start, plain))
    assert (found.sa1.gain, found.ra1.gain) == (alone.sa1.gain, alone.ra1.gain)
    assert (len(found.sa1.grades), len(found.ra1.grades)) == (4, 2)
    # Of all trials, not of the stretches that calibration drew: they last less than a second, so that they are whole.
    how = found.conditioning
    felt = np.concatenate([(x - np.array(how.offset)) / np.array(how.scale) for x in recordings.signals])
    thresholds = 10.0 / (found.sa1.gain * np.array(found.sa1.grades[::-1]))
    shares = [(felt[felt > 0] < each).mean() for each in thresholds]
    assert shares == pytest.approx([1 / 8, 3 / 8, 5 / 8, 7 / 8], abs=0.05)


def test_calibration_of_both_polarities_puts_zero_at_the_mean():
    recordings = slides()
    start = load("sa1-ra1-lif-polarities", {"conditioning.baseline": "none"})
    found = calibrate(recordings, start, rule=RULE)
    how = found.encoder.conditioning
    felt = np.concatenate([(x - np.array(how.offset)) / np.array(how.scale) for x in recordings.signals])
    assert abs(felt.mean()) < 0.1
    assert found.encoder.sa1.opposite
    counts = np.zeros(9, np.int64)
    for units in encode_recordings(recordings, found.encoder).units:
        counts += np.bincount(units, minlength=9)
    rising, falling = counts[:3].sum(), counts[3:6].sum()
    assert 0.5 < rising / falling < 2  # sines: as much above their mean as below


def test_grades_that_would_be_equal_are_left_out():
    start = load("sa1-ra1-lif")
    felt = np.array([1.0] * 90 + [2.0] * 10)
    assert calibration._fit_grades(felt, start, gain=5.0, n_grades=4) == (2.0,)
    assert calibration._fit_grades(np.array([]), start, gain=5.0, n_grades=4) == (1.0,)
    assert len(calibration._sample([np.ones((1000, 7))] * 1001, 7_007_000)) <= 1.01 * calibration._MOST_VALUES


@given(st.lists(st.integers(-2, 2), min_size=1, max_size=30), st.integers(1, 40))
@examples(20)
def test_grades_are_of_the_positive_values_alone(values, most):
    drive, every = np.array(values, float)[:, None], -(-len(values) // most)
    with patch.object(calibration, "_MOST_VALUES", most):
        found = calibration._sample([drive, drive[1:]], len(values))
    wanted = [x for part in (values, values[1:]) for x in part[::every] if x > 0]
    assert found.tolist() == wanted


def test_compared_polarities_need_an_encoder_of_one():
    with pytest.raises(InputError, match="this encoder has both"):
        compare(slides(), load("sa1-ra1-lif-polarities"), rule=RULE)


# --- what tells of afferents ------------------------------------------------------------------------


def test_afferents_at_rest_bear_their_names():
    encoder = spec((0.5, 1.0), opposite=True, **{"conditioning.baseline": "none"})
    table = firing.resting_table(slides(), encoder)
    assert table["afferent"].tolist() == list(afferent_names(slides().channels, encoder.model_dump()))


def test_a_silent_type_is_named_whatever_the_number_of_its_afferents():
    counts = np.array([0, 0, 0, 0, 3, 0])  # of two taxels: four SA-I, then two RA-I
    said = list(firing.complaints(counts, 1000, 1000.0, spec((0.5, 1.0))))
    assert [each.split(";")[0] for each in said] == ["no SA-I afferent fires in any trial"]
    assert not list(firing.complaints(np.array([0, 0, 0, 3, 0, 3]), 1000, 1000.0, spec((0.5, 1.0))))


def test_the_ledger_counts_every_afferent_by_hand():
    # A taxel and ten steps: 2 x 4 SA-I and 1 RA-I of 2 MACs and a test each; a difference and an absolute value.
    encoder = spec((0.5, 1.0, 2.0, 4.0), opposite=True).model_dump(mode="json")
    found = encoding_cost(1, 10, 10.0, encoder)
    assert (found.macs, found.acs, found.other_flops, found.parameters) == (180, 10, 100, 9)
    assert found.bytes == 4 * (9 + 9 * 2 + 1)
