"""Fine-tuning: what is trained is exported, test trials are not seen, and no epoch changes nothing."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from levels import thinned
from made_chains import make_encoder, make_signal
from neurotact_parts.exporters.c import export, fine_tuning, formats
from neurotact_parts.exporters.c.rounding import Grid

import neurotact as nt
from neurotact import cli
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import epochs, run_folder, tasks, trainer
from neurotact.networks.training.epochs import Examples
from neurotact.networks.training.tasks import Task

N = 40
KINDS = {
    "spiking": {"hidden": 5, "forward_weight_scale": 3.0, "training": {"epochs": 3, "batch": 8}},
    "integrator": {"hidden": 5, "forward_weight_scale": 3.0, "readout": "integrator", "training": {"epochs": 3}},
}


def make_run(folder: Path, kind: str = "spiking", shown: int | None = None) -> Path:
    """A network of a few epochs with its spikes and recordings beside it; of trial `shown`, other samples."""
    signals = [make_signal(130, seed=k) * (1.0 if k % 2 else 1.6) for k in range(N)]
    if shown is not None:
        signals[shown] = signals[shown][::-1] * 0.7
    labels = pd.DataFrame({"label": [("felt", "silk")[k % 2] for k in range(N)]})
    folder.mkdir(parents=True, exist_ok=True)
    hdf5.save_recordings(Recordings(signals, 1000.0, "mV", labels), folder / "skin.h5")
    trains = encode_recordings(hdf5.load_recordings(folder / "skin.h5"), make_encoder(baseline="start"))
    hdf5.save_spikes(trains, folder / "spikes.h5")
    task = Task.model_validate({"window": {"length_ms": 40}})
    done, _ = trainer.fit(trains, RSNNSpec.model_validate(KINDS[kind]), task, (0, 1))
    run_folder.save(done, folder / "run", trains, folder / "spikes.h5", task)
    return folder / "run"


@pytest.fixture(scope="module", params=KINDS)
def run(tmp_path_factory, request):
    return make_run(tmp_path_factory.mktemp(request.param), request.param)


@pytest.fixture(scope="module")
def spiking(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("one"))


def whole_of(formats_) -> list[np.ndarray]:
    parts = [formats_.hidden.w, formats_.hidden.v, formats_.readout.w, getattr(formats_.readout, "bias", None)]
    return [part for part in parts if part is not None]


def weights_of(folder: Path) -> dict[str, torch.Tensor]:
    return dict(run_folder.load_network(folder)[0].state_dict())


@thinned("bits", [4, 2, 8])
def test_no_epoch_is_rounding_alone(run, bits, tmp_path):
    """The same whole numbers, in the same steps, as an export makes of the network without fine-tuning."""
    nt.fine_tune(run, tmp_path / "tuned", weight_bits=bits, epochs=0)
    rounded, tuned = export.prepared(run, weight_bits=bits).formats, export.prepared(tmp_path / "tuned").formats
    assert tuned.weight_bits == bits
    assert formats.Layers(tuned.hidden, tuned.readout).steps == formats.Layers(rounded.hidden, rounded.readout).steps
    for one, other in zip(whole_of(rounded), whole_of(tuned), strict=True):
        assert np.array_equal(one, other)


def test_with_many_bits_no_epoch_changes_nothing(run):
    """Steps as fine as float32: the weights stay, and with them every decision."""
    restored, again = run_folder.restore(run), run_folder.restore(run)
    sides = tasks.sides_of(run_folder.load_spikes_of(restored), restored.task)
    largest = max(float(weights.detach().abs().max()) for weights in restored.network.parameters())
    fine = formats.Steps(*(largest / 2**30 for _ in range(3)))
    grids = fine_tuning.grids_of(restored.network, fine, 32)
    network = restored.network
    fine_tuning.train_rounded(
        network, sides.train, sides.validation, grids, generator=torch.Generator().manual_seed(0), epochs=0
    )
    for name, weights in again.network.state_dict().items():
        assert torch.allclose(network.state_dict()[name], weights, rtol=2**-23, atol=largest / 2**31)
    found, expected = (each.infer(sides.test.spikes, restored.rule) for each in (network, again.network))
    assert all(torch.equal(one, other) for one, other in zip(found[:4], expected[:4], strict=True))


@thinned("bits", [3, 2, 5])
def test_what_was_seen_last_is_what_is_exported(run, bits, tmp_path, monkeypatch):
    """Of the best epoch: the weights of its forward pass are the exported whole numbers times their steps."""
    seen = []

    def looking(network, examples, judge=epochs.judge):
        seen.append({name: tensor.detach().clone() for name in ("w_in", "w_rec", "w_out", "bias")
                     if (tensor := getattr(network, name)) is not None})  # fmt: skip
        return judge(network, examples)

    monkeypatch.setattr(epochs, "judge", looking)
    nt.fine_tune(run, tmp_path / "tuned", weight_bits=bits, epochs=6)
    best = json.loads((tmp_path / "tuned" / "network.json").read_text())["extra"]["best_epoch"]
    assert len(seen) == 2 + 6  # training and validation windows before, validation windows after each epoch
    chosen = export.prepared(tmp_path / "tuned").formats
    steps = formats.Layers(chosen.hidden, chosen.readout).steps
    for (name, last), whole in zip(seen[best + 1].items(), whole_of(chosen), strict=True):
        step = getattr(steps, name, steps.w_out)
        assert torch.equal(last, torch.from_numpy(whole * step).float()), name
        assert torch.equal(last, weights_of(tmp_path / "tuned")[name]), name


def test_fine_tuning_moves_whole_weights_and_the_best_epoch_is_saved(spiking, tmp_path):
    nt.fine_tune(spiking, tmp_path / "rounded", weight_bits=3, epochs=0)
    nt.fine_tune(spiking, tmp_path / "tuned", weight_bits=3, epochs=6)
    log = pd.read_csv(tmp_path / "tuned" / "training.csv")
    assert list(log["epoch"]) == list(range(7))
    best = json.loads((tmp_path / "tuned" / "network.json").read_text())["extra"]["best_epoch"]
    assert best == int(log.loc[log["validation_loss"].idxmin(), "epoch"])
    assert best > 0
    rounded, tuned = (export.prepared(tmp_path / name).formats for name in ("rounded", "tuned"))
    assert not np.array_equal(rounded.hidden.w, tuned.hidden.w)
    assert rounded.hidden.w.shape == tuned.hidden.w.shape


def test_where_no_epoch_is_better_rounding_alone_is_saved():
    """Trained on wrong labels, a network that was right becomes worse."""
    labels = torch.arange(16) % 2
    spikes = torch.zeros(16, 40, 2, dtype=torch.uint8)
    spikes[torch.arange(16), ::3, labels] = 1  # each class has an afferent of its own
    right = Examples(spikes, labels)
    settings = {"learning_rate": 0.02, "batch": 4, "rate_penalty": 0.0}
    network = nt.RSNN(
        2, 2, hidden=8, sampling_rate_Hz=1000.0, forward_weight_scale=2.0, training=settings,
        generator=torch.Generator().manual_seed(0),
    )  # fmt: skip
    grids = {name: Grid(0.01, 10_000) for name in ("w_in", "w_rec", "w_out")}

    def tuned(labels: torch.Tensor, epochs: int):
        order = torch.Generator().manual_seed(0)
        return fine_tuning.train_rounded(
            network, right._replace(labels=labels), right, grids, generator=order, epochs=epochs
        )

    assert tuned(labels, 20).best.validation_accuracy == 1
    rounded = {name: weights.clone() for name, weights in network.state_dict().items()}
    done = tuned(1 - labels, 3)
    assert done.best.epoch == 0
    assert [epoch.epoch for epoch in done.epochs] == [0, 1, 2, 3]
    assert done.epochs[-1].validation_loss > done.best.validation_loss
    assert all(torch.equal(network.state_dict()[name], weights) for name, weights in rounded.items())


def test_the_same_seed_gives_the_same_network(spiking, tmp_path):
    for name, seed in (("one", 3), ("same", 3), ("other", 4)):
        nt.fine_tune(spiking, tmp_path / name, weight_bits=4, epochs=3, seed=seed)
    one, same, other = (weights_of(tmp_path / name) for name in ("one", "same", "other"))
    assert all(torch.equal(one[name], same[name]) for name in one)
    logs = [(tmp_path / name / "training.csv").read_bytes() for name in ("one", "same", "other")]
    assert logs[0] == logs[1] != logs[2]
    assert {*one} == {*other}


@pytest.mark.thorough
def test_test_trials_are_not_seen(spiking, tmp_path):
    """Another signal on a test trial changes no weight; on a training trial it does."""
    sides = tasks.trials_of(run_folder.load_spikes_of(run_folder.restore(spiking)), run_folder.restore(spiking).task)
    found = {}
    for name, trial in (("test", sides.test[0]), ("train", sides.train[0])):
        other = make_run(tmp_path / name, shown=int(trial))
        # The network that was trained on the first recordings, with the other ones' trials.
        shutil.copy(spiking / "weights.safetensors", other)
        table, first = (json.loads((place / "network.json").read_text()) for place in (other, spiking))
        (other / "network.json").write_text(json.dumps({**table, "weights_sha256": first["weights_sha256"]}))
        nt.fine_tune(other, tmp_path / name / "tuned", weight_bits=3, epochs=3)
        found[name] = tmp_path / name / "tuned"
    nt.fine_tune(spiking, tmp_path / "as-it-was", weight_bits=3, epochs=3)
    expected = weights_of(tmp_path / "as-it-was")
    assert all(torch.equal(expected[name], weights) for name, weights in weights_of(found["test"]).items())
    log = (tmp_path / "as-it-was" / "training.csv").read_bytes()
    assert (found["test"] / "training.csv").read_bytes() == log != (found["train"] / "training.csv").read_bytes()


@pytest.mark.parametrize("has_own_rule", [True, False])
def test_an_exit_that_was_chosen_at_another_condition_stays(spiking, tmp_path, has_own_rule):
    shutil.copytree(spiking.parent, tmp_path / "kept")
    path = tmp_path / "kept" / "run" / run_folder.NETWORK
    network = json.loads(path.read_text())
    own, other = network["extra"]["exit_patience"], 39
    losses = dict.fromkeys(range(400), 0.0)
    network["extra"] |= {"exit_patience": other, "has_own_rule": has_own_rule, "exit_losses": losses}
    path.write_text(json.dumps(network))
    fine_tuning.fine_tune(tmp_path / "kept" / "run", tmp_path / "tuned", epochs=0)
    tuned = run_folder.restore(tmp_path / "tuned")
    assert own != other
    assert (tuned.rule.patience == other) is not has_own_rule
    assert (tuned.held.losses == losses) is not has_own_rule
    assert tuned.has_own_rule is has_own_rule


def test_spikes_with_other_trials_are_refused(tmp_path):
    run = make_run(tmp_path / "a")
    make_run(tmp_path / "b", shown=0)
    shutil.copy(tmp_path / "b" / "spikes.h5", tmp_path / "a" / "spikes.h5")
    with pytest.raises(InputError, match="no longer contains the trials"):
        nt.fine_tune(run, tmp_path / "tuned", epochs=0)
    assert not (tmp_path / "tuned").exists()


def test_it_remembers_where_it_came_from(spiking, tmp_path):
    nt.fine_tune(spiking, tmp_path / "tuned", weight_bits=5, state_bits=14, epochs=1, seed=7)
    about = json.loads((tmp_path / "tuned" / "network.json").read_text())["extra"]["fine_tuned"]
    first = json.loads((spiking / "network.json").read_text())
    assert (tmp_path / "tuned" / about["network"]).resolve() == spiking.resolve()
    assert about["weights_sha256"] == first["weights_sha256"]
    assert [about[key] for key in ("weight_bits", "state_bits", "epochs", "seed")] == [5, 14, 1, 7]
    chosen = export.prepared(tmp_path / "tuned").formats
    assert (chosen.weight_bits, chosen.state_bits) == (5, 14)
    assert export.prepared(tmp_path / "tuned", weight_bits=8).formats.weight_bits == 8
    assert export.prepared(tmp_path / "tuned", state_bits=16).formats.state_bits == 16


def test_weights_are_rounded_again_where_fewer_bits_are_asked_for(spiking, tmp_path):
    nt.fine_tune(spiking, tmp_path / "tuned", weight_bits=8, epochs=0)
    wide, narrow = (export.prepared(tmp_path / "tuned", state_bits=bits).formats for bits in (24, 8))
    assert np.array_equal(wide.hidden.w, export.prepared(tmp_path / "tuned").formats.hidden.w)
    assert narrow.state_bits == 8
    assert np.abs(narrow.hidden.w).max() < np.abs(wide.hidden.w).max()


def test_a_threshold_that_states_do_not_hold_is_refused():
    network = nt.RSNN(2, 2, hidden=3, sampling_rate_Hz=1000.0)
    with pytest.raises(InputError, match="8 bits do not hold the threshold"):
        formats.layers_of(
            network, (1.0, 1.0), weight_bits=4, state_bits=8, n_steps=9, steps=formats.Steps(*[2**-12] * 3)
        )


@pytest.mark.parametrize(
    "steps", [formats.Steps(0.1, 0.3, 0.1), formats.Steps(0.1, 0.1 * 2**40, 0.1)], ids=["no power", "too far apart"]
)
def test_steps_without_a_common_unit_are_refused(steps):
    network = nt.RSNN(2, 2, hidden=3, sampling_rate_Hz=1000.0)
    with pytest.raises(InputError, match="no common unit"):
        formats.layers_of(network, (1.0, 1.0), weight_bits=4, state_bits=16, n_steps=9, steps=steps)


def command(monkeypatch, capsys, *words) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["neurotact", "--quiet", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return int(end.value.code or 0), *capsys.readouterr()


def test_the_command_says_what_was_gained_and_what_comes_next(spiking, tmp_path, monkeypatch, capsys):
    out = tmp_path / "tuned"
    words = ("fine-tune", spiking, "-o", out, "--weight-bits", "3", "--epochs", "2")
    code, said, _ = command(monkeypatch, capsys, *words)
    assert code == 0
    assert "validation accuracy with 3-bit weights: " in said
    assert f"next: neurotact export {out} --to c -o chain/" in said
    code, _, refused = command(monkeypatch, capsys, *words)
    assert code == 2
    assert "already exists and is not empty" in refused
    assert command(monkeypatch, capsys, *words, "--force")[0] == 0
    code, said, _ = command(monkeypatch, capsys, "export", out, "--to", "c", "-o", tmp_path / "chain")
    assert code == 0
    assert "4-5-2 neurons, 3-bit weights" in said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weight_bits": 9}, "weight_bits: must be from 2 to 8"),
        ({"state_bits": 20}, "state_bits: must be from 8 to 16, or 24"),
        ({"epochs": -1}, "epochs: must be from 0"),
    ],
)
def test_what_cannot_be_is_refused_and_leaves_nothing(spiking, tmp_path, options, message):
    with pytest.raises(InputError, match=message):
        nt.fine_tune(spiking, tmp_path / "tuned", **options)
    assert not (tmp_path / "tuned").exists()


def test_the_run_itself_is_never_replaced(spiking):
    before = (spiking / "weights.safetensors").read_bytes()
    with pytest.raises(InputError, match="is the run that is to be fine-tuned"):
        nt.fine_tune(spiking, spiking / ".." / "run", force=True, epochs=0)
    assert (spiking / "weights.safetensors").read_bytes() == before


def test_a_damaged_note_is_refused(spiking, tmp_path):
    nt.fine_tune(spiking, tmp_path / "tuned", epochs=0)
    path = tmp_path / "tuned" / "network.json"
    table = json.loads(path.read_text())
    table["extra"]["fine_tuned"]["steps"] = [0.0, 0.1, 0.1]
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match="fine_tuned"):
        export.prepared(tmp_path / "tuned")
