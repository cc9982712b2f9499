"""Decisions of a trained network, window by window, on spike trains of its training or on others."""

import warnings

import numpy as np
import pandas as pd

from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import left_out
from neurotact.errors import InputError, number_of
from neurotact.metrics import synops
from neurotact.networks.training.events import tool
from neurotact.networks.training.provenance import Provenance, first_difference
from neurotact.networks.training.run_folder import Restored
from neurotact.networks.training.tasks import examples_of, warn_of_onsets
from neurotact.networks.use.measuring import synops_of
from neurotact.progress import say


def infer(
    restored: Restored,
    trains: SpikeTrains,
    *,
    early_exit: bool,
    test_only: bool = False,
    allow_other_encoder: bool = False,
) -> pd.DataFrame:
    """Decide every window of some spike trains: the SOP report, one row per window.

    Columns: those of `synops.table_of`, with class names in `label` and `predicted`; and `side`, the side of the split
    that had the window's trial: training, validation, test or unseen; "unknown" of a network that was fitted in memory.
    Of a network that tells numbers, `true_NAME` and `predicted_NAME` of each target in place of `predicted`; what the
    trial has no number of is NaN.

    test_only: leave out all trials but the network's own test trials.
    allow_other_encoder: warn of spikes with another encoder than in training, instead of refusing them.
    Raises InputError for spikes of another encoder, other afferents, another clock or, unless the network refuses
    touches that are none of its classes, unknown classes.
    """
    unknown, target = sorted(set(trains.classes) - set(restored.classes)), restored.task.target
    if unknown and not target and restored.refusal is None:
        raise InputError(f"spikes: class '{unknown[0]}' is not a class of the network ({', '.join(restored.classes)})")
    check_same_input(restored, trains, allow_other_encoder)
    known = restored.provenance
    if restored.detector is not None:
        return tool("detected_events")(restored, trains, test_only=test_only)
    sides = np.full(len(trains), synops.UNKNOWN) if known is None else known.sides(trains)
    trials = _tested(trains, known) if test_only else np.arange(len(trains))
    warn_of_onsets(trains.select(trials), restored.task.window)
    examples, windows = examples_of(trains, trials, restored.task)
    fits = ~np.isin(np.arange(len(trains)), np.setdiff1d(trials, windows.trial))
    for line in left_out(fits, 1e3 * trains.trial_steps / trains.sampling_rate_Hz):
        warnings.warn(line, stacklevel=2)
    network, held = restored.network, restored.held
    if early_exit and target and restored.rule.never:
        say("early exit is not used, whole windows decide: no rule saves steps and loses as little as is allowed")
    if early_exit and held is not None and held.is_refused:
        say(f"early exit is not used, whole windows decide: {held.in_words}")
    if restored.refusal is not None and not restored.refusal.whole:
        say(restored.refusal.in_words)
    result = network.infer(examples.spikes.to(network.device), restored.exits(early_exit))
    labels, steps, input_spikes, hidden_spikes = (part.cpu().numpy() for part in result[:4])
    table = synops.table_of(
        synops_of(result, network),
        labels=np.array(trains.classes)[trains.labels[windows.trial]],
        predicted=labels if target else np.array([*restored.classes, synops.REFUSED])[labels],
        steps=steps,
        input_spikes=input_spikes,
        hidden_spikes=hidden_spikes,
        trials=windows.trial,
    )
    table.insert(1, synops.SIDE, sides[windows.trial])
    if not target:
        return table
    place, told = table.columns.get_loc("predicted"), (examples.labels.numpy(), result.readout.cpu().numpy())
    table = table.drop(columns="predicted")
    for name, true, value in reversed([*zip(target, *(values.T for values in told), strict=True)]):
        table.insert(place, f"{synops.OF_NUMBERS}{name}", value)
        table.insert(place, f"true_{name}", true.astype(float))
    return table


def check_same_input(restored: Restored, trains: SpikeTrains, allow_other: bool | None = None) -> None:
    """Refuse spikes of another clock, other afferents or, unless it is allowed with a warning, another encoder.

    allow_other: None for what has no option for it.
    """
    if trains.sampling_rate_Hz != restored.network.sampling_rate_Hz:
        raise InputError(
            f"spikes: are sampled at {trains.sampling_rate_Hz:g} Hz but the network was trained at "
            f"{restored.network.sampling_rate_Hz:g} Hz; encode them on that clock"
        )
    n_inputs = restored.network.n_inputs
    if len(trains.afferents) != n_inputs:
        raise InputError(
            f"spikes: come from {number_of(len(trains.afferents), 'afferent')} but the network was trained on "
            f"{n_inputs}; encode recordings of the same taxels"
        )
    if restored.encoder is None:
        return
    trained_on = trains.afferents if restored.provenance is None else restored.provenance.afferents
    difference = first_difference(trains.encoder, trains.afferents, restored.encoder, trained_on)
    if difference and not allow_other:
        option = "" if allow_other is None else ", or pass `allow_other_encoder=True` if you mean it"
        raise InputError(f"spikes: {difference}; encode the recordings as in training{option}")
    if difference:
        warnings.warn(f"spikes: {difference}; accuracy and SOPs are those of another encoder", stacklevel=3)


def _tested(trains: SpikeTrains, known: Provenance | None) -> np.ndarray:
    """The network's test trials among some trials, identified by their content."""
    trials = np.array([], np.int64) if known is None else known.tested(trains)
    if not len(trials):
        raise InputError(
            "spikes: hold none of the network's test trials; give the spikes that it was trained on, or use "
            "neurotact infer"
        )
    return trials
