"""The ledger against loops over single numbers, which count their own additions, multiplications and comparisons.

A loop is right where its result is that of the code that it repeats.
"""

import math
from collections import Counter

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.comparison.tasks import LevelSpreadRate

from neurotact.baselines.features import BandPowers
from neurotact.data import conditioning
from neurotact.data.conditioning import Conditioner, ConditioningSpec, ema_coefficient
from neurotact.encoders import afferents, specs
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.cost import encoding_cost, is_countable
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, Moments
from neurotact.metrics.prices import ARITHMETIC_45NM

PARTS = ("acs", "multiplications", "comparisons", "divisions")


class Counted(float):
    """A number whose operations are counted in `spent`, by the kinds of the ledger; a MAC as its two parts."""

    spent: Counter[str] = Counter()

    def _new(self, kind: str, value: float) -> "Counted":
        Counted.spent[kind] += 1
        return Counted(value)

    def __add__(self, other):
        return self._new("acs", float(self) + float(other))

    __radd__ = __add__

    def __sub__(self, other):
        return self._new("acs", float(self) - float(other))

    def __mul__(self, other):
        return self._new("multiplications", float(self) * float(other))

    __rmul__ = __mul__

    def __truediv__(self, other):
        return self._new("divisions", float(self) / float(other))

    def __abs__(self):
        return self._new("comparisons", math.fabs(self))

    def root(self) -> "Counted":
        return self._new("divisions", math.sqrt(self))

    def is_at_least(self, other: float) -> bool:
        return bool(self._new("comparisons", float(self) >= other))


def counted(values) -> list[list[Counted]]:
    """Rows of counted numbers; the count begins anew."""
    Counted.spent = Counter()
    return [[Counted(value) for value in row] for row in np.asarray(values, float).tolist()]


def parts(spent: Cost) -> dict[str, float]:
    """The operations of a cost, with a MAC as the two that it is."""
    kinds = {kind: getattr(spent, kind) for kind in PARTS}
    return {**kinds, "acs": spent.acs + spent.macs, "multiplications": spent.multiplications + spent.macs}


def tally() -> dict[str, float]:
    return {kind: Counted.spent[kind] for kind in PARTS}


# --- conditioning -----------------------------------------------------------------------------------


def averaged(samples: list[Counted], weight: float) -> list[Counted]:
    """The moving average of one channel."""
    before, result = samples[0], []
    for sample in samples:
        before = weight * sample + (1 - weight) * before
        result.append(before)
    return result


def resampled(channel: list[Counted], stride: float, *, is_first: bool) -> list[Counted]:
    """Linear interpolation of one channel; the place is of all channels and counted with the first."""
    place, left, result = Counted(0.0) if is_first else 0.0, 0, []
    for _ in range(round(len(channel) / stride)):
        while float(place) >= left + 1:
            left += 1
        if is_first:
            Counted(place).is_at_least(left + 1)
        right = channel[min(left + 1, len(channel) - 1)]
        result.append(channel[left] + (float(place) - left) * (right - channel[left]))
        place = place + stride
    return result


def levels(channel: list[Counted], how: ConditioningSpec, clock_Hz: float) -> list[Counted | float]:
    """The baseline at each step of one channel."""
    n = len(channel)
    if how.baseline == "mean":
        return [sum(channel[1:], channel[0] + 0.0) * (1 / n)] * n
    if how.baseline == "high-pass":
        return [*averaged(channel, ema_coefficient(how.high_pass_Hz, clock_Hz))]
    last = max(1, round(1e-3 * how.start_ms * clock_Hz))
    total, result = Counted(0.0), []
    for index, step in enumerate(channel[:last]):
        total = total + step
        result.append(total / (index + 1))
    return result + result[-1:] * (n - len(result))


def conditioned(channel: list[Counted], rate_Hz: float, how: ConditioningSpec, number: int) -> list[Counted]:
    """`data.conditioning` of one channel."""
    clock_Hz = how.clock_Hz(rate_Hz)
    if how.ema_cutoff_Hz is not None:
        channel = averaged(channel, ema_coefficient(how.ema_cutoff_Hz, rate_Hz))
    if clock_Hz != rate_Hz:
        channel = resampled(channel, rate_Hz / clock_Hz, is_first=number == 0)
    if how.baseline != "none":
        channel = [step - level for step, level in zip(channel, levels(channel, how, clock_Hz), strict=True)]
    scale = 1.0 if how.scale is None else how.scale[number]
    if how.scale is not None or how.offset is not None:
        channel = [step * (1 / scale) for step in channel]
    if how.offset is not None:
        channel = [step - how.offset[number] / scale for step in channel]
    return [abs(step) for step in channel] if how.rectify else channel


RATES_HZ = (200.0, 500.0, 1000.0, 2000.0)
ways_to_condition = st.fixed_dictionaries(
    {"baseline": st.sampled_from(["none", "mean", "start", "high-pass"]), "rectify": st.booleans()},
    optional={
        "ema_cutoff_Hz": st.just(30.0), "resample_Hz": st.sampled_from(RATES_HZ), "offset": st.just([0.5, -1.0]),
        "scale": st.just([2.0, 0.5]),
    },
)  # fmt: skip


@given(ways_to_condition, st.sampled_from(RATES_HZ), st.sampled_from([20.0, 60.0]), st.sampled_from([10.0, 30.0]))
def test_each_step_of_conditioning_is_counted_where_it_runs(keys, rate_Hz, length_ms, start_ms):
    """The samples of the sensor pass the moving average, the steps of the clock all that follows."""
    how = ConditioningSpec(**keys, start_ms=start_ms)
    signal = np.random.default_rng(0).normal(size=(round(1e-3 * length_ms * rate_Hz), 2))
    rows = counted(signal.T)
    by_hand = np.array([conditioned(row, rate_Hz, how, number) for number, row in enumerate(rows)], float).T
    assert by_hand == pytest.approx(Conditioner(rate_Hz, how).whole(signal.astype(np.float32)), abs=1e-4)
    steps = 1e-3 * length_ms * how.clock_Hz(rate_Hz)
    tables = {"conditioning": how.model_dump()}, {}
    whole, bare = (encoding_cost(2, steps, length_ms, table, recorded_Hz=rate_Hz) for table in tables)
    assert {kind: value - parts(bare)[kind] for kind, value in parts(whole).items()} == tally()
    spent_nJ = ARITHMETIC_45NM.energy_nJ(tally())
    assert whole.energy_nJ() - bare.energy_nJ() == pytest.approx(spent_nJ)


@given(st.sampled_from([2000.0, 1000.0, 500.0, 200.0, 100.0]), st.sampled_from(["clock", "exact"]))
def test_samples_that_pass_are_samples_that_count(clock_Hz, integration):
    """Of the code itself: what the filter, the interpolation and the standardisation receive or give."""
    parameters = {"ema_cutoff_Hz": 30.0, "resample_Hz": clock_Hz, "scale": [2.0]}
    kinds = {"sa1": {"gain": 1.0}, "ra1": {"gain": 1.0}}
    spec = AfferentSpec.model_validate({"integration": integration, "conditioning": parameters, **kinds})
    passed: Counter[str] = Counter()

    def watched(name, run, of):
        def call(*args, **more):
            result = run(*args, **more)
            passed[name] += len(of(args, result))
            return result

        return call

    with pytest.MonkeyPatch.context() as patch:
        for name, of in (
            ("ema", lambda args, _: args[0]),
            ("interpolated", lambda _, result: result),
            ("standardised", lambda args, _: args[0]),
        ):
            patch.setattr(conditioning, name, watched(name, getattr(conditioning, name), of))
        Conditioner(1000.0, specs.conditioning_of(spec, 1000.0)).whole(np.zeros((1000, 1), np.float32))
    table = spec.model_dump(mode="json")
    whole, unsmoothed, bare = (
        encoding_cost(
            1, clock_Hz, 1000.0, {**table, "conditioning": {**table["conditioning"], **left_out}},
            recorded_Hz=1000.0, spikes=0.0,
        )
        for left_out in ({}, {"ema_cutoff_Hz": None}, {"ema_cutoff_Hz": None, "scale": None})
    )  # fmt: skip
    assert whole.macs - unsmoothed.macs == passed["ema"] == 1000
    assert unsmoothed.multiplications - bare.multiplications == passed["standardised"]
    assert bare.macs == 4 * passed["standardised"] + passed["interpolated"]


@given(st.sampled_from([2000.0, 1000.0, 200.0]), st.integers(1, 3))
def test_a_moving_average_costs_the_same_at_each_clock(clock_Hz, n_taxels):
    plain = {"resample_Hz": clock_Hz}
    smoothed, rough = (
        encoding_cost(n_taxels, clock_Hz, 1000.0, {"conditioning": keys}, recorded_Hz=2000.0)
        for keys in ({"ema_cutoff_Hz": 30.0, **plain}, plain)
    )
    assert smoothed.macs - rough.macs == smoothed.multiplications - rough.multiplications == 2000 * n_taxels
    assert smoothed.energy_nJ() - rough.energy_nJ() == pytest.approx(1e-3 * 2000 * n_taxels * (4.6 + 3.7))


@pytest.mark.parametrize("integration", ["clock", "exact"])
def test_a_rate_that_is_not_known_is_no_guess(integration):
    for keys in ({"resample_Hz": 200.0}, {"ema_cutoff_Hz": 30.0, "resample_Hz": 200.0}):
        encoder = {"conditioning": keys, "integration": integration}
        assert not is_countable(encoder, None)
        with pytest.raises(InputError, match=r"encoder: conditioning and encoding are not counted.*give recorded_Hz"):
            encoding_cost(1, 200.0, 1000.0, encoder)
        own = encoding_cost(1, 200.0, 1000.0, {**encoder, "recorded_Hz": 500.0})
        assert own == encoding_cost(1, 200.0, 1000.0, {**encoder, "recorded_Hz": 9.0}, recorded_Hz=500.0)
    smooth = {"conditioning": {"ema_cutoff_Hz": 30.0}}  # at the rate of the recording, which is that of the steps
    assert encoding_cost(1, 200.0, 1000.0, smooth) == encoding_cost(1, 200.0, 1000.0, smooth, recorded_Hz=200.0)


# --- afferents --------------------------------------------------------------------------------------


@given(st.integers(1, 4), st.integers(2, 30))
def test_afferents_cost_what_a_loop_over_them_does(n_taxels, n_steps):
    """A membrane above rest: gain times drive and the decay, two MACs, and the comparison with the threshold."""
    signal = np.random.default_rng(n_steps).normal(size=(n_steps, n_taxels)) * 20
    spec = AfferentSpec.model_validate({"sa1": {"gain": 3.0, "t_ref_ms": 0.0}, "ra1": {"gain": 9.0, "t_ref_ms": 0.0}})
    raster = afferents.encode(signal[None].astype(np.float32), 1000.0, spec)[0][0]
    decay, fired = math.exp(-1.0 / spec.tau_mem_ms), np.zeros((n_steps, 2 * n_taxels), int)
    for taxel, samples in enumerate(counted(signal.T)):
        before, v = samples[0], [Counted(0.0), Counted(0.0)]
        for step, now in enumerate(samples):
            drives, before = (now, abs(now - before)), now
            for kind, (drive, gain) in enumerate(zip(drives, (3.0, 9.0), strict=True)):
                target = (1 - decay) * gain * drive + 0.0
                v[kind] = target + decay * v[kind]
                if v[kind].is_at_least(10.0):
                    v[kind], fired[step, kind * n_taxels + taxel] = Counted(0.0), 1
    assert (fired == raster).all()
    assert parts(encoding_cost(n_taxels, n_steps, n_steps, {})) == tally()


# --- features of opponents --------------------------------------------------------------------------


@given(st.integers(3, 40))
def test_moments_cost_what_loops_over_samples_do(n):
    values = np.random.default_rng(n).normal(size=n)
    (samples,) = counted([values])
    mean = sum(samples[1:], samples[0] + 0.0) * (1 / n)
    assert tally() == parts(Moments(n, order=1).cost())
    from_mean = [sample - mean for sample in samples]
    squares, total = [], Counted(0.0)
    for away in from_mean:
        squares.append(away * away)
        total = total + squares[-1]
    variance = total * (1 / n)
    deviation = variance.root()
    assert tally() == parts(Moments(n, order=2).cost())
    cubes = sum((square * away for square, away in zip(squares, from_mean, strict=True)), Counted(0.0))
    skewness = (cubes * (1 / n)) / (deviation * deviation * deviation)
    assert tally() == parts(Moments(n, order=3).cost())
    fourths = sum((square * square for square in squares), Counted(0.0))
    kurtosis = fourths / (total * variance)
    assert tally() == parts(Moments(n, order=4).cost())
    of_scipy = scipy.stats.skew(values), scipy.stats.kurtosis(values, fisher=False)
    assert [float(skewness), float(kurtosis)] == pytest.approx(of_scipy)


def test_level_spread_and_rate_cost_what_one_pass_does():
    values = np.random.default_rng(0).normal(size=20)
    (samples,) = counted([values])
    total, squares, changes, before = Counted(0.0), Counted(0.0), Counted(0.0), samples[0]
    for sample in samples:
        total, squares, changes = total + sample, squares + sample * sample, changes + abs(sample - before)
        before = sample
    level, rate = total * (1 / 20), changes * (1 / 19)
    spread = (squares * (1 / 20) - level * level).root()
    assert [level, spread, rate] == pytest.approx([values.mean(), values.std(), np.abs(np.diff(values)).mean()])
    assert tally() == parts(LevelSpreadRate(20).cost())


def fourier(values: list[tuple[Counted, Counted]]) -> list[tuple[Counted, Counted]]:
    """Radix 2, of complex numbers: four multiplications and six additions in each butterfly."""
    n = len(values)
    if n == 1:
        return values
    even, turned = fourier(values[::2]), []
    for index, (re, im) in enumerate(fourier(values[1::2])):
        c, s = math.cos(2 * math.pi * index / n), -math.sin(2 * math.pi * index / n)
        turned.append((re * c - im * s, re * s + im * c))
    pairs = list(zip(even, turned, strict=True))
    return [(a + c, b + d) for (a, b), (c, d) in pairs] + [(a - c, b - d) for (a, b), (c, d) in pairs]


@pytest.mark.parametrize("n", [8, 32])
def test_a_real_transform_costs_half_of_a_complex_one(n):
    values = np.random.default_rng(n).normal(size=n)
    (samples,) = counted([values])
    found = fourier([(sample, Counted(0.0)) for sample in samples])
    assert np.array([re + 1j * im for re, im in np.array(found, float)]) == pytest.approx(np.fft.fft(values))
    spent = BandPowers(n, bands=4).cost()
    assert spent.multiplications - n == tally()["multiplications"] / 2  # and the window
    assert spent.acs - n == tally()["acs"] / 2  # and the sums of bands
    assert (spent.macs, spent.exponentials) == (n, 4)
