"""The spiking network as a scikit-learn estimator."""

from collections.abc import Mapping
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from numpy.typing import ArrayLike
from sklearn.base import ClassifierMixin
from sklearn.utils.validation import check_is_fitted

from neurotact import effects
from neurotact.checks import (
    check_last_axis,
    class_labels,
    fraction,
    sequences,
    trial_labels,
    warn_of_swapped,
)
from neurotact.data.copies import equal_examples, joined
from neurotact.data.recordings import check_sampling_rate
from neurotact.data.splits import hold_out, hold_out_groups
from neurotact.data.windowed import Origin, in_order
from neurotact.data.windows import WindowSpec, whole_steps
from neurotact.errors import InputError, number_of
from neurotact.estimators import NestedSettings
from neurotact.metrics import synops
from neurotact.metrics.prices import DEFAULT, PriceList, price_list
from neurotact.networks.definition import recipe
from neurotact.networks.definition.network import Inference, Network
from neurotact.networks.definition.specs import RSNNSpec, given_keys, void_keys
from neurotact.networks.exit.patience import ExitChoice
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import ensemble
from neurotact.networks.training.epochs import Epoch, Examples, Training
from neurotact.networks.training.trainer import begin, exit_of
from neurotact.networks.use import ledger
from neurotact.networks.use.measuring import synops_of
from neurotact.spec import checked_settings, resolve

AXES = "window, time, afferent"
TRAINING = ("learning_rate", "batch", "epochs", "patience")
VALIDATION = 0.15
"""Share of the windows that are held out, if none is given."""


class SpikingClassifier(ClassifierMixin, NestedSettings):
    """A spiking network, recurrent where that gains, trained by surrogate gradients (texture paper, Eqs. 4 to 7).

    Parameters
    ----------
    hidden : neurons of the hidden layer; 0: none. Where neither it nor another key of hidden neurons is given, the
        default network tries none first, and keeps a layer of 50 if it clearly gains on validation windows.
    recurrent : whether hidden neurons are connected to one another. The default network tries both where spikes are
        few, and keeps recurrence if it gains on validation windows.
    tau_mem_ms, tau_syn_ms : time constants.
    learning_rate, batch, epochs, patience : of the training.
    network : name or path of a network spec (`networks/*.toml`), or an `RSNNSpec`; it gives every value that is None
        here. The default chooses them from the training windows (docs/default-recipe.md); "rsnn" is the network of the
        texture paper.
    settings : further keys of that spec, dotted, as in `{"reset": "subtract", "training.rate_penalty": 0.0}`. In
        `set_params` and in grids, `training__rate_penalty` is one of them.
    validation_fraction : share of the windows held out for early stopping when `fit` gets no validation windows; 0.15
        when None.
    exit_tolerance : accuracy on validation windows that early exit may lose. One point takes 299 trials that lose none.
    sampling_rate_Hz : clock of X; None takes it from X, where `nt.windows` and `SpikeEncoder` store it.
    random_state : random seed of the initial weights, the order of the windows and the windows that are held out: a
        whole number, a `numpy.random.Generator` or `RandomState`, or None for a new seed at each fit.
    device : a torch device.
    verbose : whether `fit` prints a line for each epoch.

    Attributes
    ----------
    classes_ `(class,)`; network_, a `torch.nn.Module`, an `RSNN` unless `model` is another; training_, with `epochs`
    (the log) and `best`; exit_rule_, chosen on validation windows, and exit_choice_, with the upper `bound` of the
    accuracy that it loses on validation trials that did not choose it: where that exceeds `exit_tolerance`, whole
    windows are `used`; n_features_in_, the number of afferents; sampling_rate_Hz_; window_, the windows of X; origin_,
    the encoder and the afferents that X carries, or None.

    Once fitted it can be given to `nt.export_c`, `nt.Stream`, `nt.infer`, `nt.live`, `nt.to_nir` and `nt.to_snntorch`,
    itself or in a pipeline behind a `SpikeEncoder`.

    How long `fit` takes: seconds where no hidden layer is needed; else the default network trains for 40 epochs, or for
    as many as make 3000 steps of the weights: 750 epochs for 100 training windows in batches of 32, unless it has
    learned every window before; twice where it tries recurrence, and again with a path past the layer. On a processor
    that is up to minutes for each fit, and for each fold of `cross_val_score`, without a word unless `verbose=True`.
    For a first look, `epochs=15`.

    Raises InputError for spikes that are not `(window, time, afferent)` zeros and ones, for a single class, for an
    unknown clock and for parameters out of range.

    >>> rng = np.random.default_rng(0)
    >>> rates = np.repeat([0.02, 0.2], 30)[:, None, None]
    >>> X, y = (rng.random((60, 100, 4)) < rates).astype(np.uint8), np.repeat(["soft", "hard"], 30)
    >>> clf = SpikingClassifier(hidden=20, epochs=100, sampling_rate_Hz=1000.0, random_state=0)
    >>> bool(clf.fit(X, y).score(X, y) > 0.9)
    True
    >>> clf.network_.spec.readout, clf.network_.spec.tau_mem_ms
    ('integrator', 5.0)
    >>> clf.decide(X, early_exit=True).columns.tolist()[:3]
    ['predicted', 'steps', 'ms']
    """

    spec_keys = tuple(RSNNSpec.model_fields)

    def __init__(
        self,
        hidden: int | None = None,
        *,
        recurrent: bool | None = None,
        tau_mem_ms: float | None = None,
        tau_syn_ms: float | None = None,
        learning_rate: float | None = None,
        batch: int | None = None,
        epochs: int | None = None,
        patience: int | None = None,
        network: str | Path | RSNNSpec = "default",
        settings: Mapping[str, Any] | None = None,
        validation_fraction: float | None = None,
        exit_tolerance: float = 0.01,
        sampling_rate_Hz: float | None = None,
        random_state: int | np.random.RandomState | np.random.Generator | None = None,
        device: str = "cpu",
        verbose: bool = False,
    ):
        self.hidden = hidden
        self.recurrent = recurrent
        self.tau_mem_ms = tau_mem_ms
        self.tau_syn_ms = tau_syn_ms
        self.learning_rate = learning_rate
        self.batch = batch
        self.epochs = epochs
        self.patience = patience
        self.network = network
        self.settings = settings
        self.validation_fraction = validation_fraction
        self.exit_tolerance = exit_tolerance
        self.sampling_rate_Hz = sampling_rate_Hz
        self.random_state = random_state
        self.device = device
        self.verbose = verbose

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        sample_weight: ArrayLike | None = None,
        *,
        validation: tuple[ArrayLike, ArrayLike] | None = None,
        groups: ArrayLike | None = None,
    ) -> "SpikingClassifier":
        """Train on X `(window, time, afferent)`, y `(window,)`.

        sample_weight: of each window `(window,)`, in the cross-entropy of training and validation; a window of weight 0
            is left out.
        validation: `(X, y)` for early stopping and for the exit rule; held out from X when None.
        groups: the trial of each window; windows of one trial are then held out together.
        """
        self._check_parameters()
        effects.check(held_out=validation is None, validation_fraction=self.validation_fraction, groups=groups)
        rate_Hz, origin = self._clock(X), getattr(X, "origin", None)
        spikes = spike_windows(X, n_afferents=None if origin is None else len(origin.afferents))
        if origin is None:
            warn_of_swapped(spikes, AXES)
        labels, weights = class_labels(y, len(spikes)), None
        if sample_weight is not None:
            counted, weights = _weights(sample_weight, len(spikes))
            spikes, labels = spikes[counted], labels[counted]
            groups = None if groups is None else trial_labels(groups, len(counted), "groups")[counted]
        classes, indices = np.unique(labels, return_inverse=True)
        if len(classes) < 2:
            raise InputError(f"y: holds one class, '{classes[0]}', where a classifier needs two; add another class")
        weights_seed, order_seed, split_seed = self._seeds()
        if validation is None:
            first = equal_examples(spikes, indices)
            inside, held, trial = self._hold_out(classes[indices], groups, split_seed, first)
            train_side = _examples(spikes, indices, weights, inside)
            validation_side = _examples(spikes, indices, weights, held)._replace(of=torch.from_numpy(trial))
        else:
            train_side = _examples(spikes, indices, weights)
            names = None if origin is None else origin.afferents
            validation_side = _validation(validation, classes, spikes.shape[1:], names)
        spec = recipe.chosen_for(self.spec(), train_side.spikes, rate_Hz)
        effects.check_keys(given_keys(self.network, self._given()), [void_keys(spec)], "SpikingClassifier")

        def new(spec: RSNNSpec, seeds: tuple[int, int]) -> tuple[Network, torch.Generator]:
            weights, order = (torch.Generator().manual_seed(seed) for seed in seeds)
            return begin(train_side.spikes, len(classes), spec, rate_Hz, weights).to(self.device), order

        progress, first = _print_epoch if self.verbose else None, (weights_seed, order_seed)
        network, training = ensemble.train(new, spec, first, train_side, validation_side, progress=progress)
        self.training_: Training = training
        self.network_: Network = network
        self.exit_choice_: ExitChoice = exit_of(network, validation_side, self.exit_tolerance, train_side)
        self.exit_rule_: ExitRule = self.exit_choice_.rule
        self.classes_ = classes
        self.n_features_in_ = spikes.shape[2]
        self.sampling_rate_Hz_ = rate_Hz
        self.origin_: Origin | None = origin
        self.window_: WindowSpec = _window_of(origin, spikes.shape[1], rate_Hz)
        return self

    def spec(self) -> RSNNSpec:
        """The network spec that the parameters describe; `network_.spec` has the choices of a recipe."""
        return resolve(RSNNSpec, self.network, self._given())

    def _given(self) -> dict[str, Any]:
        """The keys of the spec that the parameters give."""
        given = {name: getattr(self, name) for name in ("hidden", "tau_mem_ms", "tau_syn_ms")}
        given |= {f"training.{name}": getattr(self, name) for name in TRAINING}
        if self.recurrent is not None:
            given["model"] = "rsnn" if self.recurrent else "snn"
        chosen = {key: value for key, value in given.items() if value is not None}
        return {**chosen, **checked_settings(self.settings)}

    def predict(self, X: ArrayLike) -> np.ndarray:
        """Class of each window over its full length, `(window,)`."""
        labels = self._infer(X, FULL_WINDOW).labels.cpu().numpy()
        return self.classes_[labels]

    def predict_proba(self, X: ArrayLike) -> np.ndarray:
        """Softmax of the readout over the full length, `(window, class)`: the probabilities that training fits.

        Spike counts are first multiplied by `training.temperature`, as in the loss. They are as well calibrated as the
        training made them; `sklearn.calibration` can do more.
        """
        readout = self._infer(X, FULL_WINDOW).readout.cpu().double() * self.network_.spec.training.temperature
        return readout.softmax(dim=1).numpy()

    def decision_function(self, X: ArrayLike) -> np.ndarray:
        """Readout of each window `(window, class)`: spike counts, or the values of an integrator; for two classes their
        difference `(window,)`.
        """
        counts = self._infer(X, FULL_WINDOW).readout.cpu().numpy()
        return counts[:, 1] - counts[:, 0] if len(self.classes_) == 2 else counts

    def sops(self, X: ArrayLike, *, early_exit: bool = False) -> synops.Synops:
        """Synaptic operations of each window: `input`, `recurrent`, `readout`, `total`, ... each `(window,)`."""
        return synops_of(self._infer(X, self._rule(early_exit)), self.network_)

    def costs(
        self, X: ArrayLike, *, early_exit: bool = False, prices: str | Path | PriceList = DEFAULT
    ) -> pd.DataFrame:
        """What a decision costs on average over X: conditioning and encoding (where X says its encoder), and network.

        One row each, with macs, acs, parameters, signal_ms and an energy estimate of arithmetic and memory
        (docs/concepts/energy.md). prices: the price list, by name or path, or a `PriceList`.
        """
        priced = price_list(prices)
        decided = self.decide(X, early_exit=early_exit).drop(columns="predicted").mean()
        origin = self.origin_
        made_by = {"encoder": None if origin is None else origin.encoder, "recorded_Hz": origin and origin.recorded_Hz}
        made_by |= {"prices": priced, "synapses": self.network_.synapses}
        sizes = self.n_features_in_, len(self.classes_)
        means = decided.to_frame().T
        return ledger.decision_ledger(self.network_.spec, *sizes, self.sampling_rate_Hz_, means, **made_by)

    def decide(self, X: ArrayLike, *, early_exit: bool = False) -> pd.DataFrame:
        """The decision for each window, its time and its cost: one row per window.

        early_exit: stop each window by `exit_choice_.used`, that is where early exit is used.
        Columns: predicted, steps, ms (until the decision), input_spikes, hidden_spikes, and sops_* as in a SOP report.
        """
        inferred = self._infer(X, self._rule(early_exit))
        steps = inferred.steps.cpu().numpy()
        return pd.DataFrame(
            {
                "predicted": self.classes_[inferred.labels.cpu().numpy()],
                "steps": steps,
                "ms": 1e3 * steps / self.sampling_rate_Hz_,
                "input_spikes": inferred.input_spikes.cpu().numpy(),
                "hidden_spikes": inferred.hidden_spikes.cpu().numpy(),
                **{f"sops_{name}": values for name, values in synops_of(inferred, self.network_)._asdict().items()},
            }
        )

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        tags.non_deterministic = False
        return tags

    def _rule(self, early_exit: bool) -> ExitRule:
        check_is_fitted(self)
        return self.exit_choice_.used if early_exit else FULL_WINDOW

    def _infer(self, X: ArrayLike, rule: ExitRule) -> Inference:
        check_is_fitted(self)
        spikes = spike_windows(X, n_afferents=self.n_features_in_)
        rate_Hz = getattr(X, "sampling_rate_Hz", None)
        if rate_Hz is not None and rate_Hz != self.sampling_rate_Hz_:
            raise InputError(
                f"X: is sampled at {rate_Hz:g} Hz but the network was trained at {self.sampling_rate_Hz_:g} Hz; "
                "encode it on that clock"
            )
        known = None if self.origin_ is None else self.origin_.afferents
        ordered = np.ascontiguousarray(in_order(X, spikes, known))
        return self.network_.infer(torch.from_numpy(ordered).to(self.device), rule)

    def _check_parameters(self) -> None:
        """Refuse values that would fail only during or after a training; the spec checks its own keys."""
        fraction("exit_tolerance", self.exit_tolerance)
        if self.validation_fraction is not None:
            fraction("validation_fraction", self.validation_fraction, above=True)
        try:
            torch.empty(0, device=self.device)
        except (AssertionError, RuntimeError) as error:  # an unknown name; a build of torch without CUDA; no such GPU
            raise InputError(
                f"device: {self.device!r} cannot be used; choose 'cpu', or a GPU that torch finds"
            ) from error

    def _clock(self, X: ArrayLike) -> float:
        own = getattr(X, "sampling_rate_Hz", None)
        given = self.sampling_rate_Hz
        if given is None and own is None:
            raise InputError(
                "sampling_rate_Hz: X does not say its clock; pass SpikingClassifier(sampling_rate_Hz=...) or make X "
                "with nt.windows"
            )
        for rate_Hz in (given, own):
            if rate_Hz is not None:
                check_sampling_rate(rate_Hz, "SpikingClassifier")
        if given is not None and own is not None and given != own:
            raise InputError(f"sampling_rate_Hz: is {given:g} but X is sampled at {own:g} Hz; leave the parameter out")
        return float(given if own is None else own)  # pyright: ignore[reportArgumentType]

    def _seeds(self) -> tuple[int, int, int]:
        """Random seeds of the weights, the order of windows and the windows that are held out."""
        state = self.random_state
        if isinstance(state, np.random.RandomState):
            first = int(state.randint(2**31 - 2))
        elif state is None:
            first = int(np.random.default_rng().integers(2**31 - 2))
        elif isinstance(state, np.random.Generator):
            first = int(state.integers(2**31 - 2))
        elif isinstance(state, Integral) and 0 <= state < 2**32:
            first = int(state)
        else:
            raise InputError(
                "random_state: must be None, a whole number from 0 to 2^32 - 1, a numpy.random.Generator or a "
                f"numpy.random.RandomState; got {state!r}"
            )
        return first, first + 1, first

    def _hold_out(
        self, y: np.ndarray, groups: ArrayLike | None, seed: int, first: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The windows to train on, those for validation, and the trial of each of the latter, a number.

        first: the first window that each one equals.
        """
        share = VALIDATION if self.validation_fraction is None else self.validation_fraction
        first = np.arange(len(y)) if first is None else first
        of = first
        if groups is None:
            try:
                held = hold_out(y, share, seed, first)
            except InputError as error:
                raise InputError(
                    "y: a class has too few windows to hold one out for validation; add windows or pass "
                    "validation=(X, y)"
                ) from error
        else:
            trials = trial_labels(groups, len(y), "groups")
            of = trials[joined(trials, first)]
            try:
                held = hold_out_groups(y, of, share, seed)
            except InputError:  # trials of equal windows: patterns that repeat, no copies
                of = trials
                held = hold_out_groups(y, of, share, seed)
        return np.setdiff1d(np.arange(len(y)), held), held, np.unique(of[held], return_inverse=True)[1]


def spike_windows(X: ArrayLike, n_afferents: int | None = None) -> np.ndarray:
    """X as spikes `(window, time, afferent)` uint8; InputError for other shapes and values than 0 and 1.

    >>> spike_windows(np.full((1, 2, 1), 0.5))
    Traceback (most recent call last):
    neurotact.errors.InputError: X: holds values other than 0 and 1; encode the signals first (nt.encode)
    """
    values = sequences(X, AXES)
    if not ((values == 0) | (values == 1)).all():
        raise InputError("X: holds values other than 0 and 1; encode the signals first (nt.encode)")
    if n_afferents is not None:
        check_last_axis(values, n_afferents, AXES)
    return np.array(values, np.uint8, order="C")


def _validation(
    validation: tuple[ArrayLike, ArrayLike],
    classes: np.ndarray,
    shape: tuple[int, ...],
    afferents: tuple[str, ...] | None,
) -> Examples:
    """The validation windows, of the classes, the shape `(time, afferent)` and the afferents of training."""
    try:
        X, y = validation
    except (TypeError, ValueError) as error:
        raise InputError("validation: must be a pair (X, y)") from error
    spikes = in_order(X, spike_windows(X, n_afferents=shape[1]), afferents, "validation")
    if spikes.shape[1] != shape[0]:
        raise InputError(f"validation: windows have {spikes.shape[1]} steps, but training windows have {shape[0]}")
    labels = class_labels(y, len(spikes), "validation")
    unknown = labels[~np.isin(labels, classes)]
    if len(unknown):
        raise InputError(f"validation: class '{unknown[0]}' is not a class of training; leave it out")
    indices = np.searchsorted(classes, labels)
    return _examples(spikes, indices)._replace(of=torch.from_numpy(equal_examples(spikes, indices)))


def _examples(
    spikes: np.ndarray, labels: np.ndarray, weights: np.ndarray | None = None, chosen: np.ndarray | None = None
) -> Examples:
    """The chosen windows, all by default; their weights have the mean 1."""
    index = np.arange(len(labels)) if chosen is None else chosen
    own = None if weights is None else weights[index] / weights[index].mean()
    return Examples(
        torch.from_numpy(spikes[index]),
        torch.from_numpy(labels[index].astype(np.int64)),
        None if own is None or (own == 1).all() else torch.from_numpy(own.astype(np.float32)),
    )


def _weights(sample_weight: ArrayLike, n_windows: int) -> tuple[np.ndarray, np.ndarray]:
    """Which windows count, `(window,)` boolean, and the weights of these.

    >>> _weights([0, 2, 1], 3)
    (array([False,  True,  True]), array([2., 1.]))
    """
    weights = np.asarray(sample_weight, np.float64)
    if weights.shape != (n_windows,):
        raise InputError(
            f"sample_weight: has the shape {weights.shape} where X has {number_of(n_windows, 'window')}; "
            "give one weight per window"
        )
    if not (np.isfinite(weights).all() and (weights >= 0).all() and weights.any()):
        raise InputError("sample_weight: must be finite numbers >= 0, not all 0")
    return weights > 0, weights[weights > 0]


def _window_of(origin: Origin | None, n_steps: int, rate_Hz: float) -> WindowSpec:
    """How windows of this length were cut: as X says, else whole trials."""
    known = None if origin is None else origin.window
    if known is not None and whole_steps(known.length_ms, rate_Hz) == n_steps:
        return known
    return WindowSpec(length_ms=1e3 * n_steps / rate_Hz)


def _print_epoch(epoch: Epoch) -> None:
    member = f"network {epoch.member}, " if epoch.member > 1 else ""
    print(
        f"{member}epoch {epoch.epoch}: loss {epoch.train_loss:.3f}, in validation {epoch.validation_loss:.3f}; "
        f"accuracy {epoch.train_accuracy:.3f}, in validation {epoch.validation_accuracy:.3f}"
    )
