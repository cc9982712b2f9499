import sys
from types import SimpleNamespace

import numpy as np
import pytest
import safetensors.torch
import torch
from neurotact_parts.studies.touch_modality.cnn_features import IMAGENET_MEAN, IMAGENET_SD, CNNFeatures
from neurotact_parts.studies.touch_modality.recurrent import LSTMClassifier
from sklearn.base import clone
from sklearn.pipeline import make_pipeline
from torch import nn

from neurotact.errors import InputError


def small_cnn():
    torch.manual_seed(0)
    return nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.ReLU(), nn.MaxPool2d(2))


def images(n_trials=4, n_steps=3, side=8, seed=0):
    return 5 + np.random.default_rng(seed).normal(size=(n_trials, n_steps, side, side))


def test_features_are_those_of_the_module_on_scaled_images():
    X, cnn = images(), small_cnn().eval()
    features = CNNFeatures(cnn).fit_transform(X)
    scaled = torch.tensor((X - X.min()) / (X.max() - X.min()), dtype=torch.float32)
    with torch.no_grad():
        expected = cnn(scaled[2, 1].expand(1, 3, 8, 8)).flatten()
    assert features.shape == (4, 3, 4 * 3 * 3)
    np.testing.assert_allclose(features[2, 1], expected.numpy(), atol=1e-5)


def test_range_is_that_of_training_and_the_module_stays_as_it_was():
    cnn = small_cnn()
    before = {name: tensor.clone() for name, tensor in cnn.state_dict().items()}
    fitted = CNNFeatures(cnn).fit(images())
    low, high, one = fitted.low_, fitted.high_, images(1)
    alone = fitted.transform(one)
    together = fitted.transform(np.concatenate([one, 100 * images(20, seed=2)]))
    np.testing.assert_allclose(together[:1], alone, atol=1e-5)  # neither scaling nor normalisation sees the others
    assert (fitted.low_, fitted.high_) == (low, high)
    assert cnn.training
    assert all(torch.equal(before[name], tensor) for name, tensor in cnn.state_dict().items())


def test_constant_images_have_features():
    assert np.isfinite(CNNFeatures(small_cnn()).fit_transform(np.full((1, 1, 8, 8), 3.0))).all()


def test_counts_and_clones():
    fitted = CNNFeatures(small_cnn()).fit(images())
    assert fitted.n_parameters_ == 3 * 3 * 3 * 4 + 4 + 2 * 4
    assert fitted.n_features_out_ == 36
    again = clone(fitted).fit(images())
    np.testing.assert_array_equal(again.transform(images()), fitted.transform(images()))


def test_an_lstm_behind_it_learns():
    rng = np.random.default_rng(0)
    X, y = 0.1 * rng.normal(size=(24, 4, 8, 8)), np.arange(24) % 2
    X[y == 1, 2:, :4] += 1
    X[y == 0, :2, :4] += 1
    chain = make_pipeline(
        CNNFeatures(small_cnn()), LSTMClassifier(6, epochs=40, batch=8, learning_rate=0.02, random_state=0)
    )
    assert chain.fit(X[:16], y[:16]).score(X[16:], y[16:]) == 1.0
    assert chain[1].n_parameters_ == 4 * 6 * (36 + 6 + 1) + 2 * (6 + 1)


def test_weights_come_from_a_local_file(tmp_path):
    trained, path = small_cnn(), tmp_path / "cnn.safetensors"
    with torch.no_grad():
        trained[0].weight.mul_(2)
    safetensors.torch.save_file(trained.state_dict(), path)
    loaded = CNNFeatures(small_cnn(), path).fit_transform(images())
    np.testing.assert_array_equal(loaded, CNNFeatures(trained).fit_transform(images()))
    assert not np.allclose(loaded, CNNFeatures(small_cnn()).fit_transform(images()))


def test_weights_that_do_not_fit_are_refused(tmp_path):
    path = tmp_path / "cnn.safetensors"
    tensors = small_cnn().state_dict()
    for change, message in (
        ({"0.weight": torch.zeros(4, 3, 5, 5)}, r"'0\.weight' is \(4, 3, 5, 5\) where the network has \(4, 3, 3, 3\)"),
        ({"9.weight": torch.zeros(1)}, r"'9\.weight' is not in the network"),
    ):
        safetensors.torch.save_file({**tensors, **change}, path)
        with pytest.raises(InputError, match=message):
            CNNFeatures(small_cnn(), path).fit(images())
    safetensors.torch.save_file({"0.weight": tensors["0.weight"]}, path)
    with pytest.raises(InputError, match=r"'0\.bias' is missing"):
        CNNFeatures(small_cnn(), path).fit(images())
    path.write_bytes(b"not tensors at all")
    with pytest.raises(InputError, match=r"is not a safetensors file.*convert a \.pth once"):
        CNNFeatures(small_cnn(), path).fit(images())
    with pytest.raises(InputError, match="there is no such file"):
        CNNFeatures(small_cnn(), tmp_path / "absent.safetensors").fit(images())


def test_a_named_network_is_built_by_torchvision_loaded_whole_and_cut(tmp_path, monkeypatch):
    class VGG(nn.Module):
        def __init__(self):
            super().__init__()
            self.features, self.classifier = small_cnn(), nn.Linear(36, 10)

    asked = []
    models = SimpleNamespace(vgg16=lambda weights: asked.append(weights) or VGG())
    monkeypatch.setitem(sys.modules, "torchvision", SimpleNamespace(models=models))
    path = tmp_path / "vgg16.safetensors"
    trained = VGG().eval()
    safetensors.torch.save_file(trained.state_dict(), path)
    X = images()
    features = CNNFeatures("vgg16", path).fit_transform(X)
    assert asked == [None]  # never a name of weights to download
    scaled = torch.tensor((X[0, 0] - X.min()) / (X.max() - X.min()), dtype=torch.float32)
    colours = torch.stack([(scaled - mean) / sd for mean, sd in zip(IMAGENET_MEAN, IMAGENET_SD, strict=True)])
    with torch.no_grad():
        expected = trained.features(colours[None]).flatten()
    np.testing.assert_allclose(features[0, 0], expected.numpy(), atol=1e-5)


def test_sizes_of_the_papers_networks(tmp_path):
    models = pytest.importorskip("torchvision").models
    for name, size in (("resnet50", 8192), ("mobilenet_v2", 5120), ("vgg16", 2048)):
        path = tmp_path / f"{name}.safetensors"
        safetensors.torch.save_file(getattr(models, name)(weights=None).state_dict(), path)
        assert CNNFeatures(name, path).fit(images(1, 1, 64)).n_features_out_ == size


def test_refusals(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torchvision", None)  # as where it is not installed
    path = tmp_path / "w.safetensors"
    safetensors.torch.save_file({"w": torch.zeros(1)}, path)
    with pytest.raises(InputError, match=r"'resnet50' needs torchvision; pip install 'neurotact\[cnn\]'"):
        CNNFeatures("resnet50", path).fit(images())
    with pytest.raises(InputError, match=r"weights: name a local safetensors file.*nothing is downloaded"):
        CNNFeatures("resnet50").fit(images())
    for name in ("ResNet152V2", "resnet150v2"):
        with pytest.raises(InputError, match="torchvision has no version 2 of ResNet"):
            CNNFeatures(name, path).fit(images())
    with pytest.raises(InputError, match="'resnet5' is unknown; did you mean 'resnet50'"):
        CNNFeatures("resnet5", path).fit(images())
    with pytest.raises(InputError, match=r"X: must be \(trial, time, height, width\)"):
        CNNFeatures(small_cnn()).fit(images()[0])
