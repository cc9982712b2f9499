"""A convolutional LSTM that classifies sequences of images."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from neurotact_parts.opponents.targets import encode
from neurotact_parts.studies.probabilities import ProbabilitiesMixin
from neurotact_parts.studies.touch_modality.recurrent import LSTM_UNIT
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted
from torch import Tensor, nn
from torch.nn import functional, init

from neurotact.checks import at_least, sequences, trial_labels
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, Layer, changed, with_weights
from neurotact.networks.definition.optimisers import kind_of

IMAGE_AXES = "trial, time, height, width"

TRIALS_AT_ONCE = 8
"""Trials per gradient computation; a batch is the sum of such parts, since 48 trials would need gigabytes."""


class ConvLSTMClassifier(ProbabilitiesMixin, ClassifierMixin, BaseEstimator):
    """One ConvLSTM layer, a dense ReLU layer on its last state and a softmax, trained by Adam (touch-modality paper).

    The LSTM of `LSTMClassifier` with convolutions in place of products: that of the image without padding (so it
    shrinks by `kernel - 1`), that of the state with padding; one bias per gate and filter. Initialised as in Keras. The
    paper's code also uses batch normalisation and dropout, which the paper does not mention; this class follows the
    paper.

    Parameters
    ----------
    filters, kernel : of the convolutions; kernels are square.
    units : of the dense ReLU layer.
    epochs, batch, learning_rate : of the training.
    random_state : seed or RandomState of the weights and of the order of the trials.
    device : torch device for training and predictions; 48 epochs of the paper's set take hours on a CPU core.

    Attributes
    ----------
    classes_ `(class,)`; n_parameters_, all of them trained; network_, the torch module.

    Raises InputError for images that are not `(trial, time, height, width)`, for a single class and for parameters out
    of range.

    >>> X, y = np.random.default_rng(0).normal(size=(4, 2, 6, 6)), ["rolling", "sliding"] * 2
    >>> fitted = ConvLSTMClassifier(filters=2, units=3, epochs=1, random_state=0).fit(X, y)
    >>> fitted.predict_proba(X).shape, fitted.n_parameters_
    ((4, 2), 331)
    """

    def __init__(
        self,
        filters: int = 32,
        kernel: int = 3,
        units: int = 100,
        epochs: int = 48,
        batch: int = 48,
        learning_rate: float = 1e-3,
        random_state: int | np.random.RandomState | None = None,
        device: str = "cpu",
    ):
        self.filters = filters
        self.kernel = kernel
        self.units = units
        self.epochs = epochs
        self.batch = batch
        self.learning_rate = learning_rate
        self.random_state = random_state
        self.device = device

    def fit(self, X: ArrayLike, y: ArrayLike) -> "ConvLSTMClassifier":
        """Train on images X `(trial, time, height, width)`, y `(trial,)`."""
        for name in ("filters", "kernel", "units", "epochs", "batch"):
            at_least(name, getattr(self, name), 1, whole=True)
        at_least("learning_rate", self.learning_rate, 0, above=True)
        images = sequences(X, IMAGE_AXES, np.float32)
        if min(images.shape[2:]) < self.kernel:
            raise InputError(f"kernel: {self.kernel} is wider than the images {images.shape[2:]}; choose a smaller one")
        self.classes_, indices = encode(trial_labels(y, len(images)))
        seed = int(check_random_state(self.random_state).randint(2**31 - 1))
        height, width = images.shape[2:]
        shape = _Shape(height, width, self.filters, self.kernel, self.units, len(self.classes_))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network_ = _Network(shape).to(self.device)
        self.n_parameters_ = sum(p.numel() for p in self.network_.parameters())
        self._train(torch.tensor(images), torch.tensor(indices), torch.Generator().manual_seed(seed))
        return self

    @torch.no_grad()
    def predict_proba(self, X: ArrayLike) -> np.ndarray:
        """Softmax of the outputs, `(trial, class)`. The number of steps may differ from that of training."""
        check_is_fitted(self)
        images = torch.tensor(sequences(X, IMAGE_AXES, np.float32))
        if images.shape[2:] != self.network_.shape[:2]:
            expected = tuple(self.network_.shape[:2])
            raise InputError(f"X: images are {tuple(images.shape[2:])} but were {expected} in training; give those")
        parts = [self.network_(part.to(self.device)).softmax(dim=1) for part in images.split(TRIALS_AT_ONCE)]
        return torch.cat(parts).cpu().numpy()

    def _train(self, images: Tensor, labels: Tensor, generator: torch.Generator) -> None:
        optimiser = kind_of("Adam")(self.network_.parameters(), lr=self.learning_rate, eps=1e-7)
        for _ in range(self.epochs):
            for batch in torch.randperm(len(labels), generator=generator).split(self.batch):
                optimiser.zero_grad()
                for part in batch.split(TRIALS_AT_ONCE):
                    logits = self.network_(images[part].to(self.device))
                    loss = functional.cross_entropy(logits, labels[part].to(self.device), reduction="sum")
                    (loss / len(batch)).backward()
                optimiser.step()


class _Shape(NamedTuple):
    height: int
    width: int
    filters: int
    kernel: int
    units: int
    n_classes: int


class _Network(nn.Module):
    """Logits `(trial, class)` of images `(trial, time, height, width)`."""

    def __init__(self, shape: _Shape):
        super().__init__()
        height, width, filters, kernel, units, n_classes = self.shape = shape
        self.rows, self.columns = height - kernel + 1, width - kernel + 1
        self.into = nn.Conv2d(1, 4 * filters, kernel)
        self.recurrent = nn.Conv2d(filters, 4 * filters, kernel, padding="same", bias=False)
        self.dense = nn.Linear(filters * self.rows * self.columns, units)
        self.output = nn.Linear(units, n_classes)
        for layer in (self.into, self.dense, self.output):
            init.xavier_uniform_(layer.weight)
            init.zeros_(layer.bias)  # pyright: ignore[reportArgumentType]
        init.orthogonal_(self.recurrent.weight)
        with torch.no_grad():
            self.into.bias[filters : 2 * filters] = 1  # pyright: ignore[reportOptionalSubscript]  (the forget gate's)

    def forward(self, images: Tensor) -> Tensor:
        h = c = images.new_zeros(len(images), self.shape.filters, self.rows, self.columns)
        for image in images.unbind(dim=1):
            i, f, g, o = (self.into(image[:, None]) + self.recurrent(h)).chunk(4, dim=1)
            c = f.sigmoid() * c + i.sigmoid() * g.tanh()
            h = o.sigmoid() * c.tanh()
        return self.output(self.dense(h.flatten(1)).relu())


@dataclass(frozen=True)
class ConvLSTM(Layer):
    """`steps` steps of a convolutional LSTM: an LSTM whose products are convolutions with square kernels.

    `height` and `width` are those of its output, as for `Conv2d`; no peepholes.
    """

    height: int
    width: int
    channels: int
    filters: int
    kernel: int
    steps: int = 1

    def cost(self) -> Cost:
        units = self.height * self.width * self.filters
        weights = 4 * self.filters * (self.channels + self.filters) * self.kernel**2
        macs, received = self.height * self.width * weights, self.height * self.width * self.channels
        step = Cost(macs=macs, weights_accesses=macs + 4 * units, **changed(2 * units), buffers_accesses=received)
        return with_weights(weights + 4 * self.filters, 2 * units) + (step + LSTM_UNIT.times(units)).times(self.steps)
