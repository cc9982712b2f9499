"""The stiffness paper's Tables I to III and the touch modality paper's Table I, entry by entry."""

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies import published_flops as published

from neurotact.errors import InputError

BASE = {"4F": 2404, "8F": 4224, "16F": 6672}
FEATURES = {"4F": 4, "8F": 8, "16F": 16}
TABLE_III = {
    # FLOPs of 4F, 8F, 16F at N_max = 100, and the differences printed at 50, 200 and 300.
    "R-FC": {100: (3444, 5448, 8592), 50: (-320, -408, -560), 200: (576, 840, 400), 300: (1616, 1176, 1080)},
    "S-FC": {100: (3972, 6024, 9116), 50: (-532, -432, -676), 200: (532, 648, 884), 300: (1260, 1224, 2496)},
    "R-ELM": {100: (3924, 6504, 10472), 50: (-720, -1080, -1800), 200: (1424, 1992, 3360), 300: (2336, 3024, 5520)},
    "S-ELM": {100: (5064, 7752, 11456), 50: (-1288, -1728, -2236), 200: (2044, 3024, 4108), 300: (3388, 5148, 6864)},
    "H-ELM": {100: (3556, 6164, 10128), 50: (-588, -960, -1692), 200: (1212, 1860, 3384), 300: (2196, 3340, 6156)},
}
ENTRIES = [
    (classifier, n_max, features, rows[100][i] + (rows[n_max][i] if n_max != 100 else 0))
    for classifier, rows in TABLE_III.items()
    for n_max in (50, 100, 200, 300)
    for i, features in enumerate(BASE)
]


@given(st.integers(1, 10**6))
def test_table_i(n):
    assert published.moving_average_flops(n) == 3 * n
    assert published.mean_flops(n) == n + 1
    assert published.std_flops(n) == 3 * n + 5
    assert published.skewness_flops(n) == 2 * n + 7
    assert published.kurtosis_flops(n) == 2 * n + 5


@given(st.integers(1, 10**4), st.integers(1, 10**3), st.integers(1, 100))
def test_table_ii(N, nf, nc):
    assert published.slfn_flops("S-ELM", N, nf, nc) == N * (2 * nf + 14) + 2 * nc * N
    assert published.slfn_flops("S-FC", N, nf, nc) == N * (2 * nf + 14) + 2 * nc * N
    assert published.slfn_flops("R-ELM", N, nf, nc) == N * (2 * nf + 2) + 2 * nc * N
    assert published.slfn_flops("R-FC", N, nf, nc) == N * (2 * nf + 2) + 2 * nc * N
    assert published.slfn_flops("H-ELM", N, nf, nc) == N * (2 * nf + 1) + nc * N


def test_what_a_peak_costs_before_the_classifier():
    # 150 samples: the average 450, mean 151, STD 455, skewness 307, kurtosis 305; four channels.
    assert published.preprocessing_flops("4F") == 4 * (450 + 151) == 2404
    assert published.preprocessing_flops("8F") == 4 * (450 + 151 + 455) == 4224
    assert published.preprocessing_flops("16F") == 4 * (450 + 151 + 455 + 307 + 305) == 6672


@pytest.mark.parametrize(("classifier", "n_max", "features", "flops"), ENTRIES)
def test_every_entry_of_table_iii_is_a_whole_mean_number_of_neurons(classifier, n_max, features, flops):
    per_neuron = published.slfn_flops(classifier, N=1, nf=FEATURES[features], nc=3)
    neurons = Fraction(flops - BASE[features], per_neuron)
    assert neurons.denominator == 1
    assert 25 <= neurons <= n_max
    assert published.slfn_unit_flops(classifier, features, int(neurons)) == flops


def test_table_iii_at_8f_of_r_fc():
    assert (5448 - 4224) / 24 == 51
    assert published.slfn_unit_flops("R-FC", "8F", 51) == 5448


def test_which_means_of_table_iii_ten_splits_could_give():
    """Every N is a multiple of 25, so a mean over 10 is a multiple of 2.5, and one over 100 a multiple of 0.25.

    All 60 means are whole: they are means of 100, or rounded. Of the 24 of the FC networks, said to be means over 10
    splits, 7 could be, and 13 when they were rounded (47.5 to 47 or 48).
    """
    fc = [
        (flops - BASE[features]) // published.slfn_flops(classifier, N=1, nf=FEATURES[features], nc=3)
        for classifier, _, features, flops in ENTRIES
        if classifier.endswith("FC")
    ]
    tens = [2.5 * i for i in range(10, 121)]
    assert len(fc) == 24
    assert sorted(N for N in fc if N in tens) == [45, 50, 65, 75, 75, 95, 100]
    assert sum(any(abs(N - mean) <= 0.5 for mean in tens) for N in fc) == 13
    assert {N for N in fc if not any(abs(N - mean) <= 0.5 for mean in tens)} >= {34, 51, 86, 101, 166}


def test_the_published_blocks_of_lstm_and_gru():
    assert published.touch_modality_flops("LSTM", 10) == 2950
    assert published.touch_modality_flops("GRU", 10) == 2228
    assert published.touch_modality_flops("GRU", 12) == 2960


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: published.slfn_flops("T-ELM", 1, 1, 1), "did you mean"),  # type: ignore[arg-type]
        (lambda: published.preprocessing_flops("12F"), "'12F'"),  # type: ignore[arg-type]
        (lambda: published.touch_modality_flops("RNN", 10), "LSTM or GRU"),  # type: ignore[arg-type]
    ],
)
def test_what_no_paper_counts_is_refused(call, complaint):
    with pytest.raises(InputError, match=complaint):
        call()
