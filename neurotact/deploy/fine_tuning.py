"""Training on with rounded weights, so that a network loses less in whole numbers.

The forward pass sees the weights as the integer variant of the C export will hold them: the steps are those that
`formats` chooses for the network as it was trained, and stay. The gradients of the rounded weights reach the fine ones
(`networks.rounding`). What is saved are the rounded weights with their steps, from which an export makes the same whole
numbers. States and decays are not rounded while training. Training and validation windows are used, no test window.
"""

import copy
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import torch
from pydantic import Field, PositiveFloat

from neurotact import files
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import steps_of
from neurotact.deploy import formats
from neurotact.deploy.formats import Layers, Steps
from neurotact.errors import InputError
from neurotact.networks import checkpoint, fitting, tasks, train_run, trained
from neurotact.networks.outcome import Outcome, outcome_of
from neurotact.networks.provenance import provenance_of
from neurotact.networks.rounding import Grid, seen_rounded
from neurotact.networks.rsnn import RSNN
from neurotact.networks.tasks import Sides
from neurotact.networks.trained import Restored
from neurotact.networks.training import Epoch, Examples, Training, best_of, evaluate, train
from neurotact.progress import track
from neurotact.spec import Spec, build

EPOCHS = 10
KEY = "fine_tuned"


class FineTuned(Spec):
    """What a fine-tuned network remembers (`network.json`, under `extra.fine_tuned`)."""

    network: str
    """The folder of the network that it was made from, from its own."""
    weights_sha256: str
    """Of the weights that it was made from."""
    weight_bits: int = Field(ge=2, le=8)
    state_bits: int = Field(ge=8, le=24)
    steps: tuple[PositiveFloat, PositiveFloat | None, PositiveFloat]
    """What 1 of a whole weight stands for: into, among and out of the hidden neurons."""
    epochs: int = Field(ge=0)
    seed: int = Field(ge=0)


class Done(NamedTuple):
    """What a fine-tuning came to, and how it went; epoch 0 is rounding alone."""

    outcome: Outcome
    training: Training


def tuned_of(restored: Restored) -> FineTuned | None:
    """What a network that was read back remembers; None of one that was not fine-tuned."""
    if restored.fine_tuned is None:
        return None
    return build(FineTuned, restored.fine_tuned, source=f"{checkpoint.NETWORK}, {KEY}")


def grids_of(network: RSNN, steps: Steps, weight_bits: int) -> dict[str, Grid]:
    """What each of a network's weights may be; an integrator's bias has the steps of its weights, and 32 bits."""
    most = 2 ** (weight_bits - 1) - 1
    grids = {name: Grid(step, most) for name, step in steps._asdict().items() if step is not None}
    return grids if network.bias is None else {**grids, "bias": Grid(steps.w_out, formats.LARGEST)}


def fine_tune(
    network: RSNN,
    training: Examples,
    validation: Examples,
    grids: dict[str, Grid],
    *,
    generator: torch.Generator,
    epochs: int = EPOCHS,
    progress: Callable[[Epoch], None] | None = None,
) -> Training:
    """Train a network on in place, with weights that are seen on their grids, and leave it with those.

    grids: by the name of the weights (`grids_of`); those without one are not rounded. generator: orders the windows.
    The network's own settings of training hold, with rates that fall to 0 over `epochs`. Epoch 0 is rounding alone; it
    stays if no epoch is better on the validation windows.
    """
    settings = network.spec.training
    if settings.keep == "both":  # training accuracy is of disturbed windows, but that of epoch 0 is not
        settings = settings.model_copy(update={"keep": "accuracy"})
    if epochs:
        update = {"epochs": epochs, "patience": epochs, "schedule": "cosine"}
        network.spec = network.spec.model_copy(update={"training": settings.model_copy(update=update)})
    with seen_rounded(network, grids):
        rounded = Epoch(0, *evaluate(network, training), *evaluate(network, validation))
        before = copy.deepcopy(network.state_dict())
        log = [rounded]
        if epochs:
            log += train(network, training, validation, generator=generator, progress=progress).epochs
        best = best_of(log, settings.keep)
        if best is rounded:
            network.load_state_dict(before)
    return Training(tuple(log), best)


def run(
    source: str | Path,
    folder: str | Path,
    *,
    weight_bits: int = 8,
    state_bits: int | None = None,
    epochs: int = EPOCHS,
    seed: int = 0,
    force: bool = False,
) -> Done:
    """Fine-tune the network in the run folder `source` for whole weights, and leave it in `folder` as a run of its own.

    weight_bits, state_bits: as for `formats.choose`. epochs, seed: of training; 0 epochs: rounding alone.
    force: replace a training that is in `folder`.
    Raises InputError for a folder that is not free, and for spikes that are no longer those of the run.
    """
    source, folder = Path(source), Path(folder)
    if not 0 <= epochs <= 100_000:
        raise InputError(f"epochs: must be from 0 to 100000; got {epochs}")
    if folder.exists() and source.exists() and folder.samefile(source):
        raise InputError(f"{folder}: is the run that is to be fine-tuned; choose another folder with -o")
    with files.locked(folder):
        train_run.check_place(folder, force=force)
        restored = trained.restore(source)
        trains = trained.load_spikes_of(restored)
        _check_trials(source, restored, trains)
        sides = tasks.sides_of(trains, restored.task)
        layers = layers_of(restored, sides, weight_bits=weight_bits, state_bits=state_bits)
        digest = files.sha256(source / checkpoint.WEIGHTS)
        done = _trained_on(restored, sides, layers, weight_bits, epochs, seed)
        about = FineTuned(
            network=os.path.relpath(source, folder), weights_sha256=digest, weight_bits=weight_bits,
            state_bits=layers.hidden.state_bits, steps=layers.steps, epochs=epochs, seed=seed,
        )  # fmt: skip
        outcome = outcome_of(done, sides, trains, restored.task)
        train_run.clear(folder)
        more = {KEY: about.model_dump(mode="json")}
        trained.save(done, folder, trains, restored.spikes_path, restored.task, more=more)
        files.write_json(folder / train_run.RESULT, outcome.as_json())
    return Done(outcome, done.training)


def layers_of(restored: Restored, sides: Sides, **options: Any) -> Layers:
    """The network in whole numbers, as an export will choose them; options as for `formats.layers_of`."""
    network = restored.network
    n_steps, _, _ = steps_of(restored.task.window, network.sampling_rate_Hz)
    seen = formats.record_states(network, sides.train.spikes)
    return formats.layers_of(network, seen, n_steps=n_steps, **options)


def _trained_on(
    restored: Restored, sides: Sides, layers: Layers, weight_bits: int, epochs: int, seed: int
) -> fitting.Trained:
    network, steps = restored.network, layers.steps
    with track("fine-tune", epochs) as advance:
        training = fine_tune(
            network, sides.train, sides.validation, grids_of(network, steps, weight_bits),
            generator=torch.Generator().manual_seed(seed), epochs=epochs,
            progress=lambda epoch: advance(1, train_run.line_of(epoch)),
        )  # fmt: skip
    # What an export would refuse is refused here, before anything is saved.
    layers_of(restored, sides, weight_bits=weight_bits, state_bits=layers.hidden.state_bits, steps=steps)
    return fitting.finished(network, training, sides, restored.task)


def _check_trials(source: Path, restored: Restored, trains: SpikeTrains) -> None:
    """Refuse spikes whose sides hold other trials than in training: test trials may be among them."""
    known = restored.provenance
    if known is not None and provenance_of(trains, tasks.trials_of(trains, restored.task)).trials != known.trials:
        raise InputError(
            f"{source}: {restored.spikes_path} no longer holds the trials that it was trained on; train it again"
        )
