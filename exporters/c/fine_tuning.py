"""Continued training with rounded weights, so that a network loses less accuracy in integers.

The forward pass uses the weights of the integer variant of the C export. Their steps are those that `formats` chooses
for the original network, and are constant. The gradients of the rounded weights reach the full-precision ones
(`exporters.c.rounding`). The rounded weights are saved with their steps, from which an export gets the same integers.
States and decays are not rounded during training. Test windows are not used.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field, PositiveFloat

from neurotact import effects, files
from neurotact.data.windows import steps_of
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.progress import Tell, track, untold
from neurotact.spec import Spec, build

if TYPE_CHECKING:
    import torch

with lazily():
    from neurotact_parts.exporters.c import formats, rounding

    from neurotact.networks.definition import rsnn
    from neurotact.networks.training import epochs as trainings
    from neurotact.networks.training import outcome as outcomes
    from neurotact.networks.training import ranges, resumable, run_folder, sparsity, tasks, trainer
    from neurotact.networks.use import fitted


EPOCHS = 10
KEY = "fine_tuned"


class FineTuned(Spec):
    """What is saved with a fine-tuned network (`network.json`, under `extra.fine_tuned`)."""

    network: str
    """The folder of the original network, relative to its own folder."""
    weights_sha256: str
    """Of the original weights."""
    weight_bits: int = Field(ge=2, le=8)
    state_bits: int = Field(ge=8, le=24)
    steps: tuple[PositiveFloat, PositiveFloat | None, PositiveFloat]
    """The value of 1 of an integer weight: into, among and out of the hidden neurons."""
    epochs: int = Field(ge=0)
    seed: int = Field(ge=0)


def tuned_of(restored: run_folder.Restored) -> FineTuned | None:
    """The fine-tuning that is saved with a network; None if it was not fine-tuned."""
    if restored.fine_tuned is None:
        return None
    return build(FineTuned, restored.fine_tuned, source=f"{run_folder.NETWORK}, {KEY}")


def grids_of(network: rsnn.RSNN, steps: formats.Steps, weight_bits: int) -> dict[str, rounding.Grid]:
    """The possible values of each matrix of weights; an integrator's bias has the steps of its weights, and 32 bits.

    Raises InputError for a network with `readout_stretches`: the sum of two weights on a grid may be too large for it.
    """
    if network.stretches is not None:
        raise InputError("readout_stretches: fine-tuning rounds one readout; fine-tune with 0 epochs, or train with 1")
    most = 2 ** (weight_bits - 1) - 1
    grids = {name: rounding.Grid(step, most) for name, step in steps._asdict().items() if step is not None}
    return grids if network.bias is None else {**grids, "bias": rounding.Grid(steps.w_out, formats.LARGEST)}


def train_rounded(
    network: rsnn.RSNN,
    training: trainings.Examples,
    validation: trainings.Examples,
    grids: dict[str, rounding.Grid],
    *,
    generator: torch.Generator,
    epochs: int = EPOCHS,
    progress: Callable[[trainings.Epoch], None] | None = None,
) -> trainings.Training:
    """Continue the training of a network in place, with weights rounded to their grids; it ends with rounded weights.

    grids: by name of the weights (`grids_of`); weights without a grid are not rounded. generator: orders the windows.
    The network's own training settings are used, with learning rates that fall to 0 over `epochs`. Epoch 0 is rounding
    alone; it is the result if no epoch is better on the validation windows. Pruned weights stay 0.
    """
    settings = network.spec.training
    if settings.keep == "both":  # training accuracy is that of disturbed windows, except in epoch 0
        settings = settings.model_copy(update={"keep": "accuracy"})
    if epochs:
        update = {"epochs": epochs, "patience": epochs, "schedule": "cosine"}
        network.spec = network.spec.model_copy(update={"training": settings.model_copy(update=update)})
    with rounding.seen_rounded(network, grids), sparsity.pruned_stay_pruned(network):
        rounded = trainings.Epoch(0, *trainings.evaluate(network, training), *trainings.evaluate(network, validation))
        before = copy.deepcopy(network.state_dict())
        log = [rounded]
        if epochs:
            log += trainings.train(network, training, validation, generator=generator, progress=progress).epochs
        best = trainings.best_of(log, settings.keep)
        if best is rounded:
            network.load_state_dict(before)
    return trainings.Training(tuple(log), best)


def fine_tune(
    run: str | Path,
    folder: str | Path,
    *,
    weight_bits: int = 8,
    state_bits: int | None = None,
    epochs: int = EPOCHS,
    seed: int | None = None,
    spikes: str | Path | None = None,
    force: bool = False,
    tell: Tell = untold,
) -> dict[str, Any]:
    """Train the network in the run folder `run` on with rounded weights, as `neurotact fine-tune` does.

    It is saved in `folder` as a run of its own, which `export_c` writes with these bits. weight_bits: 2 to 8.
    state_bits: 8 to 16, or 24; chosen when None. epochs: 0 rounds alone. seed: of the order of windows, 0 if
    None. Training and validation trials are used alone.
    spikes: that the run was trained on, where they moved since. force: replace a training that is in the folder.
    tell: called with what the command prints. Returns what it came to, as `train` does.
    Raises InputError for a folder that is not free, and for spikes that are no longer those of the run.

    >>> nt.fine_tune("run", "few-bits", weight_bits=4, epochs=1)["accuracy_test"] >= 0
    True
    """
    fitted.check_folder(run, "fine_tune", "which it trains on from the spikes of that")
    effects.check(epochs=epochs, seed=seed)
    source, folder, seed = Path(run), Path(folder), seed or 0
    if not 0 <= epochs <= 100_000:
        raise InputError(f"epochs: must be from 0 to 100000; got {epochs}")
    resumable.check_apart(folder, source, "be fine-tuned")
    with files.locked(folder):
        resumable.check_place(folder, force=force)
        restored = run_folder.restore(source, spikes=spikes).of_classes("fine-tuning").as_trained("fine-tuning")
        trains = run_folder.trained_spikes_of(restored)
        assert restored.spikes_path is not None  # of a folder
        sides = tasks.sides_of(trains, restored.task)
        layers = layers_of(restored, sides, weight_bits=weight_bits, state_bits=state_bits)
        digest = files.sha256(source / run_folder.WEIGHTS)
        done = _trained_on(restored, sides, layers, weight_bits, epochs, seed)
        about = FineTuned(
            network=os.path.relpath(source, folder), weights_sha256=digest, weight_bits=weight_bits,
            state_bits=layers.hidden.state_bits, steps=layers.steps, epochs=epochs, seed=seed,
        )  # fmt: skip
        outcome = outcomes.outcome_of(done, sides, trains, restored.task, "fine-tune")
        resumable.clear(folder)
        more = {KEY: about.model_dump(mode="json")}
        run_folder.save(done, folder, trains, restored.spikes_path, restored.task, more=more)
        files.write_json(folder / resumable.RESULT, outcome.as_json())
    rounded, best = (100 * epoch.validation_accuracy for epoch in (done.training.epochs[0], done.training.best))
    tuned = (
        f"validation accuracy with {weight_bits}-bit weights: {rounded:.1f} % rounded, {best:.1f} % fine-tuned "
        f"(epoch {done.training.best.epoch} of {epochs})"
    )
    for line in (*outcome.lines(), tuned, resumable.saved_in(folder)):
        tell(line)
    return outcomes.summary_of(files.read_json(folder / resumable.RESULT))


def layers_of(restored: run_folder.Restored, sides: tasks.Sides, **options: Any) -> formats.Layers:
    """The network in integers, as an export chooses them; options as for `formats.layers_of`."""
    network = rsnn.rsnn_of("c-integer", restored.network)
    n_steps, _, _ = steps_of(restored.task.window, network.sampling_rate_Hz)
    seen = ranges.record_states(network, sides.train.spikes)
    return formats.layers_of(network, seen, n_steps=n_steps, **options)


def _trained_on(
    restored: run_folder.Restored, sides: tasks.Sides, layers: formats.Layers, weight_bits: int, epochs: int, seed: int
) -> trainer.Trained:
    from torch import Generator

    network, steps = rsnn.rsnn_of("c-integer", restored.network), layers.steps
    with track("fine-tune", epochs) as advance:
        training = train_rounded(
            network, sides.train, sides.validation, grids_of(network, steps, weight_bits),
            generator=Generator().manual_seed(seed), epochs=epochs,
            progress=lambda epoch: advance(1, resumable.line_of(epoch)),
        )  # fmt: skip
    # Refuse what an export refuses, before anything is saved.
    layers_of(restored, sides, weight_bits=weight_bits, state_bits=layers.hidden.state_bits, steps=steps)
    done = trainer.finished(network, training, sides, restored.task)
    if restored.has_own_rule:
        return done
    return trainer.refusing(done.with_rule(restored.rule, restored.held), sides.validation, restored.task)
