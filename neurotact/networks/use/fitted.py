"""A trained network from what users hold: a run folder, a fitted classifier, or a pipeline that ends in one."""

import copy
from pathlib import Path
from typing import Any

from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted

from neurotact.errors import InputError
from neurotact.networks.training import run_folder
from neurotact.networks.training.run_folder import Restored
from neurotact.networks.training.tasks import Task
from neurotact.networks.use.classifier import SpikingClassifier

Fitted = str | Path | SpikingClassifier | Pipeline
"""A folder that `train` wrote, a fitted `SpikingClassifier`, or a fitted scikit-learn pipeline that ends in one."""


def is_in_memory(source: object) -> bool:
    """Whether a source is an estimator, and no path.

    >>> is_in_memory("runs/felt"), is_in_memory(SpikingClassifier())
    (False, True)
    """
    return isinstance(source, (SpikingClassifier, Pipeline)) or hasattr(source, "best_estimator_")


def _classifier_of(source: Any) -> SpikingClassifier:
    """The fitted classifier of an estimator: itself, the last step of a pipeline, or the best of a search.

    Raises InputError where the last step is another estimator, and scikit-learn's NotFittedError before `fit`.
    """
    model = getattr(source, "best_estimator_", source)
    model = model[-1] if isinstance(model, Pipeline) else model
    if not isinstance(model, SpikingClassifier):
        raise InputError(
            f"{type(source).__name__}: ends in {type(model).__name__}; give a SpikingClassifier, or a pipeline that "
            "ends in one"
        )
    check_is_fitted(model)
    return model


def name_of(source: Any) -> str:
    """A source in words, for messages and titles.

    >>> name_of(Path("runs/felt")), name_of(SpikingClassifier())
    ('runs/felt', 'SpikingClassifier')
    """
    return type(source).__name__ if is_in_memory(source) else str(source)


def check_folder(run: object, function: str, why: str) -> None:
    """InputError unless `run` is a path: the function needs more of a training than a fitted estimator keeps."""
    if not isinstance(run, (str, Path)):
        raise InputError(
            f"run: {function} needs the folder of a training, {why}; got {type(run).__name__}; `nt.train(...)` makes "
            "one"
        )


def restore(source: Fitted, *, device: str = "cpu", spikes: str | Path | None = None) -> Restored:
    """The network of a source with its encoder, its exit rule and its windows; a copy, for an estimator.

    spikes: the file of spikes of a run folder, if it is where the folder does not say. An estimator has none: its
    encoder is that of the spikes it was fitted on, and None where they did not say it.
    Raises InputError for anything else, and as `run_folder.restore` does.
    """
    if isinstance(source, (str, Path)):
        return run_folder.restore(source, device=device, spikes=spikes)
    if not is_in_memory(source):
        raise InputError(
            f"run: must be the folder of a training, a fitted SpikingClassifier, or a pipeline that ends in one; got "
            f"{type(source).__name__}"
        )
    classifier = _classifier_of(source)
    origin, network = classifier.origin_, copy.deepcopy(classifier.network_).to(device)
    return Restored(
        network, Task(window=classifier.window_), classifier.exit_rule_, tuple(map(str, classifier.classes_)), (),
        None if origin is None else origin.encoder, None, recorded_Hz=None if origin is None else origin.recorded_Hz,
        names=None if origin is None else origin.afferents,
        held=classifier.exit_choice_, source=name_of(source),
    )  # fmt: skip
