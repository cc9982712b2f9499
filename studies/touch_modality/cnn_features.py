"""Features of images from a trained convolutional network, as input to a recurrent one."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from neurotact_parts.studies.touch_modality.conv_lstm import IMAGE_AXES
from numpy.typing import ArrayLike
from safetensors import SafetensorError
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted
from torch import Tensor, nn

from neurotact.checks import sequences
from neurotact.errors import InputError, nearest, optional
from neurotact.files import existing
from neurotact.metrics.flops import Cost, Layer, passed, with_weights

TRUNKS: dict[str, Callable[[Any], nn.Module]] = {
    "resnet50": lambda network: nn.Sequential(*list(network.children())[:-2]),
    "mobilenet_v2": lambda network: network.features,
    "vgg16": lambda network: network.features,
}
"""The convolutional part of torchvision's networks: the layers before pooling and classification."""

IMAGENET_MEAN, IMAGENET_SD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Mean and deviation of the three colours, for the input that torchvision's networks were trained on."""

IMAGES_AT_ONCE = 64


class CNNFeatures(TransformerMixin, BaseEstimator):
    """The flattened output of a trained CNN's convolutional part for each image; the CNN is not trained.

    Followed by an LSTM, this is the CNN-LSTM of the touch-modality paper (Fig. 3), whose networks give 2048 to 8192
    features per 64 x 64 image. Images are scaled so that those of training span 0 to 1, and are passed as three equal
    colours. Nothing is downloaded.

    Parameters
    ----------
    network : "resnet50", "mobilenet_v2" or "vgg16", built by torchvision (an extra: `pip install 'neurotact[cnn]'`), or
        a torch module from images `(image, 3, height, width)` between 0 and 1 to features of any shape. The paper's
        "ResNet150V2" (ResNet152V2) is not in torchvision; give it as a module.
    weights : a local safetensors file with the state dict of the whole network; optional for a module.

    Attributes
    ----------
    low_, high_ : the values mapped to 0 and 1; network_, the part in use; n_parameters_, its parameters, which are not
    trained here; n_features_out_, features per image.

    Raises InputError for unknown networks, for missing or unsuitable weights, and for X of another shape.

    >>> from sklearn.pipeline import make_pipeline
    >>> from neurotact_parts.studies.touch_modality.recurrent import LSTMClassifier
    >>> X, y = np.random.default_rng(0).normal(size=(4, 2, 8, 8)), ["rolling", "sliding"] * 2
    >>> cnn = nn.Sequential(nn.Conv2d(3, 5, kernel_size=4, stride=4), nn.ReLU())
    >>> cnn_lstm = make_pipeline(CNNFeatures(cnn), LSTMClassifier(hidden=6, epochs=1, random_state=0)).fit(X, y)
    >>> cnn_lstm[0].n_features_out_, cnn_lstm[1].n_parameters_
    (20, 662)
    """

    def __init__(self, network: str | nn.Module = "resnet50", weights: str | Path | None = None):
        self.network = network
        self.weights = weights

    def fit(self, X: ArrayLike, y: ArrayLike | None = None) -> "CNNFeatures":
        """Load the network and record the range of the images X `(trial, time, height, width)`; y is ignored."""
        images = sequences(X, IMAGE_AXES, np.float32)
        self.network_ = _trunk(self.network, self.weights).eval()
        self.n_parameters_ = sum(p.numel() for p in self.network_.parameters())
        self.low_, self.high_ = float(images.min()), float(images.max())
        self.n_features_out_ = self._features(torch.tensor(images[:1, 0])).shape[1]
        return self

    def transform(self, X: ArrayLike) -> np.ndarray:
        """Features `(trial, time, feature)` float32."""
        check_is_fitted(self)
        images = torch.tensor(sequences(X, IMAGE_AXES, np.float32))
        parts = [self._features(part) for part in images.flatten(0, 1).split(IMAGES_AT_ONCE)]
        return torch.cat(parts).unflatten(0, images.shape[:2]).numpy()

    @torch.no_grad()
    def _features(self, images: Tensor) -> Tensor:
        span = (self.high_ - self.low_) or 1.0
        colours = ((images - self.low_) / span)[:, None].expand(-1, 3, -1, -1)
        if isinstance(self.network, str):
            mean, sd = (torch.tensor(v)[:, None, None] for v in (IMAGENET_MEAN, IMAGENET_SD))
            colours = (colours - mean) / sd
        return self.network_(colours).flatten(1).float()


def _trunk(network: str | nn.Module, weights: str | Path | None) -> nn.Module:
    if isinstance(network, nn.Module):
        own = copy.deepcopy(network)
        return own if weights is None else _load(own, weights)
    if network.lower().replace("_", "") in ("resnet152v2", "resnet150v2"):
        raise InputError(f"network: torchvision has no version 2 of ResNet, '{network}'; give it as a torch module")
    if network not in TRUNKS:
        raise InputError(f"network: '{network}' is unknown; {nearest(network, list(TRUNKS))}")
    if weights is None:
        raise InputError(
            f"weights: name a local safetensors file with the trained weights of {network}; nothing is downloaded"
        )
    needed = f"network: '{network}' needs torchvision; pip install 'neurotact[cnn]', or give a torch module"
    models = optional("torchvision", needed).models
    return TRUNKS[network](_load(getattr(models, network)(weights=None), weights))


def _load(network: nn.Module, weights: str | Path) -> nn.Module:
    path = existing(weights)
    try:
        tensors = safetensors.torch.load_file(path)
    except SafetensorError as error:
        raise InputError(
            f"{path}: is not a safetensors file ({error}); convert a .pth once with safetensors.torch.save_file"
        ) from error
    expected = network.state_dict()
    for name in (*expected, *tensors):
        if name not in tensors:
            raise InputError(f"{path}: '{name}' is missing; give the weights of this network")
        if name not in expected:
            raise InputError(f"{path}: '{name}' is not in the network; give the weights of this network")
        if tensors[name].shape != expected[name].shape:
            raise InputError(
                f"{path}: '{name}' is {tuple(tensors[name].shape)} where the network has "
                f"{tuple(expected[name].shape)}; give the weights of this network"
            )
    network.load_state_dict(tensors)
    return network


@dataclass(frozen=True)
class Conv2d(Layer):
    """A two-dimensional convolution with square kernels; `height` and `width` are those of its *output*.

    At a padded border the products with zeros are counted too.
    """

    height: int
    width: int
    channels: int
    filters: int
    kernel: int

    def cost(self) -> Cost:
        pixels, weights = self.height * self.width, self.filters * self.channels * self.kernel**2
        parameters = weights + self.filters
        moved = {"weights_accesses": pixels * weights, **passed(pixels * self.channels, pixels * self.filters)}
        return with_weights(parameters, macs=pixels * weights, **moved)
