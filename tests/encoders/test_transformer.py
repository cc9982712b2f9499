"""The encoder of a pipeline: gains come from what `fit` is given, and from nothing else."""

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

import neurotact as nt
from neurotact.data.windowed import Origin
from neurotact.encoders import calibration
from neurotact.errors import InputError

RATE_HZ = 1000.0


def slides(n: int = 12, seed: int = 0, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Signals `(trial, time, taxel)` of two textures, which vibrate at two frequencies."""
    rng = np.random.default_rng(seed)
    y = np.tile(["coarse", "fine"], n // 2)
    time_s = np.arange(400)[None, :, None] / RATE_HZ
    waves = np.sin(2 * np.pi * np.where(y == "coarse", 4, 14)[:, None, None] * time_s + rng.uniform(0, 6, (n, 1, 2)))
    return (scale * (waves + rng.normal(0, 0.1, waves.shape))).astype(np.float32), y


@pytest.fixture(scope="module")
def fitted() -> nt.SpikeEncoder:
    return nt.SpikeEncoder(sampling_rate_Hz=RATE_HZ, settings={"conditioning.baseline": "start"}).fit(*slides())


def test_it_calibrates_as_calibrate_does(fitted):
    X, y = slides()
    recordings = nt.Recordings(X, RATE_HZ, "mV", pd.DataFrame({"label": y}))
    spec = nt.SpikeEncoder(calibrate=False, sampling_rate_Hz=RATE_HZ, settings=fitted.settings).fit(X).spec_
    assert isinstance(spec, nt.AfferentSpec)
    assert fitted.spec_ == calibration.calibrate(recordings, spec, tell=False).encoder
    assert fitted.calibration_ is not None


@pytest.mark.parametrize(("given", "integration"), [({}, "exact"), ({"settings": {"integration": "clock"}}, "clock")])
def test_a_slow_sensor_is_in_closed_form_unless_it_is_set(given, integration):
    X, y = slides()
    slow = nt.SpikeEncoder(sampling_rate_Hz=100.0, **given).fit(X[:, ::10], y)
    assert slow.calibration_ is not None
    assert slow.spec_.integration == integration
    assert any("once per sample" in note for note in slow.calibration_.notes) == (integration == "exact")
    assert slow.transform(X[:, ::10]).shape[:2] == (len(X), 400)


def test_gains_depend_on_the_trials_of_fit_alone(fitted):
    """What is only transformed, such as a test fold, changes nothing; the scale of what is fitted is taken out."""
    before = fitted.spec_
    fitted.transform(slides(seed=7, scale=50.0)[0])
    assert fitted.spec_ == before
    larger = clone(fitted).fit(*slides(scale=8.0))
    assert larger.spec_.conditioning.scale == pytest.approx(8 * np.array(before.conditioning.scale), rel=1e-4)
    assert (larger.transform(slides(scale=8.0)[0]) == fitted.transform(slides()[0])).mean() > 0.999


@pytest.mark.parametrize(
    "given",
    [
        {"calibrate": False},
        {"settings": {"sa1.gain": 3.0}},
        {"settings": {"sa1": {"gain": 3.0}}},
        {"encoder": "izhikevich"},
        {"encoder": nt.AfferentSpec.model_validate({"sa1": {"gain": 2.0}, "ra1": {"gain": 3.0}})},
    ],
)
def test_gains_that_are_chosen_already_stay(given):
    encoder = nt.SpikeEncoder(sampling_rate_Hz=RATE_HZ, **given).fit(*slides())
    assert encoder.calibration_ is None


def test_without_classes_nothing_is_fitted():
    X, _ = slides()
    assert nt.SpikeEncoder(sampling_rate_Hz=RATE_HZ).fit(X).calibration_ is None
    with pytest.raises(nt.InputError, match="y: gains are chosen by how well they separate classes"):
        nt.SpikeEncoder(sampling_rate_Hz=RATE_HZ, calibrate=True).fit(X)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"encoder": "izhikevich"}, "calibrate: has no effect on model = 'izhikevich'"),
        ({"settings": {"sa1.gain": 3.0}}, "calibration sets it"),
    ],
)
def test_a_calibration_that_would_ignore_something_is_refused(given, words):
    with pytest.raises(nt.InputError, match=words):
        nt.SpikeEncoder(sampling_rate_Hz=RATE_HZ, calibrate=True, **given).fit(*slides())


def test_spikes_carry_their_origin(fitted):
    spikes = fitted.transform(slides()[0])
    assert isinstance(spikes.origin, Origin)
    assert spikes[2:5].origin == spikes.origin
    assert spikes.origin.afferents == ("SA-I taxel1", "SA-I taxel2", "RA-I taxel1", "RA-I taxel2")
    assert nt.AfferentSpec.model_validate(spikes.origin.encoder) == fitted.spec_


def test_transposed_signals_are_refused(fitted):
    with pytest.raises(nt.InputError, match=r"X: is \(trial, taxel, time\), as 2 is the number of taxels"):
        fitted.transform(slides()[0].transpose(0, 2, 1))


def test_taxels_and_time_that_may_be_swapped_are_doubted(caplog):
    """Where more taxels than samples are given, as on the command line; a classifier on plain arrays does the same."""
    X = np.random.default_rng(0).normal(0, 9, (4, 200, 12))
    encoder = nt.SpikeEncoder(sampling_rate_Hz=200.0, calibrate=False, settings={"conditioning.baseline": "none"})
    encoder.fit(X)
    assert not caplog.messages
    encoder.fit(X.transpose(0, 2, 1))
    doubt = "X: has 200 taxels of 12 samples each; if it is the other way round, give X.transpose(0, 2, 1)"
    assert caplog.messages == [doubt]
    spikes = (X > 5).astype(np.uint8).transpose(0, 2, 1)
    nt.SpikingClassifier(hidden=4, epochs=1, sampling_rate_Hz=200.0, random_state=0).fit(spikes, ["a", "b"] * 2)
    assert caplog.messages[1] == doubt.replace("taxels", "afferents")


def test_a_list_of_trials_of_unequal_length_names_what_takes_it():
    ragged = [np.zeros((n, 3)) for n in (40, 60)]
    for X in (ragged, np.array([*ragged, None], object)[:2]):
        with pytest.raises(InputError, match=r"has trials of 40 to 60 samples.*nt\.Recordings\(X.*nt\.windows"):
            nt.SpikeEncoder(sampling_rate_Hz=200.0).fit(X, ["a", "b"])
