"""A new class from a few touches: the readout of a trained network is refitted, and everything before it stays.

The readout becomes a ridge regression of +1 for the class and -1 for the others on what it hears in each stretch of a
window, the classes weighted alike. New touches are then learned one after another by recursive least squares (Haykin
2002, Adaptive Filter Theory, Sec. 9.3), which needs the inverse of one matrix of old touches and none of these touches.
The result equals the regression on all touches at once.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from neurotact import files
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.progress import Tell, untold

if TYPE_CHECKING:
    from torch import Tensor

    from neurotact.data.spikes import SpikeTrains
    from neurotact.networks.training.epochs import Examples

with lazily():
    from neurotact.baselines import opponent
    from neurotact.data import hdf5, splits
    from neurotact.metrics import shares
    from neurotact.networks.definition import rsnn
    from neurotact.networks.training import provenance, ranges, resumable, run_folder, tasks
    from neurotact.networks.use import fitted, inference, measuring

TOUCHES = 5
PENALTIES = (10.0, 1.0, 0.1, 0.01, 0.001)
"""Of the ridge, in units of the mean square of what the readout hears; the strongest of equally good ones stands."""
LOST = 0.05
"""The share of the known touches that is lost above which the command says what to do."""
AT_ONCE = 256
"""Windows that are simulated together."""


class Readout(NamedTuple):
    """Weights `(feature, class)`, the last feature being 1, and what recursive least squares keeps of old touches.

    inverse: of the sum of squares and the penalty, `(feature, feature)`. moment: the weighted sum of features, from
    which the weights of a class begin of which no touch is known. each: the weights of a class's touches in sum.
    """

    weights: np.ndarray
    inverse: np.ndarray
    moment: np.ndarray
    each: float

    def with_class(self) -> Readout:
        """The same with one class more, of which no touch is known yet."""
        return self._replace(weights=np.column_stack([self.weights, -self.inverse @ self.moment]))

    def after(self, features: np.ndarray, label: int, weight: float) -> Readout:
        """One touch later: its features `(feature,)`, its class, and how much it counts.

        >>> begun = fitted_to(np.array([[1.0, 1.0], [3.0, 1.0]]), np.array([0, 1]), 2, 0.1)
        >>> begun.with_class().after(np.array([9.0, 1.0]), 2, 1.0).weights.shape
        (2, 3)
        """
        along = self.inverse @ features
        gain = along / (1 / weight + features @ along)
        target = np.where(np.arange(self.weights.shape[1]) == label, 1.0, -1.0)
        weights = self.weights + np.outer(gain, target - features @ self.weights)
        moment = self.moment + weight * features
        return Readout(weights, self.inverse - np.outer(gain, along), moment, self.each)


def fitted_to(features: np.ndarray, labels: np.ndarray, n_classes: int, penalty: float) -> Readout:
    """The readout of features `(window, feature)`, whose last is 1, and class indices `(window,)`."""
    counts = np.bincount(labels, minlength=n_classes)
    each = len(labels) / np.count_nonzero(counts)
    weighted = features * (each / counts[labels])[:, None]
    size = features.shape[1]
    ridge = np.full(size, penalty * max(float(np.square(features[:, :-1]).mean()), 1e-12) * len(labels))
    ridge[-1] = 1e-6 * len(labels)
    inverse = np.linalg.inv(features.T @ weighted + np.diag(ridge))
    targets = np.where(np.arange(n_classes) == labels[:, None], 1.0, -1.0)
    return Readout(inverse @ (weighted.T @ targets), inverse, weighted.sum(axis=0), each)


def features_of(network: rsnn.RSNN, spikes: Tensor) -> np.ndarray:
    """What the readout hears in each stretch of windows `(window, time, afferent)`, and 1: `(window, feature)`."""
    import torch

    with torch.no_grad():
        heard = [network.counted(network.binned(part), network.stretches)[1] for part in spikes.split(AT_ONCE)]
    counts = torch.cat(heard).flatten(1).double().numpy()
    return np.column_stack([counts, np.ones(len(counts))])


def with_readout(network: rsnn.RSNN, readout: Readout) -> rsnn.RSNN:
    """A network with the weights before the readout as they are, and those of a refitted readout."""
    import torch

    n_classes = readout.weights.shape[1]
    new = rsnn.RSNN(
        network.n_inputs, n_classes, network.spec, network.sampling_rate_Hz,
        backend=network.backend, generator=torch.Generator(), dtype=network.dtype,
    )  # fmt: skip
    old = {name: tensor for name, tensor in network.state_dict().items() if name not in ("w_out", "w_stretch", "bias")}
    own = torch.from_numpy(readout.weights[:-1]).reshape(-1, len(network.w_out), n_classes)
    values = {**old, "w_out": own.mean(dim=0), "bias": torch.from_numpy(readout.weights[-1])}
    if network.w_stretch is not None:
        values["w_stretch"] = own - own.mean(dim=0)
    new.load_state_dict({name: value.to(network.state_dict()[name].dtype) for name, value in values.items()})
    return new


def refitted(network: rsnn.RSNN, training: Examples, validation: Examples, n_classes: int) -> Readout:
    """The readout to the classes of training windows whose penalty has the most validation windows right."""
    features, labels = features_of(network, training.spikes), training.labels.numpy()
    held, truth = features_of(network, validation.spikes), validation.labels.numpy()
    every = [fitted_to(features, labels, n_classes, penalty) for penalty in PENALTIES]
    return max(every, key=lambda one: float(((held @ one.weights).argmax(axis=1) == truth).mean()))


def teachable(restored: run_folder.Restored) -> tuple[tasks.Sides, Readout]:
    """The windows of a run's training and the readout that is refitted to them, from which new classes are learned.

    Touches that the run learned before are learned again, as they were heard.
    InputError for a network whose readout is no sum, and for one whose training had touches that are not there.
    """
    network = _sum_of(restored.of_classes("learning a class"))
    sides = tasks.sides_of(run_folder.trained_spikes_of(restored), restored.task)
    heard = _heard(restored, features_of(network, sides.train.spikes[:1]).shape[1])
    readout = refitted(network, sides.train, sides.validation, len(restored.classes) - len(heard))
    for touches in heard:
        readout = _taught(readout, touches)
    return sides, readout


def _heard(restored: run_folder.Restored, n_features: int) -> list[np.ndarray]:
    """The touches `(touch, feature)` of each class that a run learned before; InputError if they are no such."""
    n_trained = len(restored.classes) - len(restored.taught)
    with suppress(ValueError):
        heard = [np.array([touch.split() for touch in touches], np.float64) for touches in restored.taught.values()]
        are_touches = all(one.shape == (len(one), n_features) and np.isfinite(one).all() for one in heard)
        if are_touches and n_trained > 1 and [*restored.taught] == [*restored.classes[n_trained:]]:
            return heard
    raise InputError(
        f"{restored.source}: the touches of the classes that it learned (`taught` in network.json) were changed; learn "
        "them again from the run that was trained"
    )


def _taught(readout: Readout, touches: np.ndarray) -> Readout:
    """The same with one class more, after its touches `(touch, feature)`."""
    readout, label = readout.with_class(), readout.weights.shape[1]
    for features in touches:
        readout = readout.after(features, label, readout.each / len(touches))
    return readout


def learn(
    run: str | Path,
    touched: str | Path,
    folder: str | Path,
    *,
    touches: int = TOUCHES,
    spikes: str | Path | None = None,
    force: bool = False,
    tell: Tell = untold,
) -> dict[str, Any]:
    """Teach the network in the run folder `run` the new classes of a file of spikes, as `neurotact learn` does.

    Of each class that the network does not know `touches` trials are learned, evenly spaced over the file; the others
    test it. Only the readout changes. The network is saved in `folder`, a run that `infer`, `stream` and `export` take;
    early exit and the refusal of unknown classes were chosen for the old readout, and are not used.
    spikes: that the run was trained on, where they moved since. force: replace a training that is in the folder. tell:
    called with what the command prints.
    Returns accuracies: `old_before`, `old_refitted`, `old_after` of the known classes on the run's test windows, with
    the readout of the run, the refitted one, and that with the new classes; `new` of the other touches, NaN without
    any. A run that has learned a class learns another; its `old_` accuracies are of the classes of its training.
    Raises InputError for a network whose readout is no sum, for spikes of another encoder, and without a new class.

    >>> nt.learn("run", "spikes-of-silk.h5", "run-with-silk", touches=5)  # doctest: +SKIP
    """
    fitted.check_folder(run, "learn", "which has the spikes of its training")
    source, folder = Path(run), Path(folder)
    if touches < 1:
        raise InputError(f"touches: must be at least 1; got {touches}")
    resumable.check_apart(folder, source, "learn")
    with files.locked(folder):
        resumable.check_place(folder, force=force)
        restored = run_folder.restore(source, spikes=spikes)
        sides, begun = teachable(restored)
        network = _sum_of(restored)
        felt = _felt(restored, hdf5.load_spikes(touched), str(touched))
        classes = sorted(set(felt.classes) - set(restored.classes))
        n_known = int(felt.conditions["label"].isin(restored.classes).sum())
        places = {name: np.flatnonzero(felt.conditions["label"] == name) for name in classes}
        taught = {name: its[opponent.part_of(np.zeros(len(its)), touches)] for name, its in places.items()}
        readout, heard = begun, dict(restored.taught)
        for name, trials in taught.items():
            examples, _ = tasks.examples_of(felt, trials, restored.task, restored.task.training_window)
            features = features_of(network, examples.spikes)
            readout = _taught(readout, features)
            heard[name] = [" ".join(f"{value:.17g}" for value in touch) for touch in features]
        after = with_readout(network, readout)
        row = {
            "old_before": _right(network, sides.test),
            "old_refitted": _right(with_readout(network, begun), sides.test),
            "old_after": _right(after, sides.test),
            "old_windows": len(sides.test.labels),
            **_of_others(after, restored, felt, taught),
            "touches": {name: len(trials) for name, trials in taught.items()},
        }
        resumable.clear(folder)
        extra = _extra(source, restored, after, sides.train, felt.select(np.concatenate([*taught.values()])), classes)
        extra |= {"spikes": os.path.relpath(restored.spikes_path or "", folder), "taught": heard}
        run_folder.save_network(after, folder, extra)
        files.write_json(folder / resumable.RESULT, {"row": files.without_nan(row), "compared": {}, "cautions": []})
    ignored = [f"{touched}: {n_known} trials of classes that the network knows are not used"] if n_known else []
    for line in (*ignored, *_lines(row), resumable.saved_in(folder)):
        tell(line)
    return row


def _sum_of(restored: run_folder.Restored) -> rsnn.RSNN:
    """The network of a run, whose readout must be a sum without a leak; InputError otherwise."""
    network = restored.network
    if not isinstance(network, rsnn.RSNN) or network.integration is None or network.integration.leaks:
        raise InputError(
            "run: its readout is no sum of spikes, and only that is refitted; train it with `readout = 'integrator'` "
            "and without readout_leak_ms"
        )
    return network


def _felt(restored: run_folder.Restored, trains: SpikeTrains, source: str) -> SpikeTrains:
    """The new touches, which must come from the same encoder and have a class that the network does not know."""
    if not set(trains.classes) - set(restored.classes):
        raise InputError(f"{source}: has no class that the network does not know ({', '.join(restored.classes)})")
    inference.check_same_input(restored, trains)
    return trains


def _right(network: rsnn.RSNN, examples: Examples) -> float:
    return measuring.accuracy_of(network.infer(examples.spikes), examples)


def _of_others(
    network: rsnn.RSNN, restored: run_folder.Restored, felt: SpikeTrains, taught: dict[str, np.ndarray]
) -> dict[str, Any]:
    """The accuracy on the touches of the new classes that were not learned, and its 95 % interval over trials."""
    right: list[float] = []
    for label, (name, trials) in enumerate(taught.items(), start=len(restored.classes)):
        others = np.setdiff1d(np.flatnonzero(felt.conditions["label"] == name), trials)
        if len(others):
            examples, windows = tasks.examples_of(felt, others, restored.task)
            decided = (network.infer(examples.spikes).labels == label).double().numpy()
            right += [float(decided[windows.trial == trial].mean()) for trial in np.unique(windows.trial)]
    share = float(np.mean(right)) if right else float("nan")
    low, high = shares.wilson_interval(share, len(right)) if right else (float("nan"),) * 2
    return {"new": share, "new_low": low, "new_high": high, "new_trials": len(right)}


def _extra(
    source: Path, restored: run_folder.Restored, network: rsnn.RSNN, training: Examples, taught: SpikeTrains,
    classes: list[str],
) -> dict[str, Any]:  # fmt: skip
    """What `network.json` says beside the network: as of the run, with new classes and what they were learned from."""
    extra = dict(files.read_json(source / run_folder.NETWORK)["extra"])
    for key in ("exit_losses", "has_own_rule", "fine_tuned", "joined", "refusal"):
        extra.pop(key, None)
    nothing = np.array([], np.int64)
    new = provenance.provenance_of(taught, splits.Split(np.arange(len(taught)), nothing, nothing))
    known = new if restored.provenance is None else restored.provenance.with_training(new)
    extra["trials"] = known.model_dump(mode="json")["trials"]
    if restored.ranges is not None:
        states = ranges.record_states(network, training.spikes)
        extra["ranges"] = restored.ranges._replace(hidden=states[0], readout=states[1])._asdict()
    return {**extra, "classes": [*restored.classes, *classes], "exit_patience": None}


def _lines(row: dict[str, Any]) -> list[str]:
    before, refitted_, after = (f"{100 * row[f'old_{when}']:.1f} %" for when in ("before", "refitted", "after"))
    learned = ", ".join(f"{name} from {n} touch{'' if n == 1 else 'es'}" for name, n in row["touches"].items())
    tested = (
        f"of {row['new_trials']} other touches {100 * row['new']:.1f} % are right (95 % interval "
        f"{100 * row['new_low']:.0f} to {100 * row['new_high']:.0f} %)"
        if row["new_trials"]
        else "no other touch tests it"
    )
    lost = row["old_before"] - row["old_after"]
    advice = "record more touches, or train again with all classes"
    return [
        f"learned {learned}; {tested}",
        f"classes of the training, {row['old_windows']} test windows: {before} before, {refitted_} with the refitted "
        f"readout, {after} with the new class{f', {100 * lost:.0f} points less: {advice}' if lost > LOST else ''}",
    ]
