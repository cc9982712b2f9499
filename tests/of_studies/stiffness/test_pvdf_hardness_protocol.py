"""The protocol of real hardness: on made presses everywhere, on the real ones where they lie."""

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.studies.stiffness import pvdf_hardness as hardness

from neurotact.data.dataset import expand
from neurotact.errors import InputError
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.studies import loading

NETWORK = {"neurons": (10,), "n_max": (10,), "exponents": (-2, 0), "draws": 2, "epochs": 20}
SPIKING = RSNNSpec(hidden=8, training=TrainingSpec(epochs=2, batch=16))
HERE = expand(hardness.HardnessData().path)

needs_presses = pytest.mark.skipif(
    not HERE.is_dir(), reason=f"the real presses are not at {HERE}; set NEUROTACT_DATA to where pvdf-hardness lies"
)


def made(n_classes=3, per_class=16, seed=0):
    """Presses of two taxels, deeper the harder the cube, in four sequences."""
    rng = np.random.default_rng(seed)
    n = n_classes * per_class
    cube = np.repeat(np.arange(n_classes), per_class)
    depth = 3.0 + 2.0 * cube + rng.normal(0, 0.3, n)
    time = np.arange(240)
    shape = np.exp(-0.5 * ((time - 80) / 25) ** 2)
    presses = -depth[:, None, None] * shape[:, None] * np.array([1.0, 0.4]) + rng.normal(0, 0.05, (n, 240, 2))
    labels = np.array([f"cube{c}" for c in cube])
    return {
        "presses": presses.astype(np.float32),
        "features": hardness.moments(presses).reshape(n, -1),
        "labels": labels,
        "sequence": np.tile(np.arange(1, 5), n // 4),
        "force_max_N": depth,
        "unfelt": np.array(0),
        "sampling_rate_Hz": np.array(2000.0),
    }


def parameters(**changes):
    given = {"chain": "R-ELM", "splits": 2, "network": NETWORK, "spiking": SPIKING, "starts": 1}
    return hardness.Parameters.model_validate({**given, **changes})


def test_single_layer_networks_have_a_row_a_split_and_feature_set():
    rows = pd.DataFrame(hardness.run(parameters(), made()))
    assert rows["features"].tolist() == ["2F", "2F", "4F", "4F", "8F", "8F"]
    assert set(hardness.VIEW.by) | set(hardness.VIEW.measures) <= set(rows.columns)
    assert rows["accuracy_test"].mean() > 0.8
    # Two channels of 240 samples by Table I, then Table II: 10 neurons, 2 features, 3 classes.
    assert rows["flops_published"].iloc[0] == 2 * (3 * 240 + 241) + 10 * (2 * 2 + 2) + 2 * 3 * 10
    assert (rows["signal_ms"] == 120.0).all()


def test_the_spiking_chain_is_on_the_same_splits_with_its_measured_operations():
    arrays = made(per_class=12)
    rows = pd.DataFrame(hardness.run(parameters(chain="RSNN"), arrays))
    assert rows["chain"].tolist() == ["RSNN", hardness.EARLY] * 2
    assert (rows["sops"] > 0).all()
    full, early = rows[rows["chain"] == "RSNN"], rows[rows["chain"] == hardness.EARLY]
    assert (full["signal_ms"] == 120.0).all()
    assert (early["sops"].to_numpy() <= full["sops"].to_numpy()).all()
    others = pd.DataFrame(hardness.run(parameters(), arrays))
    for side in ("train", "validation", "test"):
        assert set(rows[f"n_{side}"]) == set(others[f"n_{side}"])
    assert hardness.run(parameters(chain="RSNN"), arrays) == [
        {k: pytest.approx(v, nan_ok=True) if isinstance(v, float) else v for k, v in row.items()}
        for row in rows.to_dict("records")
    ]


def test_presses_are_smoothed_at_the_rate_of_the_sensor_at_any_clock():
    encoder = hardness.Parameters.model_validate({"chain": "RSNN"}).encoder
    slower = encoder.conditioning.model_copy(update={"resample_Hz": 500.0})
    kinds = {part: getattr(encoder, part).model_copy(update={"t_ref_ms": 2.0}) for part in ("sa1", "ra1")}
    given = parameters(chain="RSNN", encoder=encoder.model_copy(update={"conditioning": slower, **kinds}))
    full = next(row for row in hardness.run(given, made(per_class=12)) if row["chain"] == "RSNN")
    assert full["signal_ms"] == 120.0
    assert full["multiplications"] == 240 * 2


def test_a_feed_forward_network_is_charged_no_recurrent_weights():
    arrays = made(per_class=12)
    both = [
        pd.DataFrame(
            hardness.run(parameters(chain="RSNN", spiking=SPIKING.model_copy(update={"model": model})), arrays)
        )
        for model in ("rsnn", "snn")
    ]
    recurrent, feed_forward = (pd.DataFrame(rows)["parameters"] for rows in both)
    assert (recurrent - feed_forward == SPIKING.hidden**2).all()


def test_the_best_start_on_validation_is_kept():
    arrays = made(per_class=12)
    one, three = (pd.DataFrame(hardness.run(parameters(chain="RSNN", starts=n), arrays)) for n in (1, 3))
    assert (three["accuracy_validation"].to_numpy() >= one["accuracy_validation"].to_numpy()).all()


def test_a_tested_sequence_stands_on_no_other_side():
    arrays = made()
    splits = hardness.splits_of(arrays["labels"], arrays["sequence"], "by sequence", 10, 0)
    assert [set(arrays["sequence"][split.test]) for split in splits] == [{1}, {2}, {3}, {4}]
    for split in splits:
        assert not set(arrays["sequence"][split.test]) & set(arrays["sequence"][[*split.train, *split.validation]])
        assert sorted(np.concatenate(split)) == list(range(len(arrays["labels"])))


@pytest.mark.parametrize("chain", ["R-ELM", "R-FC", "RSNN"])
def test_what_only_test_presses_betray_is_at_chance(chain):
    """Presses without a class, but that the test presses of each split are as deep as their label says."""
    arrays = made(per_class=40, seed=3)
    rng = np.random.default_rng(1)
    shuffled = arrays["presses"][rng.permutation(len(arrays["labels"]))]
    found = []
    for seed in range(2):
        split = hardness.splits_of(arrays["labels"], arrays["sequence"], "by trial", 2, seed)[0]
        presses = shuffled.copy()
        presses[split.test] = arrays["presses"][split.test]
        planted = {**arrays, "presses": presses, "features": hardness.moments(presses).reshape(len(presses), -1)}
        rows = pd.DataFrame(hardness.run(parameters(chain=chain, seed=seed), planted))
        found.append(rows[rows["split"] == 0]["accuracy_test"].mean())
    # By the same depths a network that is trained on them is right: the plant is plain to see.
    honest = pd.DataFrame(hardness.run(parameters(chain="R-ELM"), arrays))["accuracy_test"].mean()
    assert honest > 0.8
    assert abs(np.mean(found) - 1 / 3) < 0.2


def test_figures_are_drawn_from_part_of_a_sweep():
    arrays = made()
    rows = pd.concat([pd.DataFrame(hardness.run(parameters(chain=c), arrays)) for c in ("R-ELM", "RSNN")])
    drawn = list(hardness.draw(rows, arrays))
    assert [figure.name for figure in drawn] == ["accuracy-and-cost", "presses"]
    assert "RSNN" in drawn[0].alt


def test_data_that_are_not_there_are_named():
    with pytest.raises(InputError, match="nowhere"):
        hardness.load(hardness.HardnessData(path="nowhere"))


@needs_presses
def test_every_real_press_is_found_after_the_arm_has_started():
    arrays = hardness.load(hardness.HardnessData())
    assert arrays["presses"].shape == (199, 600, 8)
    assert int(arrays["unfelt"]) == 0
    depths = -arrays["presses"].min(axis=(1, 2))
    assert 1.0 < depths.min() < depths.max() < 15.0


@needs_presses
def test_real_presses_tell_the_cubes_apart():
    arrays = hardness.load(hardness.HardnessData())
    network = {**NETWORK, "neurons": (50,), "n_max": (50,)}
    rows = pd.DataFrame(hardness.run(parameters(network=network), arrays))
    assert rows["accuracy_test"].mean() > 0.6  # chance is 0.2
    task = hardness.task(hardness.HardnessData())
    assert task.sequences.shape == (199, 600, 8)
    assert (len(task.groups), task.unit) == (199, "mV")


def test_the_shipped_study_sweeps_all_six_chains_both_ways():
    study = loading.resolve("pvdf-hardness")
    assert len([*loading.engine_of(study).cells(study)]) == 12
    assert study.parameters["spiking"]["forward_weight_scale"] == 0.1
