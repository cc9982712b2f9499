"""Alternatives of conditioning, and afferents that fire at rest: each found where it was put."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from levels import thinned

from neurotact.data.recordings import Recordings
from neurotact.encoders import alternatives
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.alternatives import BASELINES, POLARITIES, compare, n_steps
from neurotact.encoders.calibration import calibrate
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.firing import complaint_at_rest, resting_table
from neurotact.encoders.gain_search import CalibrationRule
from neurotact.errors import InputError
from neurotact.spec import build

START = build(AfferentSpec, {"sa1": {"gain": 1}, "ra1": {"gain": 1}}, "an example")
RULE = CalibrationRule(shuffles=2)


def presses(sign: float, n: int = 8, noisy: bool = False) -> Recordings:
    """Two taxels at rest for 0.2 s, then pressed: lightly or firmly, by the class, from a level of its own."""
    rng, signals = np.random.default_rng(0), []
    for trial in range(2 * n):
        depth = (0.5, 2.0)[trial % 2]
        pressed = depth * (1 + 0.3 * np.sin(2 * np.pi * 30e-3 * np.arange(400)))
        signal = np.concatenate([np.zeros(200), pressed])[:, None] * sign + rng.normal(0, 0.02, (600, 2))
        signals.append(signal + 10)
        if noisy:
            signals[-1][:, 1] = 10 + rng.normal(0, 1, 600)
    return Recordings(signals, 1000.0, "count", pd.DataFrame({"label": ["light", "firm"] * n}))


@thinned(("sign", "loses"), [(1.0, "falling"), (-1.0, "rising")])
def test_the_polarity_of_the_sensor_is_found(sign, loses):
    """Taken from its own start, a signal that falls on contact tells nothing by its rise, and the other way round."""
    found = compare(presses(sign), START, rule=RULE)
    table = found.table.set_index(["baseline", "polarity"])
    right = "rising" if sign > 0 else "falling"
    other = table.separation_sa.get(("start", loses))
    assert not other > 0.5 * table.separation_sa["start", right]
    chosen = found.table[found.table.chosen].iloc[0]
    assert chosen.accuracy == found.table.accuracy.max()  # the first of equals, which may keep the level
    assert (chosen.baseline, chosen.polarity) != ("start", loses)
    assert not chosen.acausal
    assert len(found.table) == len(BASELINES) * len(POLARITIES)
    spikes = encode_recordings(presses(sign), found.best.encoder)
    assert all(len(steps) for steps in spikes.steps)


def test_an_inverted_encoder_of_a_falling_signal_is_the_plain_one_of_a_rising_one():
    rising, falling = presses(1.0), presses(1.0)
    falling = Recordings([-signal for signal in falling.signals], 1000.0, "count", falling.conditions)
    baseline = {"conditioning": START.conditioning.model_copy(update={"baseline": "start"})}
    spec = START.model_copy(update=baseline)
    plain, inverted = calibrate(rising, spec, rule=RULE), calibrate(falling, spec, rule=RULE, inverted=True)
    pd.testing.assert_frame_equal(plain.table, inverted.table)
    assert [-value for value in plain.encoder.conditioning.scale] == list(inverted.encoder.conditioning.scale)


def test_a_taxel_of_noise_is_named_with_the_remedy():
    noisy = presses(1.0, noisy=True)
    spec = build(
        AfferentSpec,
        {"unit": "count", "conditioning": {"baseline": "start", "scale": [1.0, 0.1]},
         "sa1": {"gain": 30}, "ra1": {"gain": 30}},
        "an example",
    )  # fmt: skip
    table = resting_table(noisy, spec)
    assert table[table.restless].afferent.str.contains("taxel2").all()
    assert table.restless.any()
    assert table.share.sum() == pytest.approx(1.0)
    said = complaint_at_rest(table)
    assert "SA-I taxel2" in said
    assert "`columns` of an import" in said
    assert complaint_at_rest(table.assign(restless=False)) is None


@pytest.mark.parametrize(
    ("baseline", "remedy"), [("none", "conditioning.baseline=start"), ("high-pass", "conditioning.ema_cutoff_Hz")]
)
def test_a_baseline_is_a_remedy_only_where_none_is_taken_off(baseline, remedy):
    noisy = presses(1.0, noisy=True)
    spec = build(AfferentSpec, {"unit": "count", "sa1": {"gain": 30}, "ra1": {"gain": 30}}, "an example")
    said = complaint_at_rest(resting_table(noisy, spec).assign(restless=True), baseline=baseline)
    assert said.endswith(f"else {'subtract a baseline' if baseline == 'none' else 'smooth the signal'} ({remedy})")


def test_the_first_alternative_within_the_error_of_the_best_is_chosen(monkeypatch):
    """Of 100 trials and 90 %, a standard error is 3 points: 88 % of no baseline is as good as 90 % of another."""
    shares = {("none", "rising"): 0.8, ("none", "both"): 0.88, ("start", "falling"): 0.9, ("mean", "rising"): 0.99}
    fitted = calibrate(presses(1.0), START, rule=RULE)

    def made(recordings, spec, progress, rule, *, inverted, **options):
        polarity = "falling" if inverted else "both" if spec.conditioning.rectify else "rising"
        share = shares.get((spec.conditioning.baseline, polarity), 0.1)
        labels = np.zeros(100) if options["steady"] else np.zeros(1)
        return SimpleNamespace(accuracy=share, table=fitted.table, labels=labels, encoder=(share, options["steady"]))

    monkeypatch.setattr(alternatives, "calibrate", made)
    found = compare(presses(1.0), START, rule=RULE)
    assert found.best.encoder == (0.88, True)
    assert found.table.accuracy.head(3).tolist() == [0.99, 0.9, 0.88]
    assert found.table.chosen.tolist().index(True) == 2


def test_an_alternative_that_cannot_be_calibrated_counts_as_many_steps(monkeypatch):
    told: list[tuple[int, str]] = []
    quiet: list[bool] = []

    def only_rising(recordings, spec, progress, rule, *, inverted, **options):
        quiet.append(not options.get("tell", True))
        if inverted or spec.conditioning.rectify:
            progress(1, "the search")
            raise InputError("no gain suits it")
        return calibrate(recordings, spec, progress, rule, **options)

    monkeypatch.setattr(alternatives, "calibrate", only_rising)
    found = compare(presses(1.0), START, lambda n, note: told.append((n, note)), rule=RULE)
    assert sum(n for n, _ in told) == n_steps(RULE)
    assert quiet == [True] * (len(quiet) - 1) + [False]  # the notes are those of the chosen one
    assert {note for n, note in told if n > 1} == {f"{base}, {which}" for base in BASELINES for which in POLARITIES[1:]}
    assert (found.table.why_not != "").tolist() == (found.table.polarity != "rising").tolist()


def test_resting_shares_are_counted_by_hand():
    """One afferent of a constant drive fires alike at rest and later: its share at rest is that of the time."""
    steady = Recordings([np.full((400, 1), 40.0)], 1000.0, "mV", pd.DataFrame({"label": ["felt"]}))
    table = resting_table(steady, START, rest_ms=100).set_index("afferent")
    spikes = encode_recordings(steady, START).steps[0]
    assert table.rest_share["SA-I taxel1"] == pytest.approx((spikes < 100).mean())
    assert table.rest_Hz["SA-I taxel1"] == pytest.approx((spikes < 100).sum() / 0.1)
    assert table.later_Hz["SA-I taxel1"] == pytest.approx((spikes >= 100).sum() / 0.3)


def test_where_nothing_can_be_calibrated_the_reason_is_given():
    still = Recordings(np.ones((8, 300, 2)), 1000.0, "count", pd.DataFrame({"label": ["a", "b"] * 4}))
    with pytest.raises(InputError, match="are constant"):
        compare(still, START, rule=RULE)


def test_a_scale_of_zero_is_refused():
    with pytest.raises(InputError, match="must not be 0"):
        build(AfferentSpec, {"conditioning": {"scale": [0.0]}, "sa1": {"gain": 1}, "ra1": {"gain": 1}}, "x.toml")
