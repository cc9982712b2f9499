"""A moving average runs at the rate of the sensor: whoever counts the cost of encoding knows that rate, or says so."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.encoders.survival.survival import survival_of
from neurotact_parts.exporters.live.scores import cost_nJ
from neurotact_parts.streams.chain import chain_of
from neurotact_parts.streams.stream import Stream

import neurotact as nt
from neurotact.baselines import opponents
from neurotact.data.splits import Split
from neurotact.data.windows import WindowSpec, cut
from neurotact.encoders.cost import NOT_COUNTED, encoding_cost
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost
from neurotact.metrics.prices import ARITHMETIC_45NM, MEMORY_45NM, PriceList
from neurotact.networks.use.ledger import Afferents, network_cost
from neurotact.report import front, networks, tables, wording
from neurotact.report.answer import Decision

RECORDED_Hz, CLOCK_Hz, LENGTH_ms = 2000.0, 200.0, 100.0
ENCODER = nt.AfferentSpec.model_validate({
    "sa1": {"gain": 3.0, "t_ref_ms": 5.0}, "ra1": {"gain": 90.0, "t_ref_ms": 5.0},
    "conditioning": {"ema_cutoff_Hz": 30.0, "resample_Hz": CLOCK_Hz, "baseline": "start"},
})  # fmt: skip
TRAINING = {"hidden": 4, "training.epochs": 1}


@pytest.fixture(scope="module")
def recordings() -> nt.Recordings:
    rng, labels = np.random.default_rng(0), np.tile(["hard", "soft"], 12)
    strength = np.where(labels == "hard", 24.0, 10.0)[:, None, None]
    press = np.sin(np.linspace(0, 9, 400))[None, :, None] ** 2
    signals = (strength * press + rng.normal(0, 1, (24, 400, 2))).astype(np.float32)
    return nt.Recordings(signals, RECORDED_Hz, "mV", {"label": labels})


@pytest.fixture(scope="module")
def trains(recordings) -> nt.SpikeTrains:
    return nt.encode(recordings, ENCODER)


@pytest.fixture(scope="module")
def classifier(trains) -> nt.SpikingClassifier:
    windows = nt.windows(trains, nt.Window(length_ms=LENGTH_ms))
    return nt.SpikingClassifier(hidden=4, epochs=1, batch=8, random_state=0).fit(windows.X, windows.y)


def encoding(trains: nt.SpikeTrains, steps: float = LENGTH_ms * 1e-3 * CLOCK_Hz) -> Cost:
    """Of two taxels, by the rate of these recordings; the products that are not added are of the moving average."""
    made = encoding_cost(2, steps, 1e3 * steps / CLOCK_Hz, trains.encoder, recorded_Hz=RECORDED_Hz)
    assert made.multiplications == 2 * steps * RECORDED_Hz / CLOCK_Hz
    return made


def unknown(trains: nt.SpikeTrains) -> nt.SpikeTrains:
    return replace(trains, recorded_Hz=None)


def costs_of_a_run(trains: nt.SpikeTrains, folder) -> pd.DataFrame:
    nt.save(trains, folder / "spikes.h5")
    nt.train(folder / "spikes.h5", folder / "run", settings=TRAINING, seed=3, window=nt.Window(length_ms=LENGTH_ms))
    told = []
    nt.sops(folder / "run", folder / "sops.csv", tell=told.append)
    (costs,) = (each for each in told if isinstance(each, pd.DataFrame))
    return costs.set_index("name")


def test_the_rate_reaches_the_ledger_of_networks_and_of_their_opponents(trains):
    assert Afferents.of(trains).cost(20) == encoding(trains)
    windows = cut(trains.trial_steps, CLOCK_Hz, WindowSpec(length_ms=LENGTH_ms))
    cuts = opponents.cuts_of(trains.conditions, windows, CLOCK_Hz, Split(*np.split(np.arange(24), [12, 18])), {})
    made = next(opponents.spike_inputs(trains, (1.0, 1.0), cuts)).made
    assert made.multiplications == encoding(trains).multiplications
    with pytest.raises(InputError, match="give recorded_Hz"):
        next(opponents.spike_inputs(unknown(trains), (1.0, 1.0), cuts))


def test_the_rate_reaches_the_ledger_of_a_run(trains, tmp_path):
    costs = costs_of_a_run(trains, tmp_path)
    assert costs.loc["encoder", "macs"] == encoding(trains).macs
    assert tables._afferents(tmp_path / "spikes.h5") == Afferents.of(trains)


def test_events_that_nobody_encoded_have_no_cost_of_encoding(trains, tmp_path):
    assert costs_of_a_run(replace(trains, encoder={}), tmp_path).index.tolist() == ["network"]


def test_the_rate_reaches_the_ledger_of_a_classifier(trains, classifier):
    of_encoder = classifier.costs(nt.windows(trains, nt.Window(length_ms=LENGTH_ms)).X).set_index("name").loc["encoder"]
    assert of_encoder["multiplications"] == encoding(trains).multiplications
    windows = nt.windows(unknown(trains), nt.Window(length_ms=LENGTH_ms))
    other = nt.SpikingClassifier(hidden=4, epochs=1, batch=8, random_state=0).fit(windows.X, windows.y)
    with pytest.warns(UserWarning, match="the ledger has the network alone: conditioning and encoding are not counted"):
        assert other.costs(windows.X)["name"].tolist() == ["network"]


@pytest.mark.parametrize("rate_Hz", [RECORDED_Hz, 1000.0])
def test_the_rate_of_a_live_stream_is_that_of_its_samples(trains, recordings, classifier, rate_Hz):
    network = classifier.network_
    chain = chain_of((ENCODER, network), nt.Streamed(sampling_rate_Hz=rate_Hz, length_ms=LENGTH_ms))
    decision = Stream(chain).push(np.asarray(recordings.signals[0]))[0]
    into_hidden, into_readout = 4 * decision.input_spikes, 2 * decision.hidden_spikes
    measured = {"sops_input": into_hidden, "sops_recurrent": decision.sops - into_hidden - into_readout,
                "sops_readout": into_readout}  # fmt: skip
    alone = network_cost(network.spec, 4, 2, measured, steps=decision.steps, signal_ms=decision.ms)
    made = encoding_cost(2, decision.steps, decision.ms, trains.encoder, recorded_Hz=rate_Hz)
    assert cost_nJ(chain, decision) == pytest.approx((alone + made).energy_nJ(MEMORY_45NM))


def test_the_rate_reaches_what_survives(recordings, trains):
    found = survival_of(recordings, ENCODER).table.iloc[-1]
    assert found["energy_nJ_per_s"] == pytest.approx(encoding(trains, CLOCK_Hz).energy_nJ(MEMORY_45NM))


def test_a_report_says_at_which_rates_encoding_runs_or_counts_no_energy(trains):
    decision = Decision(0.9, 1000.0, LENGTH_ms, 100.0, 500.0)
    judged = SimpleNamespace(cheapest=SimpleNamespace(used=decision), is_above_chance=True)
    study = SimpleNamespace(encoding_in="processor", network=nt.RSNNSpec(hidden=4), prices=ARITHMETIC_45NM)
    (said,) = front._of_encoding(judged, [Afferents.of(trains)], study)
    assert f"take {wording.energy(encoding(trains).energy_estimate_nJ)} of 500 nJ" in said
    assert "at 2000 samples per second of a moving average and 200 steps per second" in said
    rough = {key: value for key, value in trains.encoder["conditioning"].items() if key != "ema_cutoff_Hz"}
    (said,) = front._of_encoding(
        judged, [Afferents.of(replace(trains, encoder={**trains.encoder, "conditioning": rough}))], study
    )
    assert ", at 200 steps per second" in said
    left_out = Afferents.of(unknown(trains))
    assert not [*front._of_encoding(judged, [left_out], study)]
    sops = {"sops_input": 8.0, "sops_recurrent": 1.0, "sops_readout": 1.0, "sops_total": 10.0}
    row = pd.DataFrame([{"hidden": 4, "window_steps": 20, "exit_steps": 20, **sops,
                         **{f"exit_{name}": value for name, value in sops.items()}}])  # fmt: skip
    known, missing = (front.costs_of(study, row, [made_by], 2).iloc[0] for made_by in (Afferents.of(trains), left_out))
    assert known["whole_ms"] == missing["whole_ms"] == LENGTH_ms
    assert known["whole_nJ"] > 0
    assert np.isnan(missing["whole_nJ"])
    sensor = SimpleNamespace(encoding_in="sensor", network=study.network, prices=study.prices)
    in_sensor = front.costs_of(sensor, row, [left_out], 2)
    assert in_sensor["whole_nJ"].iloc[0] > 0


def test_a_report_without_the_rate_has_no_ledger_and_says_why(trains, monkeypatch):
    said, study = [], SimpleNamespace(network=nt.RSNNSpec(hidden=4))
    monkeypatch.setattr(networks, "say", said.append)
    made_by = Afferents.of(unknown(trains))
    assert networks._ledger(study, pd.DataFrame([{"pair": "1&1"}]), None, [made_by], 2) is None
    assert said == [f"report: {NOT_COUNTED}"]


def test_energies_at_two_price_lists_are_not_compared(tmp_path):
    """Baselines of an earlier version have no kinds of operations, and the others the price of an addition."""
    pd.DataFrame([{"macs": 1.0, "other_flops": 2.0}]).to_csv(tmp_path / "baselines.csv", index=False)
    with pytest.raises(InputError, match=r"baselines\.csv: an earlier version wrote it.*run the study in a new folder"):
        tables.tables_beside(SimpleNamespace(baselines="linear"), tmp_path)


def test_the_sentence_below_a_ledger_has_the_prices_of_the_table():
    assert ARITHMETIC_45NM.in_words() == (
        "Energy is an estimate of the arithmetic alone, without memory, by the price list arithmetic-45nm: 4.6 pJ per "
        "MAC, 0.9 pJ per addition or comparison, 3.7 pJ per other multiplication, 9.2 pJ per division, 18.4 pJ per "
        "exponential, 32-bit floating point at 45 nm (Horowitz, ISSCC 2014)."
    )
    other = PriceList(source="me", multiplication_pJ=1, addition_pJ=2, comparison_pJ=3)
    assert "2 pJ per addition, 3 pJ per comparison, 1 pJ" in other.in_words()
