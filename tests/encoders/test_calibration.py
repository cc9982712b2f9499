"""Laws of calibration: what gains must not depend on, what they must keep, and what is refused."""

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from levels import thinned
from made_recordings import made, most_held
from neurotact_parts.studies.texture import reader as fabricslide

import neurotact as nt
from neurotact import spec as specs
from neurotact.data import conditioning, spool
from neurotact.data.hdf5 import open_recordings, save_recordings
from neurotact.data.recordings import Recordings
from neurotact.data.splits import SplitSpec, split_conditions
from neurotact.encoders import gain_search
from neurotact.encoders.afferents import POPULATIONS, AfferentSpec
from neurotact.encoders.calibration import (
    GRADES,
    Calibration,
    _AtRest,
    _of_baselines,
    _of_polarities,
    _wakes,
    calibrate,
    calibrate_causally,
    calibration_for,
    with_opposite,
)
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.excerpts import Excerpts, cut, draw, liveliest, numbers_of, permuted
from neurotact.encoders.gain_search import CalibrationRule
from neurotact.encoders.specs import load
from neurotact.errors import InputError
from neurotact.figures.calibration import draw_calibration
from neurotact.figures.style import save
from neurotact.metrics.linear import cross_validated_accuracy, folds_of

DATA = Path(os.environ.get("NEUROTACT_DATA", Path(__file__).parents[3] / "shared" / "data"))
RULE = CalibrationRule(candidates=11, step=1.6, excerpt_s=0.5, trials_per_class=8)
SPEC = specs.load(AfferentSpec, "sa1-ra1-lif")
SHIPPED = "fabric-sa1-ra1-lif"


def slides(frequencies_Hz=(3.0, 12.0), trials=8, unit="mV", rate_Hz=1000.0) -> Recordings:
    """Sines of one frequency a class under three taxels, of random phase, with noise."""
    rng = np.random.default_rng(1)
    time_s = np.arange(0, 0.7, 1 / rate_Hz)
    signals, labels = [], []
    for index, frequency_Hz in enumerate(frequencies_Hz):
        for _ in range(trials):
            wave = np.sin(2 * np.pi * (frequency_Hz * time_s + rng.uniform()))[:, None] * [10.0, 6.0, 3.0]
            signals.append(wave + rng.normal(0, 0.2, wave.shape))
            labels.append(f"class {index}")
    return Recordings(signals, rate_Hz, unit, pd.DataFrame({"label": labels}))


@pytest.fixture(scope="module")
def fitted() -> Calibration:
    return calibrate(slides(), SPEC, rule=RULE)


def spikes(recordings: Recordings, encoder: AfferentSpec) -> list[tuple[list[int], list[int]]]:
    trains = encode_recordings(recordings, encoder)
    return [(s.tolist(), u.tolist()) for s, u in zip(trains.steps, trains.units, strict=True)]


@pytest.mark.parametrize(("power", "unit"), [(-10, "V"), (5, "count")])
def test_scaling_a_sensor_leaves_the_spikes_of_its_encoder_unchanged(fitted, power, unit):
    # Powers of two, which float32 scales exactly.
    recordings = slides()
    scaled = replace(recordings, signals=[s * np.float32(2.0**power) for s in recordings.signals], unit=unit)
    other = calibrate(scaled, SPEC, rule=RULE).encoder
    assert (other.sa1.gain, other.ra1.gain) == (fitted.encoder.sa1.gain, fitted.encoder.ra1.gain)
    assert spikes(scaled, other) == spikes(recordings, fitted.encoder)


@pytest.mark.parametrize("powers", [(12, 0, 0), (-12, 0, 0), (3, -9, 14)])
def test_channels_of_other_sizes_beside_it_change_no_spike_of_a_taxel(fitted, powers):
    recordings = slides()
    factors = np.float32(2.0) ** np.array(powers, np.float32)
    mixed = replace(recordings, signals=[signal * factors for signal in recordings.signals])
    other = calibrate(mixed, SPEC, rule=RULE).encoder
    assert (other.sa1.gain, other.ra1.gain) == (fitted.encoder.sa1.gain, fitted.encoder.ra1.gain)
    assert spikes(mixed, other) == spikes(recordings, fitted.encoder)


@pytest.mark.parametrize("baseline", ["none", "mean"])
def test_another_zero_and_another_unit_change_almost_no_spike(baseline):
    # 37.1 x + 500 rounds in float32, so that a spike may fall a step away: nothing more.
    spec = specs.load(AfferentSpec, "sa1-ra1-lif", {"conditioning.baseline": baseline})
    recordings = slides()
    moved = replace(recordings, signals=[37.1 * s + 500 for s in recordings.signals], unit="count")
    here, there = (calibrate(r, spec, rule=RULE) for r in (recordings, moved))
    assert here.table.gain.to_numpy() == pytest.approx(there.table.gain.to_numpy(), rel=0.01)
    assert here.table.chosen.equals(there.table.chosen)
    counts = [sum(len(s) for s, _ in spikes(r, c.encoder)) for r, c in ((recordings, here), (moved, there))]
    assert counts[0] == pytest.approx(counts[1], rel=0.02)


def test_the_chosen_gains_keep_the_limits_and_no_admissible_one_separates_better(fitted):
    for afferent, part in (("SA-I", "sa1"), ("RA-I", "ra1")):
        rows = fitted.table[fitted.table.afferent == afferent]
        assert (rows[rows.admissible].index == np.arange(*rows[rows.admissible].index[[0, -1]] + [0, 1])).all()
        assert len(rows) <= RULE.candidates
        assert rows.gain.is_monotonic_increasing
        (chosen,) = rows[rows.chosen].itertuples()
        assert chosen.gain == getattr(fitted.encoder, part).gain
        assert chosen.silent_share <= RULE.max_silent_share
        assert chosen.floor_share <= RULE.max_floor_share
        best = rows[rows.admissible].separation.max()
        assert chosen.separation >= (1 - RULE.tie) * best > 0
        smaller = rows[rows.admissible & (rows.gain < chosen.gain)]
        assert (smaller.separation < (1 - RULE.tie) * best).all()


def test_higher_gains_silence_fewer_trials_and_crowd_more_intervals_at_the_floor(fitted):
    for _, rows in fitted.table.groupby("afferent"):
        assert rows.silent_share.is_monotonic_decreasing
        assert rows.silent_share.iloc[0] > rows.silent_share.iloc[-1]
        assert rows.floor_share.iloc[-1] > rows.floor_share.iloc[0]


def test_isi_distributions_are_distributions(fitted):
    totals = fitted.isi.groupby(["afferent", "gain", "label"]).share.sum()
    assert len(totals) == 2 * len(fitted.table)
    assert totals.to_numpy() == pytest.approx(1.0)


def test_classes_that_are_alike_do_not_separate():
    rule = RULE.model_copy(update={"trials_per_class": 24})
    alike, apart = (calibrate(slides(f, trials=24), SPEC, rule=rule).table for f in ((5.0, 5.0), (3.0, 12.0)))
    assert alike.separation.median() == pytest.approx(0.0, abs=0.005)
    assert alike.separation.abs().max() < 0.05
    assert apart[apart.chosen].separation.min() > 0.1


def test_the_same_trials_give_the_same_encoder_and_one_step_of_progress_a_candidate(fitted):
    steps = []
    again = calibrate(slides(), SPEC, lambda n, note: steps.append((n, note)), RULE)
    assert again.encoder == fitted.encoder
    pd.testing.assert_frame_equal(again.table, fitted.table)
    assert sum(n for n, _ in steps) == RULE.candidates


def test_a_calibrated_encoder_is_a_spec_file_that_encodes(fitted, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(specs.to_toml(fitted.encoder.model_dump(mode="json", exclude_none=True)))
    loaded = specs.load(AfferentSpec, path)
    assert loaded == fitted.encoder
    assert all(len(steps) > 0 for steps, _ in spikes(slides(), loaded))


def test_the_refractory_periods_and_neuron_of_the_spec_stay():
    changes = {"sa1.t_ref_ms": 5.0, "ra1.t_ref_ms": 10.0, "tau_mem_ms": 20.0}
    spec = specs.load(AfferentSpec, "sa1-ra1-lif", changes)
    encoder = calibrate(slides(), spec, rule=RULE).encoder
    assert (encoder.sa1.t_ref_ms, encoder.ra1.t_ref_ms, encoder.tau_mem_ms) == (5.0, 10.0, 20.0)
    assert encoder.conditioning.ema_cutoff_Hz == 30.0
    assert encoder.conditioning.resample_Hz is None


def test_slow_recordings_get_a_clock_and_lose_an_impossible_smoothing(caplog):
    slow = calibrate(slides(rate_Hz=40.0, unit="count"), SPEC, rule=RULE)
    assert slow.encoder.conditioning.resample_Hz == 1000.0
    assert slow.encoder.conditioning.ema_cutoff_Hz is None
    assert len(slow.notes) == 2
    assert "30 Hz" in slow.notes[0]
    assert all(note in caplog.text for note in slow.notes)
    exact = "integration = 'exact'"
    assert slow.notes[1].startswith("signals are resampled from 40 to 1000 Hz, the clock of the spikes; ")
    assert slow.notes[1].endswith(exact)
    for spec in (load("sa1-ra1-lif", {"integration": "exact"}), load("send-on-delta")):
        (note,) = [n for n in calibrate(slides(rate_Hz=40.0), spec, rule=RULE).notes if "clock of the spikes" in n]
        assert exact not in note
        assert ("resampled" in note) is (spec.model != "lif")
    assert len(encode_recordings(slides(rate_Hz=40.0, unit="count"), slow.encoder)) == 16


def without_baseline() -> AfferentSpec:
    return specs.load(AfferentSpec, "sa1-ra1-lif", {"conditioning.baseline": "none"})


def test_a_level_that_is_felt_rests_two_deviations_below_the_mean():
    rng = np.random.default_rng(2)
    signals = [500.0 + 5.0 * (i % 2) + rng.normal(0, 0.5, (700, 3)) for i in range(16)]
    pressed = Recordings(signals, 1000.0, "count", pd.DataFrame({"label": ["light", "firm"] * 8}))
    fitted = calibrate(pressed, without_baseline(), rule=RULE).encoder
    level = np.concatenate(list(pressed.signals))
    offset, scale = np.array(fitted.conditioning.offset), np.array(fitted.conditioning.scale)
    assert scale == pytest.approx(level.std(axis=0), rel=0.05)
    assert offset == pytest.approx(level.mean(axis=0) - 2 * scale, abs=0.5)
    counts = [len(steps) for steps, _ in spikes(pressed, fitted)]
    assert 0 < max(counts[::2]) < min(counts[1::2])  # light and firm touch


def test_a_baseline_leaves_nothing_to_subtract(fitted):
    assert fitted.encoder.conditioning.offset is None


def test_a_dead_taxel_stays_silent_and_is_named():
    recordings = slides()
    signals = [np.concatenate([s, np.full((len(s), 1), 812.3)], axis=1) for s in recordings.signals]
    with_dead = Recordings(signals, 1000.0, "mV", recordings.conditions)
    fitted = calibrate(with_dead, SPEC, rule=RULE)
    assert any("noise" in note and note.endswith(": taxel4") for note in fitted.notes)
    trains = encode_recordings(with_dead, fitted.encoder)
    heard = {trains.afferents[unit] for units in trains.units for unit in units}
    assert heard == {f"{kind} taxel{i}" for kind in ("SA-I", "RA-I") for i in (1, 2, 3)}


@pytest.mark.parametrize("value", [0.0, 1.82, 812.3])
def test_constant_signals_are_refused(value):
    still = Recordings([np.full((1000, 2), value)] * 4, 2000.0, "V", pd.DataFrame({"label": [*"aabb"]}))
    with pytest.raises(InputError, match="are constant"):
        calibrate(still, SPEC, rule=RULE)


def test_levels_without_any_change_leave_nothing_for_ra1():
    table = pd.DataFrame({"label": [*"aabb"]})
    levels = Recordings([np.full((1000, 2), v) for v in (1.0, 2.0, 3.0, 4.0)], 2000.0, "V", table)
    with pytest.raises(InputError, match="never drive RA-I"):
        calibrate(levels, without_baseline(), rule=RULE)


def test_one_class_is_refused():
    with pytest.raises(InputError, match="one class, 'class 0'"):
        calibrate(slides((3.0,)), SPEC, rule=RULE)


def with_trials_times(factor: float) -> Recordings:
    """Every other trial is so many times as large."""
    recordings = slides()
    return replace(recordings, signals=[s * (1 if i % 2 else factor) for i, s in enumerate(recordings.signals)])


@pytest.mark.parametrize("factor", [0.0, 1 / 200])
def test_where_trials_rest_the_gain_that_wakes_most_of_them_below_the_floor_is_taken(factor):
    rule = RULE.model_copy(update={"candidates": 22})
    found = calibrate(with_trials_times(factor), SPEC, rule=rule)
    for afferent, rows in found.table.groupby("afferent"):
        (chosen,) = rows[rows.chosen].itertuples()
        assert not rows.admissible.any()
        assert chosen.floor_share <= rule.max_floor_share
        assert chosen.silent_share == rows.silent_share[rows.floor_share <= rule.max_floor_share].min()
        assert any(note.startswith(f"{afferent}: silent in {chosen.silent_share:.0%} of") for note in found.notes)


def test_the_note_names_the_class_that_rests():
    recordings = slides()
    rests = 1
    signals = [s * (label != rests) for s, label in zip(recordings.signals, recordings.labels, strict=True)]
    notes = calibrate(replace(recordings, signals=signals), SPEC, rule=RULE).notes
    assert sum(f"(in 100% of '{recordings.classes[rests]}')" in note for note in notes) == len(POPULATIONS)


def test_spikes_that_always_crowd_at_the_refractory_floor_are_refused():
    table = pd.DataFrame({"silent_share": [1.0, 0.5, 0.0], "floor_share": [0.0, 0.3, 0.4], "admissible": False})
    with pytest.raises(InputError, match=r"here: every gain that gives spikes puts 30.0% .* max_floor_share = 10.0%"):
        gain_search.choose(table, RULE, "here")


def test_the_figure_shows_both_populations(fitted, tmp_path):
    figure = draw_calibration(fitted.table, fitted.isi)
    assert {"SA-I", "RA-I"} <= {axes.get_title() for axes in figure.axes}
    save(figure, tmp_path / "calibration.png")
    assert (tmp_path / "calibration.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "fabricslide").is_dir(), reason=f"FabricSlide is not at {DATA}; set NEUROTACT_DATA")
def test_the_shipped_fabric_encoder_is_what_calibration_gives_on_the_fabrics():
    recordings = fabricslide.read(DATA / "fabricslide")
    train = recordings.select(split_conditions(recordings.conditions, (), SplitSpec()).train)
    fabrics = calibrate(train, without_baseline())
    assert fabrics.encoder == specs.load(AfferentSpec, SHIPPED)
    assert fabrics.table[fabrics.table.chosen].separation.min() > 0.1


def recordings_of(name: str) -> Recordings:
    """A set of `benchmarks/steady_choices.py`, real or made up."""
    import steady_choices  # pyright: ignore[reportMissingImports]

    if name in steady_choices.SETS or DATA.is_dir():
        return steady_choices.recordings_of(name)
    pytest.skip(f"the recordings are not at {DATA}; set NEUROTACT_DATA")


@thinned("name", ["few", "clear", "unclear", "nothing", "slow", "fast", "drift", "falling", "either", "many",
                  "fabrics", "cubes", "icub"])  # fmt: skip
def test_the_candidates_that_a_search_leaves_out_would_change_nothing(name, monkeypatch):
    """The law of a short search: encoder, rates and rows are those of a search of all candidates."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    monkeypatch.setenv("NEUROTACT_DATA", str(DATA))
    recordings, rule = recordings_of(name), CalibrationRule(trials_per_class=10)
    for spec in (without_baseline(), with_opposite(SPEC) or SPEC):
        found = calibrate(recordings, spec, rule=rule, steady=True, tell=False)
        every = rule.model_copy(update={"every": True})
        whole = calibrate(recordings, spec, rule=every, steady=True, tell=False)
        assert found.encoder == whole.encoder
        assert found.notes == whole.notes
        np.testing.assert_array_equal(
            np.hstack([found.rates, found.rates_ra]), np.hstack([whole.rates, whole.rates_ra])
        )
        rows = whole.table.merge(found.table[["afferent", "gain"]])
        pd.testing.assert_frame_equal(rows, found.table)
        left_out = whole.table.merge(found.table[["afferent", "gain"]], how="left", indicator=True)["_merge"] != "both"
        assert not whole.table.admissible[left_out].any()
        assert 0 < left_out.sum() < len(whole.table)


@given(
    silent=st.lists(st.floats(0, 0.2), min_size=RULE.candidates, max_size=RULE.candidates),
    crowded=st.lists(st.floats(0, 0.2), min_size=RULE.candidates, max_size=RULE.candidates),
)
def test_a_short_search_chooses_as_a_whole_one_whether_or_not_both_limits_can_be_kept(silent, crowded):
    limits = {"silent_share": sorted(silent, reverse=True), "floor_share": [0.0, *sorted(crowded)[1:]]}
    table = pd.DataFrame({**limits, "separation": np.linspace(1, 2, RULE.candidates)})
    admissible = (table.silent_share <= RULE.max_silent_share) & (table.floor_share <= RULE.max_floor_share)
    table, rows = table.assign(admissible=admissible), {}
    while (place := gain_search.following(rows, RULE)) is not None:
        assert place not in rows
        rows[place] = table.loc[place].to_dict()
    assert gain_search.choose(table.loc[sorted(rows)], RULE, "") == gain_search.choose(table, RULE, "")


def test_a_figure_has_every_candidate_of_what_the_short_searches_choose():
    recordings = pressed((0.0, 30.0), drift=0.0)
    steps = []
    short = calibrate_causally(recordings, SPEC, lambda n, note: steps.append(n), RULE)
    whole = calibrate_causally(recordings, SPEC, rule=RULE.model_copy(update={"every": True}))
    assert whole.encoder == short.encoder
    assert whole.notes == short.notes
    assert len(short.table) < len(whole.table) == 2 * RULE.candidates
    assert steps == [1] * (3 * RULE.candidates)


# --- the parts of the rule --------------------------------------------------------------------------


def test_of_equal_gains_the_smallest_admissible_is_chosen():
    table = pd.DataFrame({"gain": [1.0, 2.0, 4.0, 8.0], "separation": [0.9, 0.5, 0.4999, 0.1]})
    table = table.assign(silent_share=[1.0, 0.0, 0.0, 0.0], floor_share=0.0, admissible=[False, True, True, True])
    assert gain_search.choose(table, RULE.model_copy(update={"tie": 0.01}), "here") == 1
    turned = table.assign(separation=[0.9, 0.4999, 0.5, 0.1])
    assert gain_search.choose(turned, RULE.model_copy(update={"tie": 0.01}), "here") == 1
    assert gain_search.choose(turned, RULE.model_copy(update={"tie": 0.0}), "here") == 2


def test_a_gain_that_is_the_largest_tried_is_noted_and_another_is_not(fitted):
    """`fitted` tries gains on both sides of those it chooses; with fewer candidates RA-I's is the largest."""
    words = "the chosen gain is the largest tried"
    few = calibrate(slides(), SPEC, rule=RULE.model_copy(update={"candidates": 7}))
    assert few.table[few.table.chosen].gain.max() == few.table.gain.max()
    assert [note for note in few.notes if words in note] == [f"RA-I: {words}; more candidates may find a better one"]
    assert not any(words in note for note in fitted.notes)


def test_classes_that_are_the_same_are_not_told_apart():
    """Few trials of one kind never agree exactly: what chance gives is taken off, so that some gains lie below 0."""
    separation = calibrate(slides((6.0, 6.0, 6.0)), SPEC, rule=RULE).table.separation
    assert separation.min() < 0
    assert abs(separation.mean()) < 0.02


def test_a_short_trial_ends_where_it_ends():
    """Its last sample is not followed by a fall to zero, however long the trials beside it are."""
    pressed = [np.full((n_steps, 2), 5.0) for n_steps in (60, 200, 60, 200)]
    pressed[1][100:] += 1.0  # one step up, so that RA-I is driven at all
    felt = Excerpts(spool.Spool(pressed), np.array([0, 0, 1, 1]), ("a", "b"), 1000.0, "here")
    table = gain_search.search(felt, SPEC, RULE, np.random.default_rng(0), None).table
    rates = table[table.afferent == "RA-I"].spikes_per_s
    # 2 taxels of one trial spike once in 520 ms of all trials, from the gain on at which the step reaches threshold.
    assert set(rates.round(6)) <= {0.0, round(1 / 0.52, 6)}
    assert rates.max() > 0


PARTS = st.integers(0, 300).flatmap(lambda n: hnp.arrays(np.float32, n, elements=st.floats(0, 1e3, width=32)))


@given(parts=st.lists(PARTS, min_size=1, max_size=5), percentile=st.sampled_from([99.9, 99.0, 50.0, 3.0]))
def test_the_strongest_drive_of_parts_is_numpys_percentile_of_the_whole(parts, percentile):
    whole = np.concatenate(parts)
    with patch.object(gain_search, "STRONGEST", percentile):
        found = gain_search._strongest(iter(parts), len(whole))
    expected = float(np.percentile(whole, percentile)) if len(whole) else 0.0
    assert found == (expected if expected > 0 else whole.max(initial=0.0))


@pytest.mark.parametrize("baseline", ["mean", "none"])
def test_gains_fitted_on_a_file_and_in_pieces_are_those_in_memory(tmp_path, baseline):
    # Trials of several lengths, so that those encoded side by side are padded; one of them is long.
    touch = slides()
    signals = [signal[: 500 + 7 * i] for i, signal in enumerate(touch.signals)]
    touch = replace(touch, signals=[*signals[:-1], np.tile(signals[-1], (3, 1))])
    start = SPEC.model_copy(update={"conditioning": SPEC.conditioning.model_copy(update={"baseline": baseline})})
    save_recordings(touch, tmp_path / "touch.h5")
    with open_recordings(tmp_path / "touch.h5") as stored:
        one = calibrate(stored, start, rule=RULE)
    with patch.object(conditioning, "PIECE_VALUES", 4000):  # no shorter: a long trial's mean has other last digits
        other = calibrate(touch, start, rule=RULE)
    expected = calibrate(touch, start, rule=RULE)
    for found in (one, other) if baseline == "none" else (one,):
        assert found.encoder == expected.encoder
        pd.testing.assert_frame_equal(found.table, expected.table, check_exact=True)
        pd.testing.assert_frame_equal(found.isi, expected.isi, check_exact=True)
    assert other.encoder.sa1.gain == pytest.approx(expected.encoder.sa1.gain)


@pytest.mark.parametrize("lengths", [[400] * 1000, [2000] * 7 + [400_000]], ids=["many trials", "a long trial"])
def test_no_more_of_the_signals_is_held_than_a_few_pieces(lengths):
    rule = CalibrationRule(candidates=14, excerpt_s=0.2, max_floor_share=1.0, max_silent_share=0.9)
    with patch.object(conditioning, "PIECE_VALUES", 5000), patch.object(spool, "IN_MEMORY_BYTES", 10_000):
        calibrate(made([400] * 8), SPEC, rule=rule)  # so that no import counts
        held = most_held(lambda: calibrate(made(lengths), SPEC, rule=rule))
    assert held < 1_000_000  # of 3.2 MB of signals


# --- which baseline ---------------------------------------------------------------------------------


def pressed(levels: tuple[float, float], drift: float) -> Recordings:
    """Slides of one frequency on a static level, a class each, with a zero that differs from trial to trial."""
    recordings, rng = slides((5.0, 5.0)), np.random.default_rng(3)
    shift = [levels[label] + drift * rng.normal() for label in recordings.labels]
    signals = [signal + zero for signal, zero in zip(recordings.signals, shift, strict=True)]
    return replace(recordings, signals=signals)


def test_gains_of_a_large_sensor_are_those_of_the_taxels_that_each_touch_moves():
    """Three of nine taxels move in some trials; with all nine as with those three, at most one step apart."""
    recordings, rng = slides(), np.random.default_rng(2)
    places = [4, 0, 7]
    signals = [rng.normal(0, 0.01, (len(signal), 9)) for signal in recordings.signals]
    for grown, signal in zip(signals, recordings.signals, strict=True):
        grown[:, places] += signal
    large = Recordings(signals, 1000.0, "mV", recordings.conditions)
    few = calibrate(large, SPEC, rule=RULE.model_copy(update={"taxels": 3}))
    assert few.rates.shape[1] == 3
    assert len(few.encoder.conditioning.scale) == 9
    own = calibrate(recordings, SPEC, rule=RULE)
    assert few.encoder.sa1.gain == pytest.approx(own.encoder.sa1.gain, rel=RULE.step - 1)
    assert few.encoder.ra1.gain == pytest.approx(own.encoder.ra1.gain, rel=RULE.step - 1)
    assert any("gains are chosen on 3 of the 9 taxels" in note for note in few.notes)
    assert not any("gains are chosen on" in note for note in own.notes)


def test_gains_of_many_excerpts_are_searched_on_a_part_of_them_and_what_follows_uses_all():
    recordings = slides(trials=20)
    rule = RULE.model_copy(update={"trials_per_class": 20, "excerpt_s": 0.7})  # whole trials
    whole = calibrate(recordings, SPEC, rule=rule)
    part = calibrate(recordings, SPEC, rule=rule.model_copy(update={"searched": 24}))
    assert "gains are searched on 8 of the 40 training excerpts and all 3 taxels" in part.notes
    assert not any("searched" in note for note in whole.notes)
    assert part.rates.shape == whole.rates.shape == (40, 3)
    assert part.encoder.conditioning == whole.encoder.conditioning
    for kind in ("sa1", "ra1"):
        gains = [getattr(each.encoder, kind).gain for each in (part, whole)]
        assert gains[0] == pytest.approx(gains[1], rel=RULE.step - 1)
    narrow = calibrate(recordings, SPEC, rule=rule.model_copy(update={"searched_taxels": 2}))
    assert "gains are searched on all 40 training excerpts and 2 of the 3 taxels" in narrow.notes
    assert narrow.rates.shape == (40, 3)
    asked = rule.model_copy(update={"searched_taxels": 2, "spikes_per_s": 20.0})  # a rate is one of all taxels
    assert not any("searched" in note for note in calibrate(recordings, SPEC, rule=asked).notes)
    trains = encode_recordings(recordings, part.encoder)
    counts = np.array([np.bincount(units, minlength=6)[:3] for units in trains.units])
    np.testing.assert_allclose(part.rates, counts / 0.7, rtol=1e-6)


@given(
    signals=hnp.arrays(np.float64, st.tuples(st.integers(1, 5), st.integers(2, 6), st.integers(1, 8)),
                       elements=st.floats(-1e3, 1e3)),
    most=st.integers(1, 8),
)  # fmt: skip
def test_each_signal_has_its_liveliest_taxel_among_those_chosen(signals, most):
    chosen = liveliest(signals, most)
    n = signals.shape[2]
    assert len(chosen) == min(most, n)
    assert (np.diff(chosen) > 0).all()
    if most >= len(signals):
        assert {int(np.argmax(signal.std(axis=0))) for signal in signals} <= {*chosen.tolist()}


def test_a_static_level_that_tells_classes_apart_is_kept():
    found = calibrate_causally(pressed((0.0, 30.0), drift=0.0), SPEC, rule=RULE)
    assert found.encoder.conditioning.baseline == "none"
    assert any("conditioning.baseline = 'none' is chosen" in note for note in found.notes)


def test_a_zero_that_drifts_is_taken_off_by_the_start():
    recordings, rng = slides((2.0, 15.0)), np.random.default_rng(3)
    before = [np.concatenate([rng.normal(0, 0.2, (150, 3)), np.abs(signal)]) for signal in recordings.signals]
    drifting = replace(recordings, signals=[signal + 300 * rng.normal() for signal in before])
    assert calibrate_causally(drifting, SPEC, rule=RULE).encoder.conditioning.baseline == "start"


def test_a_zero_that_drifts_within_a_trial_is_taken_off_by_a_high_pass():
    """Light and firm strokes: neither the start of a trial nor an absent baseline knows where the zero is later on."""
    recordings, rng = slides((5.0, 5.0)), np.random.default_rng(3)
    time_s = np.arange(4000)[:, None] * 1e-3
    strokes = np.maximum(0, np.sin(2 * np.pi * 5 * time_s)) * [10.0, 6.0, 3.0]
    drifts = [60 * np.sin(2 * np.pi * 0.1 * time_s + rng.uniform(0, 6, 3)) for _ in recordings.signals]
    signals = [(1, 4)[label] * strokes + drift for label, drift in zip(recordings.labels, drifts, strict=True)]
    found = calibrate_causally(replace(recordings, signals=signals), SPEC, rule=RULE)
    assert found.encoder.conditioning.baseline == "high-pass"


def test_a_baseline_that_cannot_be_calibrated_is_named_beside_the_others():
    def fit(spec):
        if spec.conditioning.baseline == "none":
            raise InputError("no gain suits")
        accuracy = {"start": 0.5, "high-pass": 0.8}[spec.conditioning.baseline]
        return SimpleNamespace(accuracy=accuracy, accuracy_of_both=1 - accuracy, labels=range(100), encoder=spec)

    chosen, note = _of_baselines(fit, SPEC, [30.0])  # pyright: ignore
    assert chosen.accuracy == 0.8
    assert "'start' 50 %, 'high-pass' 80 %, 'none' failed; to choose otherwise, set conditioning.baseline" in note
    for refused, accuracy in ((("high-pass",), 0.5), (("start",), 0.8), (("start", "high-pass"), 0.8)):
        chosen, _ = _of_baselines(
            fit,  # pyright: ignore
            SPEC,
            [30.0],
            refused=lambda tried, refused=refused: tried.conditioning.baseline in refused,
        )
        assert chosen.accuracy == accuracy
    chosen, note = _of_baselines(fit, SPEC, [30.0], by_both=True)  # pyright: ignore
    assert chosen.accuracy == 0.5
    assert "on the SA-I and RA-I rates of the training trials: 'start' 50 %, 'high-pass' 20 %" in note


def test_the_baseline_of_a_falling_signal_is_one_with_which_it_rests():
    """Of all baselines the most accurate may wake the afferents at rest; the next one is as good as none for them."""
    rule = RULE.model_copy(update={"excerpt_s": 2.0, "trials_per_class": 16})
    touches = falling((3.0, 20.0))
    first = calibrate_causally(touches, SPEC, rule=rule, choose_opposite=True)
    used = first.encoder.conditioning.baseline
    with patch("neurotact.encoders.calibration._wakes", lambda _, without, tried: tried.conditioning.baseline == used):
        other = calibrate_causally(touches, SPEC, rule=rule, choose_opposite=True)
    assert first.encoder.sa1.opposite
    assert (other.encoder.sa1.opposite, other.encoder.conditioning.baseline != used) == (True, True)


def test_the_baseline_that_is_chosen_is_fitted_as_if_it_had_been_given():
    recordings = pressed((0.0, 30.0), drift=0.0)
    given_none = SPEC.model_copy(update={"conditioning": SPEC.conditioning.model_copy(update={"baseline": "none"})})
    given = calibrate(recordings, given_none, rule=RULE, steady=True)
    assert calibrate_causally(recordings, SPEC, rule=RULE).encoder == given.encoder


@pytest.mark.parametrize("integration", ["clock", "exact"])
def test_fits_that_share_their_trials_are_those_of_each_alone(integration):
    recordings, fits, alone = slides(rate_Hz=500.0), [], calibrate
    spec = specs.load(AfferentSpec, "sa1-ra1-lif", {"integration": integration, "conditioning.resample_Hz": 1000.0})

    def spied(recordings, spec, *given, **how):
        fits.append((spec, alone(recordings, spec, *given, **how)))
        return fits[-1][1]

    with (
        patch("neurotact.encoders.calibration.calibrate", spied),
        patch.object(gain_search, "_fire", side_effect=gain_search._fire) as fire,
    ):
        calibrate_causally(recordings, spec, rule=RULE, choose_ema=True, choose_opposite=True)
    assert len(fits) > 6
    with patch.object(gain_search, "_fire", side_effect=gain_search._fire) as fire_alone:
        for start, found in fits:
            again = calibrate(recordings, start, rule=RULE, steady=True)
            assert (found.encoder, found.notes) == (again.encoder, again.notes)
            pd.testing.assert_frame_equal(found.table, again.table)
            pd.testing.assert_frame_equal(found.isi, again.isi)
            assert (found.rates.tobytes(), found.rates_ra.tobytes()) == (
                again.rates.tobytes(),
                again.rates_ra.tobytes(),
            )
    assert _n_fired(fire, "RA-I") < _n_fired(fire_alone, "RA-I")
    assert _n_fired(fire, "SA-I") == _n_fired(fire_alone, "SA-I")


def _n_fired(fire, name) -> int:
    return sum(one.name == name for call in fire.call_args_list for one in call.args[2])


def test_trials_are_drawn_once_for_all_fits_and_cut_once_for_each_conditioning():
    with (
        patch("neurotact.encoders.calibration.numbers_of", side_effect=numbers_of) as drawn,
        patch("neurotact.encoders.calibration.cut", side_effect=cut) as conditioned,
    ):
        calibrate_causally(slides(), SPEC, rule=RULE, choose_opposite=True)
    assert (drawn.call_count, conditioned.call_count) == (1, 3)


def test_a_search_passes_by_the_first_candidates_at_which_hardly_anything_fires():
    silent, rule = {"silent_share": 1.0, "floor_share": 0.0}, CalibrationRule()
    assert [gain_search.following(rows, rule) for rows in ({}, {7: silent})] == [7, 11]


@settings(max_examples=10)
@given(st.integers(0, 9), st.integers(2, 12), st.integers(0, 11))
def test_a_trial_that_is_left_out_changes_no_other_draw(seed, per_class, left_out):
    recordings = slides(trials=6)
    kept = np.delete(np.arange(12), left_out)
    numbers, fewer = numbers_of(recordings, seed), numbers_of(recordings.select(kept), seed)
    assert numbers[kept].tolist() == fewer.tolist()
    assert len({*numbers}) == 12
    rng = np.random.default_rng(0)
    drawn = draw(recordings.labels, per_class, rng, numbers)
    drawn_of_fewer = kept[draw(recordings.labels[kept], per_class, rng, fewer)]
    assert len({*drawn} - {*drawn_of_fewer}) <= 1
    assert left_out in drawn or drawn.tolist() == drawn_of_fewer.tolist()
    excerpts = cut(recordings, SPEC.conditioning, 0.3, rng, numbers)
    of_fewer = cut(recordings.select(kept), SPEC.conditioning, 0.3, rng, fewer)
    for trial, excerpt in zip(kept, of_fewer, strict=True):
        np.testing.assert_array_equal(excerpt, excerpts[int(trial)])


@given(st.integers(0, 99), st.lists(st.integers(2, 14), min_size=2, max_size=4), st.data())
def test_a_trial_that_is_left_out_changes_few_permuted_labels(seed, sizes, data):
    labels, rng = np.repeat(np.arange(len(sizes)), sizes), np.random.default_rng(seed)
    numbers, one = rng.random(len(labels)), data.draw(st.integers(0, len(labels) - 1))
    every = permuted(labels, 3, rng, numbers)
    fewer = permuted(np.delete(labels, one), 3, rng, np.delete(numbers, one))
    assert (np.sort(every, axis=1) == labels).all()
    assert ((np.delete(every, one, axis=1) != fewer).sum(axis=1) <= len(sizes)).all()
    assert len({tuple(row) for row in permuted(np.arange(30), 3, rng, rng.random(30))}) == 3


@given(st.lists(st.integers(2, 14), min_size=2, max_size=4), st.data())
def test_a_trial_that_is_left_out_moves_few_others_to_another_fold(sizes, data):
    labels = np.repeat(np.arange(len(sizes)), sizes)
    order = np.random.default_rng(data.draw(st.integers(0, 99))).random(len(labels))
    one = data.draw(st.integers(0, len(labels) - 1))
    fold, fewer = folds_of(labels, order), folds_of(np.delete(labels, one), np.delete(order, one))
    moved = (np.delete(fold, one) != fewer) & (np.delete(labels, one) == labels[one])
    assert (np.delete(fold, one) == fewer)[np.delete(labels, one) != labels[one]].all()
    assert moved.sum() < sizes[labels[one]]
    for label, size in enumerate(sizes):
        counts = np.bincount(fold[labels == label], minlength=5)
        assert counts.max() - counts.min() <= 1
        assert np.count_nonzero(counts) == min(5, size)
    if min(sizes) > 10:
        assert moved.sum() <= 4


def test_choices_do_not_hang_on_the_order_of_the_trials():
    """Excerpts are parts of trials, and gains are searched on some of them: all are drawn by the trials' samples."""
    rule = RULE.model_copy(update={"trials_per_class": 7, "searched": 24})
    recordings = pressed((0.0, 12.0), drift=20.0)
    backwards = recordings.select(np.arange(len(recordings))[::-1])
    found, other = (calibrate_causally(one, SPEC, rule=rule, choose_ema=True) for one in (recordings, backwards))
    assert [note for note in other.notes if "accuracy" in note] == [note for note in found.notes if "accuracy" in note]
    assert other.encoder.sa1 == found.encoder.sa1
    assert (other.accuracy, other.accuracy_of_both) == (found.accuracy, found.accuracy_of_both)


def vibrating(strengths=(0.2, 0.8), rate_Hz=1000.0) -> Recordings:
    """Slow strokes of random size, the same for all classes, with a vibration of 150 Hz whose size is the class's."""
    rng, time_s = np.random.default_rng(5), np.arange(0, 0.7, 1 / rate_Hz)[:, None]
    signals, labels = [], []
    for index, strength in enumerate(strengths):
        for _ in range(16):
            stroke = rng.uniform(20, 40, 3) * np.sin(2 * np.pi * (2 * time_s + rng.uniform(size=3)))
            signals.append(stroke + strength * np.sin(2 * np.pi * (150 * time_s + rng.uniform(size=3))))
            labels.append(f"class {index}")
    return Recordings(signals, rate_Hz, "mV", pd.DataFrame({"label": labels}))


def test_a_moving_average_that_hides_a_vibration_gives_way():
    """Nothing but 150 Hz distinguishes these classes, and the encoder's own average ends at 30 Hz."""
    found = calibrate_causally(vibrating(), SPEC, rule=RULE, choose_ema=True)
    assert found.encoder.conditioning.ema_cutoff_Hz in (120.0, None)
    (note,) = [note for note in found.notes if "ema_cutoff_Hz" in note]
    assert "SA-I and RA-I rates of the training trials: 30 Hz" in note
    assert "to choose otherwise, set conditioning.ema_cutoff_Hz = 30" in note
    own = calibrate_causally(vibrating(), SPEC, rule=RULE)
    assert own.encoder.conditioning.ema_cutoff_Hz == 30.0
    assert found.accuracy_of_both > own.accuracy_of_both + 0.2


def test_the_own_moving_average_stays_where_the_others_are_no_better():
    found = calibrate_causally(slides(), SPEC, rule=RULE, choose_ema=True)
    assert found.encoder == calibrate_causally(slides(), SPEC, rule=RULE).encoder
    assert not [note for note in found.notes if "ema_cutoff_Hz" in note]


def falling(depths=(3.0, 9.0)) -> Recordings:
    """Presses of random size at random times, and a level that slowly sags by the depth of the class.

    SA-I of the rise alone are silent below rest, and RA-I respond to the presses.
    """
    rng, time_s = np.random.default_rng(5), np.arange(0, 2, 1e-3)[:, None]
    signals, labels = [], []
    for index, depth in enumerate(depths):
        for _ in range(16):
            presses = sum(
                rng.uniform(10, 60, 3) * np.exp(-0.5 * ((time_s - rng.uniform(0, 2, 3)) / 0.02) ** 2) for _ in range(6)
            )
            sag = -depth * np.sin(2 * np.pi * (time_s + rng.uniform(size=3)))
            signals.append(300 * rng.normal(size=3) + presses + np.minimum(sag, 0) * rng.uniform(0.8, 1.2))
            labels.append(f"class {index}")
    return Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": labels}))


def test_sa1_of_the_falling_signal_are_added_where_they_tell_more():
    recordings = falling((3.0, 20.0))
    rule = RULE.model_copy(update={"excerpt_s": 2.0, "trials_per_class": 16})
    without = calibrate_causally(recordings, SPEC, rule=rule)
    found = calibrate_causally(recordings, SPEC, rule=rule, choose_opposite=True)
    assert (without.encoder.sa1.opposite, found.encoder.sa1.opposite) == (False, True)
    assert found.accuracy_of_both > without.accuracy_of_both + 0.1
    (note,) = [note for note in found.notes if "opposite" in note]
    assert f"training trials: false {100 * without.accuracy_of_both:.0f} %, true " in note
    (of_baseline,) = [note for note in found.notes if "conditioning.baseline =" in note]
    assert "on the SA-I and RA-I rates" in of_baseline  # as the polarity is chosen
    given = SPEC.model_copy(update={"sa1": SPEC.sa1.model_copy(update={"opposite": True})})
    assert found.encoder == calibrate_causally(recordings, given, rule=rule).encoder


def humming(seed: int) -> Recordings:
    """Presses of random size, a sag whose depth is the class's, and a hum of 450 Hz that is a little stronger in one.

    SA-I of the falling signal tell the depth.
    """
    rng, time_s = np.random.default_rng(seed), np.arange(0, 2, 1e-3)[:, None]
    signals, labels = [], []
    for index, (depth, strength) in enumerate([(3.0, 0.3), (20.0, 0.45)]):
        for _ in range(16):
            presses = sum(
                rng.uniform(10, 60, 3) * np.exp(-0.5 * ((time_s - rng.uniform(0, 2, 3)) / 0.02) ** 2) for _ in range(6)
            )
            sag = np.minimum(-depth * np.sin(2 * np.pi * (time_s + rng.uniform(size=3))), 0) * rng.uniform(0.8, 1.2)
            hum = strength * rng.lognormal(0, 0.4, 3) * np.sin(2 * np.pi * (450 * time_s + rng.uniform(size=3)))
            signals.append(300 * rng.normal(size=3) + presses + sag + hum)
            labels.append(f"class {index}")
    return Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": labels}))


@pytest.mark.parametrize("seed", [6, 8])
def test_the_own_moving_average_stays_where_the_falling_signal_tells_more(seed):
    """Without SA-I of the falling signal a wider one is better, as it lets the hum pass; with them it adds nothing."""
    rule = RULE.model_copy(update={"excerpt_s": 2.0, "trials_per_class": 16})
    steps = []
    found = calibrate_causally(
        humming(seed), SPEC, lambda n, _: steps.append(n), rule, choose_ema=True, choose_opposite=True
    )
    plain = calibrate_causally(humming(seed), SPEC, rule=rule, choose_ema=True)
    assert plain.encoder.conditioning.ema_cutoff_Hz != 30.0
    assert found.encoder == calibrate_causally(humming(seed), SPEC, rule=rule, choose_opposite=True).encoder
    assert found.encoder.sa1.opposite
    assert found.accuracy_of_both >= plain.accuracy_of_both
    assert not [note for note in found.notes if "ema_cutoff_Hz" in note]
    _, times = calibration_for(SPEC, {})
    assert sum(steps) == times * rule.candidates


def test_sa1_of_the_falling_signal_are_left_out_where_they_tell_no_more():
    found = calibrate_causally(slides(), SPEC, rule=RULE, choose_opposite=True)
    assert found.encoder == calibrate_causally(slides(), SPEC, rule=RULE).encoder
    assert not [note for note in found.notes if "opposite" in note]


def test_choices_for_untrained_conditions_are_made_between_them():
    """The level belongs to the day, and how the signal changes to the class."""
    recordings = slides((2.0, 8.0))
    days = np.arange(len(recordings)) // 2 % 2
    # On each day the firm class has another level; a level therefore tells classes within a day alone.
    levels = 40.0 * (recordings.labels ^ days)
    told = recordings.conditions.assign(day=days)
    signals = [signal + level for signal, level in zip(recordings.signals, levels, strict=True)]
    recordings = replace(recordings, signals=signals, conditions=told)
    found = calibrate_causally(recordings, SPEC, rule=RULE, apart=("day",))
    assert found.apart is not None
    assert sorted({*found.apart}) == ["0", "1"]
    assert "these accuracies are of each value of day by the training trials of the others" in found.notes
    assert found.accuracy == cross_validated_accuracy(found.rates, found.labels, found.apart)
    assert found.encoder.conditioning.baseline != "none"
    one_day = recordings.select(np.flatnonzero(days == 0))
    assert (
        calibrate_causally(one_day, SPEC, rule=RULE, apart=("day",)).encoder
        == calibrate_causally(one_day, SPEC, rule=RULE).encoder
    )


def test_choices_for_untrained_groups_are_made_between_them(caplog):
    """A split that keeps the trials of a day together: a level tells classes within a day, not between days."""
    recordings = slides((2.0, 8.0))
    days = np.arange(len(recordings)) // 2 % 4
    levels = 40.0 * (recordings.labels ^ days % 2)
    told = recordings.conditions.assign(day=days, half=days // 2)
    signals = [signal + level for signal, level in zip(recordings.signals, levels, strict=True)]
    recordings = replace(recordings, signals=signals, conditions=told)
    found, at_random = (calibrate_causally(recordings, SPEC, rule=RULE, group=group) for group in (("day",), ()))
    assert found.folds is not None
    assert [len({*found.folds[days == day]}) for day in range(4)] == [1, 1, 1, 1]
    assert len({*found.folds}) == 4
    assert found.accuracy == cross_validated_accuracy(found.rates, found.labels, found.folds)
    assert found.encoder.conditioning.baseline != "none"
    assert at_random.folds is None
    nt.calibrate(recordings, SPEC, split=nt.Split(group="day"))
    assert "these accuracies are of training trials by those of other groups (day)" in caplog.text
    refused = patch("neurotact.encoders.alternatives.calibrate", side_effect=InputError("enough"))
    with refused as compared, pytest.raises(InputError, match="enough"):
        nt.calibrate(recordings, SPEC, split=nt.Split(group="day", test_where={"half": 1}), compare=True)
    asked = {(call.kwargs["apart"], call.kwargs["group"]) for call in compared.call_args_list}
    assert asked == {(("half",), ("day",))}


def test_several_grades_are_for_untrained_conditions_alone():
    recordings = slides((2.0, 8.0))
    days = recordings.conditions.assign(day=np.arange(len(recordings)) // 2 % 2)
    one_day = replace(recordings, conditions=days.assign(day=0))
    without = calibrate_causally(recordings, SPEC, rule=RULE, choose_grades=True)
    assert without.encoder == calibrate_causally(recordings, SPEC, rule=RULE).encoder
    # With one day, no other one can rank them: they are added, and it is said.
    found = calibrate_causally(one_day, SPEC, rule=RULE, choose_grades=True, apart=("day",))
    assert len(found.encoder.sa1.grades) == len(GRADES)
    assert found.rates.shape[1] == len(GRADES) * recordings.n_channels
    assert found.encoder.conditioning == without.encoder.conditioning
    assert any("no training trials are of another condition" in note for note in found.notes)
    # With two days, they are chosen by accuracy; two frequencies are told by any rate.
    ranked = calibrate_causally(
        replace(recordings, conditions=days), SPEC, rule=RULE, choose_grades=True, apart=("day",)
    )
    assert ranked.encoder.sa1.grades == (1.0,)


def presses_of_three_sizes_and_speeds() -> Recordings:
    """Ten presses of each size and speed, and a vibration of any size that RA-I respond to."""
    rng, time_s = np.random.default_rng(11), np.arange(0, 1, 1e-3)[:, None]
    rows = [(size, speed) for size in (1.0, 2.0, 4.0) for speed in (1.0, 2.0, 4.0) for _ in range(10)]

    def press(size: float, speed: float) -> np.ndarray:
        rise = 10 * size * np.exp(-0.5 * (speed * (time_s - 0.5 - rng.uniform(-0.05, 0.05)) / 0.12) ** 2)
        return rise + rng.uniform(0, 6) * np.sin(2 * np.pi * rng.uniform(20, 25) * time_s)

    table = pd.DataFrame(rows, columns=["label", "speed"]).astype(str)
    return Recordings([press(*row) for row in rows], 1000.0, "mV", table)


def test_grades_are_added_where_size_tells_more_at_another_condition():
    recordings = presses_of_three_sizes_and_speeds()
    how = {"rule": CalibrationRule(candidates=12, shuffles=2), "apart": ("speed",)}
    without, found = (calibrate_causally(recordings, SPEC, choose_grades=on, **how) for on in (False, True))
    assert found.accuracy_of_both > without.accuracy_of_both + 0.05
    assert (len(without.encoder.sa1.grades), len(found.encoder.sa1.grades)) == (1, len(GRADES))
    assert found.accuracy_of_both == cross_validated_accuracy(
        np.hstack([found.rates, found.rates_ra]), found.labels, found.apart
    )
    (note,) = [note for note in found.notes if note.startswith("sa1.grades")]
    assert f"training trials: [1] {100 * without.accuracy_of_both:.0f} %, [" in note


def rising() -> Recordings:
    """A skin that rests for half a second, and then rises by a level of the class."""
    rng, touched = np.random.default_rng(7), np.arange(2000)[:, None] > 500
    levels = [(1 + label) * rng.uniform(0.8, 1.2) * np.array([10.0, 6.0, 3.0]) for label in (0, 1) * 16]
    signals = [rng.normal(0, 0.2, (2000, 3)) + touched * level for level in levels]
    return Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": ["light", "firm"] * 16}))


def test_sa1_of_the_falling_signal_that_fire_at_rest_are_told_from_others():
    """Without a baseline the zero of both is the mean, above the rest of a signal that only rises."""
    spec = SPEC.model_copy(update={"conditioning": SPEC.conditioning.model_copy(update={"baseline": "none"})})
    fitted = [calibrate(rising(), each, rule=RULE).encoder for each in (spec, with_opposite(spec))]
    assert _wakes(_AtRest(rising()), *fitted)
    touched = rising().select(np.arange(32))
    touched = replace(touched, signals=[signal[500:] for signal in touched.signals])  # trials that begin in contact
    assert not _wakes(_AtRest(touched), *fitted)


@pytest.mark.parametrize(("reached", "wakes", "is_chosen"), [
    (0.95, False, True), (0.95, True, False), (0.5, False, False),
])  # fmt: skip
def test_sa1_of_the_falling_signal_are_added_where_they_tell_more_and_rest_at_rest(reached, wakes, is_chosen):
    of = [SimpleNamespace(accuracy_of_both=x, labels=range(100), encoder=name) for x, name in ((0.5, 1), (reached, 2))]
    asked = []
    with patch("neurotact.encoders.calibration._wakes", lambda *its: asked.append(its) or wakes):
        chosen, notes = _of_polarities("trials", (of[0], of[1]), ("ema", "without"), "its own")  # pyright: ignore
    assert chosen is of[is_chosen]
    assert asked == ([("trials", 1, 2)] if reached > 0.5 else [])
    assert notes[:2] == ("ema", "its own" if is_chosen else "without")
    assert ["fire at rest" in note for note in notes[2:]] == [wakes][: reached > 0.5]


def test_given_polarities_and_rectified_signals_leave_no_choice():
    rectified = SPEC.model_copy(update={"conditioning": SPEC.conditioning.model_copy(update={"rectify": True})})
    for spec, keys in ((SPEC, {"sa1.opposite": False}), (rectified, {}), (with_opposite(SPEC), {})):
        assert calibration_for(spec, keys)[1] == 5


@thinned("rate_Hz", [1000.0, 100.0, 50.0], every=2)
def test_every_step_of_the_choice_is_counted_whatever_the_sampling_rate(rate_Hz):
    fit, times = calibration_for(SPEC, {})
    steps = []
    fit(slides(rate_Hz=rate_Hz), SPEC, lambda n, note: steps.append(n), RULE, tell=False)
    assert sum(steps) == times * RULE.candidates


def test_where_no_baseline_can_be_calibrated_the_reason_is_said():
    still = replace(slides(), signals=[np.ones_like(signal) for signal in slides().signals])
    with pytest.raises(InputError, match="are constant"):
        calibrate_causally(still, SPEC, rule=RULE)


def test_a_membrane_that_never_charges_is_refused():
    spec = specs.load(AfferentSpec, "sa1-ra1-lif", {"tau_mem_ms": 2.0**62})
    with pytest.raises(InputError, match="no gain tried gives a spike"):
        calibrate(slides(), spec, rule=RULE)
