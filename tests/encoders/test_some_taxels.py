"""Populations under some of the taxels: the afferents that are left spike as those of the whole encoder."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import make_chain, make_encoder, make_signal, offline, told
from neurotact_parts.streams.chain import chain_of
from neurotact_parts.streams.stream import Stream
from neurotact_parts.studies.comparison.needed_afferents import columns_of, encoder_without, need_of, pairs_of, ranked

import neurotact as nt
from neurotact.backend import native
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders import afferents, closed_form, encoding
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.calibration import CalibrationRule, calibrate
from neurotact.encoders.cost import encoding_cost
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.firing import complaints
from neurotact.encoders.specs import afferent_names, is_exact, load, taxel_names, taxels_of
from neurotact.errors import InputError
from neurotact.metrics.prices import price_list
from neurotact.networks.exit.rule import ExitRule

TAXELS = 11  # more than a group of the compiled stream, so that a whole group may be left out
NAMES = tuple(f"t{i}" for i in range(TAXELS))
BACKENDS = ["reference", *(["native"] if native else [])]
KINDS = [
    {}, {"sa1.grades": [0.5, 1.0]}, {"sa1.opposite": True}, {"ra1.change": "both"}, {"sa1.rate_ms": 20.0},
    {"integration": "exact"}, {"integration": "exact", "sa1.opposite": True, "ra1.change": "off"},
]  # fmt: skip
CONDITIONED = [
    {}, {"ema_cutoff_Hz": 60.0, "baseline": "start", "start_ms": 20.0}, {"baseline": "mean"},
    {"baseline": "high-pass", "resample_Hz": 2000.0},
    {"offset": [*np.linspace(-1, 1, TAXELS)], "scale": [*np.linspace(-2, -0.5, TAXELS)]},
]  # fmt: skip
subsets = st.lists(st.integers(0, TAXELS - 1), max_size=TAXELS, unique=True)


@st.composite
def encoders(draw) -> tuple[AfferentSpec, AfferentSpec]:
    """An encoder and the same with populations under some taxels."""
    whole = make_encoder(draw(st.sampled_from(KINDS)), **draw(st.sampled_from(CONDITIONED)))
    chosen = {part: draw(st.none() | subsets) for part in ("sa1", "ra1")}
    if not any(its is None or its for its in chosen.values()):
        chosen["ra1"] = [draw(st.integers(0, TAXELS - 1))]
    table = whole.model_dump()
    for part, its in chosen.items():
        table[part]["taxels"] = its
    return whole, AfferentSpec.model_validate(table)


def kept(whole: AfferentSpec, some: AfferentSpec) -> list[int]:
    names = afferent_names(NAMES, whole.model_dump())
    left = {*afferent_names(NAMES, some.model_dump())}
    return [index for index, name in enumerate(names) if name in left]


def rasters(trains: SpikeTrains) -> list[np.ndarray]:
    made = [np.zeros((n, len(trains.afferents)), np.uint8) for n in trains.trial_steps]
    for raster, steps, units in zip(made, trains.steps, trains.units, strict=True):
        raster[steps, units] = 1
    return made


def recorded(n: int = 2, n_steps: int = 150) -> Recordings:
    signals = [make_signal(n_steps + 7 * k, TAXELS, seed=k) for k in range(n)]
    return Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": ["ab"[k % 2] for k in range(n)]}), NAMES)


@given(encoders(), st.sampled_from(BACKENDS), st.integers(1, 100))
@examples(60)
def test_the_afferents_left_spike_as_those_of_the_whole_encoder_in_pieces_too(pair, backend, cut):
    whole, some = pair
    signal = np.stack([make_signal(120, TAXELS, seed=k) for k in range(2)])
    encode = closed_form.encode if is_exact(whole) else afferents.encode
    expected = encode(signal, 1000.0, whole, backend=backend)[0][..., kept(whole, some)]
    first, state = encode(signal[:, :cut], 1000.0, some, backend=backend)
    rest, _ = encode(signal[:, cut:], 1000.0, some, state, backend=backend)
    np.testing.assert_array_equal(np.concatenate([first, rest], axis=1), expected)


@given(encoders())
@examples(40)
def test_recordings_give_the_same_spikes_names_and_digests(pair):
    whole, some = pair
    touches = recorded()
    expected, found = encode_recordings(touches, whole), encode_recordings(touches, some)
    index = kept(whole, some)
    assert found.afferents == tuple(expected.afferents[i] for i in index)
    for raster, of_whole in zip(rasters(found), rasters(expected), strict=True):
        np.testing.assert_array_equal(raster, of_whole[:, index])
    assert taxels_of(len(found.afferents), found.encoder) == TAXELS
    assert taxel_names(found.afferents, found.encoder) == NAMES


@pytest.mark.parametrize("baseline", ["start", "mean"])
def test_a_long_trial_gives_the_same_spikes(baseline, monkeypatch):
    monkeypatch.setattr("neurotact.data.conditioning.PIECE_VALUES", 300)
    monkeypatch.setattr(encoding, "PIECE_VALUES", 300)
    whole = make_encoder(baseline=baseline)
    some = make_encoder({"sa1.taxels": [3], "ra1.taxels": [3, 9]}, baseline=baseline)
    expected, found = (rasters(encode_recordings(recorded(1), each))[0] for each in (whole, some))
    np.testing.assert_array_equal(found, expected[:, kept(whole, some)])


@pytest.mark.parametrize("baseline", ["start", "mean"])
def test_only_taxels_that_are_used_are_conditioned(baseline, monkeypatch):
    seen = []
    own = encoding.condition
    monkeypatch.setattr(encoding, "condition", lambda touches, how: seen.append(touches.channels) or own(touches, how))
    encode_recordings(recorded(), make_encoder({"sa1.taxels": [3], "ra1.taxels": [9, 3]}, baseline=baseline))
    assert seen == [("t3", "t9") if baseline == "start" else NAMES]  # a mean adds in another order


@given(
    encoders(),
    st.sampled_from([None, 4]),
    st.sampled_from(["auto", "reference"]),
    st.sampled_from([None, "auto", "reference"]),
)
@examples(25)
def test_a_stream_decides_as_encode_and_infer_do(pair, patience, backend, after):
    _, some = pair
    how = some.conditioning
    if how.baseline == "mean":
        how = how.model_copy(update={"baseline": "none"})
    some = some.model_copy(update={"conditioning": how, "recorded_taxels": NAMES})
    n_inputs = len(afferent_names(NAMES, some.model_dump()))
    network = nt.RSNN(
        n_inputs, 3, sampling_rate_Hz=how.clock_Hz(1000.0), hidden=5, forward_weight_scale=3.0,
        recurrent_weight_scale=0.4,
    )  # fmt: skip
    chain = chain_of((some, network), nt.Streamed(sampling_rate_Hz=1000.0, length_ms=40))
    chain = chain._replace(rule=ExitRule(patience))
    signal = make_signal(150, TAXELS)
    _, expected = offline(chain, signal)
    stream = Stream(chain, backend=backend)
    found = stream.push(signal[:61])
    if after is not None:
        state, stream = stream.state(), Stream(chain, backend=after)
        stream.restore(state)
    found += [*stream.push(signal[61:]), *stream.finish()]
    assert told(found)[: len(expected)] == expected
    assert expected


@pytest.mark.parametrize("backend", ["auto", "reference"])
def test_a_missing_value_counts_only_where_it_is_used(backend):
    chain = make_chain({}, n_taxels=3, afferents={"sa1.taxels": [2], "ra1.taxels": [0], "recorded_taxels": [*"abc"]})
    signal = make_signal(80, 3)
    without = told(Stream(chain, backend=backend).push(signal))
    signal[10:60, 1] = np.nan
    stream = Stream(chain, backend=backend)
    assert told(stream.push(signal)) == without
    assert stream.tally.held == 0
    signal[10, 2] = np.nan
    other = Stream(chain, backend=backend)
    other.push(signal)
    assert other.tally.held == 1


def test_a_running_stream_keeps_its_taxels():
    chain = make_chain({}, n_taxels=3, afferents={"sa1.taxels": [2], "recorded_taxels": [*"abc"]})
    table = chain.encoder.model_dump()
    table["sa1"]["taxels"] = [1]
    with pytest.raises(InputError, match="or taxels; a running stream"):
        Stream(chain).changed(encoder=AfferentSpec.model_validate(table))


def by_loops(encoder: AfferentSpec, n_taxels: int, steps: int) -> dict[str, float]:
    """Operations of the afferents and of a moving average, one after the other."""
    counted = dict.fromkeys(("macs", "acs", "comparisons", "multiplications", "states_accesses", "weights_accesses"), 0)
    of_sa1, of_ra1 = encoder.columns(n_taxels)
    for _ in range(steps):
        for taxel in range(n_taxels):
            n_sa1 = len(encoder.sa1.gains) * (taxel in of_sa1)
            n_ra1 = len(encoder.ra1.gains) * (taxel in of_ra1)
            rises = bool(encoder.sa1.rate_ms and n_sa1)
            for _ in range(n_sa1 + n_ra1):
                counted["macs"] += 2
                counted["comparisons"] += 1
                counted["states_accesses"] += 4
                counted["weights_accesses"] += 1
            counted["acs"] += bool(n_ra1) or rises
            counted["states_accesses"] += 2 * (bool(n_ra1) or rises)
            counted["comparisons"] += bool(n_ra1)
            counted["comparisons"] += rises
            counted["macs"] += rises
    return counted


ONSETS = make_encoder({"sa1.taxels": [0, 1], "ra1.taxels": [1, 2], "sa1.rate_ms": 20.0})


@given(st.just(ONSETS) | encoders().map(lambda pair: pair[1]), st.integers(1, 40))
@examples(40)
def test_only_what_is_computed_costs(some, steps):
    table = some.model_dump(mode="json") | {"conditioning": {}, "integration": "clock"}
    made = encoding_cost(TAXELS, steps, float(steps), table)
    expected = by_loops(some, TAXELS, steps)
    assert {key: getattr(made, key) for key in expected} == expected


@given(encoders(), st.sampled_from([1, 3]))
def test_conditioning_costs_what_it_costs_of_a_sensor_with_the_taxels_that_are_used(pair, factor):
    _, some = pair
    used, alone = some.of_used(TAXELS)
    rates = {"recorded_Hz": 1000.0 * factor, "spikes": 9.0}
    made, expected = (
        encoding_cost(n, 200, 200.0, spec.model_dump(mode="json", exclude_none=True), **rates)
        for n, spec in ((TAXELS, some), (len(used), alone))
    )
    assert made == expected


def test_an_exact_encoder_costs_at_most_the_spikes_of_the_afferents_left():
    table = {"integration": "exact", "recorded_Hz": 100.0, "sa1": {"taxels": [1]}, "ra1": {"taxels": []}}
    made = encoding_cost(4, 100, 100.0, table)
    assert made.flops == encoding_cost(4, 100, 100.0, table, spikes=100.0).flops


REFUSED = {
    "sa1.taxels: names taxel 4 of 4": {"sa1.taxels": [4]},
    "ra1.taxels: names taxel 7 of 4": {"ra1.taxels": [0, 7]},
    "names taxel 2 twice": {"sa1.taxels": [2, 1, 2]},
    "must not both be empty": {"sa1.taxels": [], "ra1.taxels": []},
    "must be >= 0; got -1": {"sa1.taxels": [-1]},
}


@pytest.mark.parametrize("message", REFUSED)
def test_taxels_that_cannot_be_are_refused(message):
    touches = Recordings([make_signal(50, 4)], 1000.0, "mV", ["a"])
    with pytest.raises(InputError, match=message):
        encode_recordings(touches, load("sa1-ra1-lif", REFUSED[message]))


def test_taxels_beyond_known_ones_are_refused_where_the_spec_is_read():
    for known in ({"offset": [0.0] * 3}, {"scale": [1.0] * 3}, {"taxels": ["a", "b", "c"]}):
        with pytest.raises(InputError, match="names taxel 3 of 3"):
            load("sa1-ra1-lif", {"sa1.taxels": [3], **{f"conditioning.{key}": its for key, its in known.items()}})


def test_other_models_refuse_the_key_in_one_sentence():
    with pytest.raises(InputError, match=r"taxels"):
        load("izhikevich", {"sa1.taxels": [0]})


def test_recordings_of_other_taxels_are_refused_where_those_of_the_encoder_are_known():
    trains = encode_recordings(recorded(), load("sa1-ra1-lif", {"sa1.taxels": [1], "ra1.taxels": [0]}))
    table = AfferentSpec.model_validate(trains.encoder)
    few = Recordings([make_signal(50, 4)], 1000.0, "mV", ["a"])
    with pytest.raises(InputError, match="has 4 taxels where"):
        encode_recordings(few, table)
    turned = recorded().of_taxels([*range(TAXELS)][::-1])  # put into the order of their names
    for ours, theirs in zip(rasters(encode_recordings(turned, table)), rasters(trains), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_chain_needs_the_number_of_taxels_and_the_encoder_of_its_network():
    encoder = load("sa1-ra1-lif", {"sa1.taxels": [1], "ra1.taxels": [0, 1], "conditioning.baseline": "start"})
    with pytest.raises(InputError, match="do not say how many taxels a sample has"):
        chain_of((encoder, nt.RSNN(3, 2, sampling_rate_Hz=1000.0)))
    known = encoder.model_copy(update={"recorded_taxels": ("a", "b", "c")})
    assert chain_of((known, nt.RSNN(3, 2, sampling_rate_Hz=1000.0))).n_taxels == 3
    with pytest.raises(InputError, match=r"receives 4 afferents where sa1\.taxels and ra1\.taxels give 3"):
        chain_of((known, nt.RSNN(4, 2, sampling_rate_Hz=1000.0)))
    one = load("sa1-ra1-lif", {"sa1.taxels": [1], "conditioning.baseline": "start"})
    assert chain_of((one, nt.RSNN(9, 2, sampling_rate_Hz=1000.0))).n_taxels == 8


def test_calibration_gives_the_gains_of_all_taxels():
    rng = np.random.default_rng(0)
    signals = [rng.normal(0, 1 + k % 2, (600, 3)).cumsum(axis=0) / 9 for k in range(8)]
    touches = Recordings(signals, 1000.0, "mV", ["ab"[k % 2] for k in range(8)])
    rule = CalibrationRule(candidates=8)
    whole, some = (
        calibrate(touches, load("sa1-ra1-lif", given), rule=rule, tell=False).encoder
        for given in ({}, {"sa1.taxels": [], "ra1.taxels": [0, 2]})
    )
    assert (some.sa1.taxels, some.ra1.taxels) == ((), (0, 2))
    assert (some.sa1.gain, some.ra1.gain, some.conditioning) == (whole.sa1.gain, whole.ra1.gain, whole.conditioning)


def test_a_population_that_nobody_asked_for_is_not_silent():
    encoder = load("sa1-ra1-lif", {"sa1.taxels": []})
    assert [*complaints(np.array([3, 4]), 1000, 1000.0, encoder)] == []
    assert "no RA-I" in next(complaints(np.array([0, 0]), 1000, 1000.0, encoder))


@given(encoders(), st.integers(0, 2**32))
def test_the_columns_of_pairs_are_the_afferents_of_the_encoder_with_them_alone(pair, seed):
    whole, _ = pair
    names = afferent_names(NAMES, whole.model_dump())
    rng = np.random.default_rng(seed)
    keep = [(part, i) for part in ("sa1", "ra1") for i in range(TAXELS) if rng.random() < 0.4] or [("ra1", 3)]
    left = afferent_names(NAMES, encoder_without(whole, keep).model_dump())
    assert tuple(names[i] for i in columns_of(whole, keep, len(names))) == left


def test_pairs_are_ranked_by_weights_and_by_the_spread_of_their_spikes():
    network = nt.RSNN(4, 2, sampling_rate_Hz=1000.0, hidden=3)
    with torch.no_grad():
        network.w_in[:] = torch.tensor([[9.0], [1.0], [2.0], [0.1]])
    spikes = torch.zeros(6, 20, 4, dtype=torch.uint8)
    spikes[:, :, 0] = 1  # always alike
    spikes[:3, ::2, 1:] = 1
    order = ranked(network, spikes, load("sa1-ra1-lif"))
    assert [*order] == [("ra1", 0), ("sa1", 1), ("ra1", 1), ("sa1", 0)]
    # one after the other, by a loop
    windows, ends = spikes.double().numpy(), [0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20]
    for afferent, found in enumerate(need_of(spikes, [network.w_in.detach()])):
        spread = sum(np.var(windows[:, a:b, afferent].sum(axis=1)) for a, b in pairwise(ends))
        assert found == pytest.approx(3 * float(network.w_in[afferent, 0].detach()) ** 2 * spread)


@pytest.mark.parametrize("keys", [{"hidden": 0}, {"hidden": 3, "direct": True}])
def test_pairs_are_ranked_by_the_weights_to_a_readout_that_hears_them(keys):
    network = nt.RSNN(4, 2, sampling_rate_Hz=1000.0, readout="integrator", **keys)
    with torch.no_grad():
        network.w_in.zero_()
        network.w_out[-4:] = torch.tensor([[1.0], [3.0], [0.1], [2.0]])
    spikes = torch.zeros(6, 20, 4, dtype=torch.uint8)
    spikes[:3, ::2] = 1
    order = ranked(network, spikes, load("sa1-ra1-lif"))
    assert [*order] == [("sa1", 1), ("ra1", 1), ("sa1", 0), ("ra1", 0)]


def test_pairs_are_ranked_by_what_they_save_where_energy_is_priced():
    """The rank is that of taking away, one after the other, the pair or the taxel with the least need per energy."""
    rng = np.random.default_rng(1)
    encoder = make_encoder(ema_cutoff_Hz=30.0, baseline="start")
    spikes = torch.from_numpy((rng.random((9, 40, 8)) < rng.random(8)).astype(np.uint8))
    generator, prices = torch.Generator().manual_seed(0), price_list("memory-45nm")
    network = nt.RSNN(8, 2, sampling_rate_Hz=1000.0, hidden=3, generator=generator)
    need = dict(zip(pairs_of(encoder, 8), need_of(spikes, [network.w_in.detach()]).tolist(), strict=True))

    def energy(keep) -> float:
        table = encoder_without(encoder, keep).model_dump(mode="json", exclude_none=True) if keep else None
        return encoding_cost(4, 40, 40.0, table, spikes=0.0).energy_nJ(prices) if table else 0.0

    left, gone = {*need}, []
    while left:
        ways = [{pair} for pair in left] + [{p for p in left if p.taxel == taxel} for taxel in range(4)]
        ways = [way for way in ways if way]
        worth = [sum(need[pair] for pair in way) / (energy(left) - energy(left - way)) for way in ways]
        gone.append(ways[int(np.argmin(worth))])
        left -= gone[-1]
    order = ranked(network, spikes, encoder, prices=prices)
    for way in gone:
        assert {*order[len(order) - len(way) :]} == way
        del order[len(order) - len(way) :]
    assert any(len(way) == 2 for way in gone)
    assert order == []
