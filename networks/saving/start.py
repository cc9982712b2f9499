"""Where a search for savings starts: a trained run, what it was encoded from, and the spec of its network as asked."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from neurotact_parts.studies.comparison.needed_afferents import ranked
from neurotact_parts.studies.comparison.saving import Bench, Cut, Fitted, Setting

from neurotact.data import encoded_from
from neurotact.data.augmentation import NONE
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.model import name_in
from neurotact.errors import InputError
from neurotact.networks.definition import recipe, seeds
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import run_folder, tasks
from neurotact.networks.training.epochs import Epoch, Training
from neurotact.spec import build, leaves, override

TAUGHT = {"training.relative_learning_rate", "training.schedule", "training.keep"}
FITTED = {"readout", "readout_stretches", "readout_stretch_ms"}
"""Keys by which the default recipe is recognised in a network that was trained with it; in one without a hidden layer.
"""


class Start(NamedTuple):
    """A trained run: what all trials share, and the run itself as one that saves nothing."""

    bench: Bench
    base: Fitted

    @property
    def known(self) -> dict[str, Fitted]:
        """The trainings that are done: that of the run."""
        return {Setting().first_training(): self.base}


def start_of(run: Path, seed: int = 0, *, spikes: Path | None = None, recordings: Path | None = None) -> Start:
    """What a search needs of a run folder; `spikes` and `recordings` where these were moved since.

    Raises InputError for a network of another kind, for one that was trained on varied copies, for spikes that are no
    longer those of the run, and where the recordings are not found.
    """
    restored = (
        run_folder.restore(run, spikes=spikes).of_classes("a search for savings").as_trained("a search for savings")
    )
    network = _plain(restored.network)
    trains = run_folder.trained_spikes_of(restored)
    task, path = restored.task, restored.spikes_path
    if task.augmentation != NONE:
        raise InputError(
            f"{run}: was trained on varied copies ('{task.augmentation}'), which no search for savings makes; train it "
            "without them (augmentation = none), and search from there"
        )
    assert path is not None  # of a folder
    touches, encoder = _touches(path, trains, recordings)
    split = tasks.trials_of(trains, task)
    whole = Cut(trains, tasks.sides_of(trains, task, split))
    spec = asked(network.spec, recipe.Seen.of(whole.sides.train.spikes, trains.sampling_rate_Hz))
    ranking = () if encoder is None else tuple(ranked(network, whole.sides.train.spikes, encoder))
    bench = Bench(touches, encoder, split, task.window, spec, seeds.of_start(seed, task.split), task, ranking)
    order = torch.Generator().manual_seed(bench.seeds[1])
    untold = Training((), Epoch(0, math.nan, math.nan, math.nan, math.nan))
    return Start(bench, Fitted(network, *whole, order, untold))


def _plain(network: Network) -> RSNN:
    if not isinstance(network, RSNN):
        raise InputError(
            f"network: the ways to save are of one hidden layer, and this one is a '{network.spec.model}'; "
            "train an rsnn or an snn"
        )
    return network


def _touches(
    spikes: Path, trains: SpikeTrains, given: Path | None
) -> tuple[Recordings | SpikeTrains, AfferentSpec | None]:
    """The recordings of all trials and their encoder; the spikes alone where no LIF afferents made them."""
    if name_in(trains.encoder) != "lif" or not trains.encoder:
        if given is not None:
            raise InputError("recordings: have no effect with spikes of other afferents than lif; leave them out")
        return trains, None
    path, rows = encoded_from.find(spikes, trains, np.arange(len(trains)), given)
    with encoded_from.opened(path, trains) as stored:
        touches = stored.select(rows).loaded()
    known = AfferentSpec.model_fields
    return touches, build(AfferentSpec, {k: v for k, v in trains.encoder.items() if k in known}, source=str(spikes))


def asked(spec: RSNNSpec, seen: recipe.Seen) -> RSNNSpec:
    """The spec of a trained network without what the default recipe chose for its windows.

    With other windows or another clock the recipe chooses again. A network that was trained without it stays.

    >>> windows = recipe.Seen(900, 1000, 1000.0, 50.0)
    >>> again = asked(recipe.resolve(RSNNSpec(recipe="default", hidden=20, tau_mem_ms=7.0), windows), windows)
    >>> again.recipe, again.hidden, again.tau_mem_ms, "tau_syn_ms" in again.model_dump(mode="json")
    ('default', 20, 7.0, False)
    >>> alone = asked(recipe.resolve(RSNNSpec(recipe="default", hidden=0), windows), windows)
    >>> alone.recipe, alone.hidden, "readout_stretch_ms" in alone.model_dump(mode="json", exclude_none=True)
    ('default', 0, False)
    """
    table = spec.model_dump(mode="json", exclude_none=True)
    known = leaves(table)
    chosen = {choice.key: choice.value for choice in recipe.choices(seen, {"hidden": spec.hidden})}
    own = {key for key, value in chosen.items() if known.get(key) == value}
    if not own >= (TAUGHT if spec.hidden else FITTED):
        return spec
    given = override({}, {key: value for key, value in known.items() if key not in own | {"model"}})
    return build(RSNNSpec, {**given, "recipe": "default"}, source="the network of the run")
