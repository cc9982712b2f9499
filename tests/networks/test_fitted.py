"""A fitted classifier goes wherever a run folder goes, and does there what its `predict` does."""

import numpy as np
import pytest
import torch
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import FunctionTransformer

import neurotact as nt
from neurotact.networks.use import fitted

RATE_HZ = 1000.0


def touches(n: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Signals `(trial, time, taxel)` of two classes; a hard touch is twice as strong."""
    rng = np.random.default_rng(0)
    y = np.tile([2, 10], n // 2)
    strength = np.where(y == 10, 24.0, 10.0)[:, None, None]
    press = np.sin(np.linspace(0, 9, 120))[None, :, None] ** 2
    return (strength * press + rng.normal(0, 1, (n, 120, 3))).astype(np.float32), y


ENCODER = nt.AfferentSpec.model_validate(
    {"sa1": {"gain": 3.0}, "ra1": {"gain": 9.0}, "conditioning": {"baseline": "start"}}
)


@pytest.fixture(scope="module")
def pipe() -> Pipeline:
    classifier = nt.SpikingClassifier(hidden=6, epochs=6, batch=4, random_state=0)
    return make_pipeline(nt.SpikeEncoder(ENCODER, sampling_rate_Hz=RATE_HZ), classifier).fit(*touches())


def test_the_rate_of_the_samples_is_that_of_the_recordings(tmp_path):
    """An encoder that resamples needs it: of a pipeline, of windows, and of a run folder."""
    encoder = nt.AfferentSpec.model_validate({
        "sa1": {"gain": 3.0}, "ra1": {"gain": 90.0}, "conditioning": {"resample_Hz": RATE_HZ},
    })  # fmt: skip
    X, y = touches()
    classifier = nt.SpikingClassifier(hidden=4, epochs=1, batch=4, random_state=0)
    pipeline = make_pipeline(nt.SpikeEncoder(encoder, sampling_rate_Hz=200.0), classifier).fit(X, y)
    assert nt.Stream(pipeline).chain.sampling_rate_Hz == 200.0
    assert nt.Stream(pipeline, streamed=nt.Streamed(sampling_rate_Hz=250.0)).chain.sampling_rate_Hz == 250.0
    spikes = nt.encode(nt.Recordings(X, 200.0, "mV", {"label": y.astype(str)}), encoder)
    nt.save(spikes, tmp_path / "spikes.h5")
    again = nt.load_spikes(tmp_path / "spikes.h5")
    assert again.recorded_Hz == again.select([0, 1]).recorded_Hz == 200.0
    windows = nt.windows(again, nt.Window(length_ms=100))
    assert nt.Stream(classifier.fit(windows.X, windows.y)).chain.sampling_rate_Hz == 200.0
    nt.train(
        tmp_path / "spikes.h5",
        tmp_path / "run",
        settings={"hidden": 4, "training.epochs": 1},
        window=nt.Window(length_ms=100),
    )
    assert nt.Stream(tmp_path / "run").chain.sampling_rate_Hz == 200.0


@pytest.fixture(scope="module")
def recordings() -> nt.Recordings:
    X, y = touches()
    return nt.Recordings(X, RATE_HZ, "mV", {"label": y.astype(str)})


def test_a_stream_decides_as_predict(pipe):
    X, _ = touches()
    said = []
    for trial in X:
        said += [decision.label for decision in nt.Stream(pipe, streamed=nt.Streamed(full_window=True)).push(trial)]
    assert said == pipe.predict(X).astype(str).tolist()
    early = [nt.Stream(pipe[-1]).push(trial)[0] for trial in X]
    decided = pipe[-1].decide(pipe[:-1].transform(X), early_exit=True)
    assert [each.steps for each in early] == decided["steps"].tolist()
    assert [each.sops for each in early] == decided["sops_total"].tolist()


def test_infer_decides_as_predict(pipe, recordings, tmp_path):
    X, _ = touches()
    table = nt.infer(pipe, nt.encode(recordings, ENCODER), out=tmp_path / "a.csv")
    assert table["predicted"].tolist() == pipe.predict(X).astype(str).tolist()
    assert set(table["side"]) == {"unknown"}
    with pytest.raises(nt.InputError, match="test_only: an estimator does not know its test trials"):
        nt.infer(pipe, nt.encode(recordings, ENCODER), test_only=True)
    with pytest.raises(nt.InputError, match=r"sa1\.t_ref_ms is 9"):
        nt.infer(pipe, nt.encode(recordings, ENCODER, {"sa1.t_ref_ms": 9}))


def test_windows_of_spikes_are_cut_again_as_they_were(recordings):
    windows = nt.windows(nt.encode(recordings, ENCODER), nt.Window(length_ms=40, start_ms=30, hop_ms=20))
    classifier = nt.SpikingClassifier(hidden=4, epochs=1, random_state=0).fit(windows.X, windows.y)
    assert nt.infer(classifier, windows.trains)["predicted"].tolist() == classifier.predict(windows.X).tolist()
    plan = nt.Stream(classifier).chain.windows
    assert (plan.length, plan.start, plan.hop) == (40, 30, 20)
    shorter = nt.SpikingClassifier(hidden=4, epochs=1, random_state=0).fit(windows.X[:, :25], windows.y)
    assert nt.Stream(shorter).chain.windows.length == 25


@pytest.mark.thorough
def test_it_is_exported_as_c(pipe, recordings, tmp_path):
    told = []
    made = nt.export_c(pipe, tmp_path / "c", recordings=recordings, prove=3, tell=told.append)
    assert made.chain.classes == ("2", "10")
    assert "every spike and decision equal" in told[1]["value"].tolist()
    nt.save(recordings, tmp_path / "touch.h5")
    again = nt.export_c(pipe[-1], tmp_path / "again", recordings=tmp_path / "touch.h5")
    assert again.formats.raw == made.formats.raw
    assert nt.export_c(pipe, tmp_path / "float", variant="float").formats is None


def test_integers_need_the_range_of_samples(pipe, recordings, tmp_path):
    with pytest.raises(nt.InputError, match="`recordings`: a classifier keeps none"):
        nt.export_c(pipe, tmp_path / "c")
    others = nt.Recordings(recordings.signals, RATE_HZ, "mV", {"label": ["other"] * len(recordings)})
    with pytest.raises(nt.InputError, match="class 'other' is not a class of the network"):
        nt.export_c(pipe, tmp_path / "c", recordings=others)


def test_it_is_exchanged():
    X, y = touches()
    pytest.importorskip("nir")
    one_clock = {"step_ms": "encoder", "readout_stretches": 1}  # what NIR can hold
    classifier = nt.SpikingClassifier(hidden=6, epochs=6, batch=4, settings=one_clock, random_state=0)
    pipe = make_pipeline(nt.SpikeEncoder(ENCODER, sampling_rate_Hz=RATE_HZ), classifier).fit(X, y)
    assert "afferents" in nt.to_nir(pipe).nodes
    again = nt.from_nir(nt.to_nir(pipe))
    spikes = torch.from_numpy(np.asarray(pipe[:-1].transform(X)))
    found = again.network.infer(spikes).labels.numpy()
    assert (pipe[-1].classes_[found] == pipe.predict(X)).all()
    hidden, readout = nt.to_snntorch(pipe)(spikes)
    later = nt.to_snntorch(pipe[-1], time_first=True)(spikes.transpose(0, 1))
    assert torch.equal(hidden, later[0].transpose(0, 1))
    assert torch.equal(readout, later[1].transpose(0, 1))
    assert (pipe[-1].classes_[readout[:, -1].argmax(dim=1)] == pipe.predict(X)).all()
    assert nt.check_chip(pipe, "loihi2").columns[0] == "what"


def test_a_default_network_goes_to_nir_and_what_stays_outside_is_said_once(pipe, tmp_path, caplog):
    X, _ = touches()
    path = tmp_path / "pipe.nir"
    pytest.importorskip("nir")
    nt.to_nir(pipe, path)
    (said,) = [record.getMessage() for record in caplog.records]
    for what in (
        "the encoder (clock slower than its encoder's",
        "bins of the clock: the graph takes spikes in bins of 4 ms",
    ):
        assert what in said
    again = nt.from_nir(path)
    assert again.encoder == pipe[0].encoder
    network = fitted.restore(pipe).network
    assert (again.network.spec, again.network.sampling_rate_Hz) == (network.spec, RATE_HZ)
    found = again.network.infer(torch.from_numpy(np.asarray(pipe[:-1].transform(X)))).labels.numpy()
    assert (pipe[-1].classes_[found] == pipe.predict(X)).all()


def test_the_best_of_a_search_is_taken(pipe):
    X, y = touches()
    search = GridSearchCV(pipe, {"spikingclassifier__hidden": [3, 4]}, cv=2).fit(X, y)
    assert fitted.restore(search).network.spec.hidden == search.best_params_["spikingclassifier__hidden"]


def test_what_uses_it_cannot_change_it(pipe):
    weights = pipe[-1].network_.w_in.clone()
    with torch.no_grad():
        fitted.restore(pipe).network.w_in.zero_()
    assert torch.equal(weights, pipe[-1].network_.w_in)


def test_what_is_no_trained_network_is_refused(pipe, tmp_path):
    X, y = touches()
    unknown = nt.SpikingClassifier(epochs=1, sampling_rate_Hz=RATE_HZ).fit(np.asarray(pipe[:-1].transform(X)), y)
    with pytest.raises(nt.InputError, match="was fitted on an array that does not say its encoder"):
        nt.Stream(unknown)
    with pytest.raises(nt.InputError, match="run: must be the folder of a training, a fitted SpikingClassifier"):
        nt.check_chip(3, "loihi2")
    with pytest.raises(nt.InputError, match="Pipeline: ends in FunctionTransformer"):
        nt.Stream(make_pipeline(FunctionTransformer()).fit(X))
    for call in (nt.fine_tune, nt.sops):
        with pytest.raises(nt.InputError, match="needs the folder of a training"):
            call(pipe, tmp_path / "out")
    with pytest.raises(ValueError, match="not fitted"):
        nt.Stream(nt.SpikingClassifier())
