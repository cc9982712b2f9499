"""One network, trained and run with one way to save: fewer spikes, weights, neurons, taxels, or less time.

Everything that a `Setting` does not name is the same for all ways: recordings, split, calibrated gains, seeds, the
network's recipe. All choices (gains, taxels, weights, patience) use only training and validation windows.
"""

import warnings
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from neurotact_parts.studies.comparison import by_list
from neurotact_parts.studies.comparison.dead_time import with_dead_time
from neurotact_parts.studies.comparison.needed_afferents import Pair, encoder_without
from pydantic import Field, model_validator

from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.data.windows import WindowSpec
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.encoding import encode_recordings
from neurotact.metrics.flops import Cost
from neurotact.metrics.prices import ARITHMETIC_45NM, PriceList
from neurotact.networks.definition import clock, recipe
from neurotact.networks.definition.rsnn import RSNN, rsnn_of
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit import truncated
from neurotact.networks.exit.patience import ExitChoice
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import sparsity, tasks, trainer
from neurotact.networks.training.epochs import Training, train
from neurotact.networks.training.tasks import Sides, Task
from neurotact.networks.use import measuring
from neurotact.networks.use.ledger import Afferents, network_cost
from neurotact.spec import Spec, build

Share = Annotated[float, Field(gt=0, le=1)]
Period = Annotated[float, Field(ge=0)]
TRAINED_ON = 0.25
"""Share of the epochs for the further training of a pruned network."""
MERGES = ".* lie in one step of the network"
"""The warning that a clock merges spikes, by which a slower clock saves."""
AFTERWARDS = ("prune", "train_on", "exit_tolerance")
"""Keys that do not change the first training."""


class Setting(Spec):
    """One way to save and its amount; by default nothing is saved."""

    t_ref_ms: tuple[Period, Period] | None = None
    """Refractory periods of RA-I and SA-I; the first one is the dead time of events."""
    encoder_ms: float | None = Field(default=None, gt=0)
    """A step of the encoder's clock, on which membranes are computed; by default that of the set."""
    smoothing: bool = True
    """Whether the moving average of the conditioning, which runs at the rate of the sensor, stays."""
    step_ms: float | None = Field(default=None, gt=0)
    """A step of the network's clock; by default the recipe chooses it."""
    longest_steps: bool = False
    """The longest steps of the network's clock that merge no spikes of training windows, also if the recipe allows no
    such steps."""
    rate_penalty: float | None = Field(default=None, ge=0)
    """`training.rate_penalty`, on the spikes of a hidden neuron in a window."""
    adaptation: float = Field(default=0.0, ge=0)
    """`threshold_adaptation`: the rise of a hidden neuron's threshold at each of its spikes."""
    time_constants: float = Field(default=1.0, gt=0)
    """Factor of the network's time constants."""
    afferents: Share = 1.0
    """Share of the afferents, by taxel and population: those that the bench ranks first. Of recordings alone."""
    taxels: Share = 1.0
    """Share of the taxels: those with the largest variance of spikes per training window."""
    window: Share = 1.0
    """Share of the window's length, from its start."""
    hidden: float = Field(default=1.0, ge=0, le=1)
    """Share of the hidden neurons; 0: no hidden layer."""
    direct: bool = False
    """Whether the readout hears the afferents, too, past the hidden layer."""
    recurrence: bool = True
    sparsity: float = Field(default=0.0, ge=0, lt=1)
    """`training.sparsity`: the share of the weights that are pruned little by little in training."""
    prune: float | None = Field(default=None, gt=0, lt=1)
    """Share of the weights of each matrix, the smallest ones, that are set to 0 after training."""
    train_on: bool = False
    """Train the remaining weights for a quarter of the epochs."""
    exit_tolerance: float | None = Field(default=None, ge=0, lt=1)
    """Early exit, with the least patience that loses at most this validation accuracy; whole windows where validation
    trials that did not choose it do not bound the loss so far (`patience.ExitChoice.used`)."""

    @model_validator(mode="after")
    def _trains_on_what_is_pruned(self) -> "Setting":
        if self.train_on and self.prune is None:
            raise ValueError("train_on trains a pruned network further; give prune, too")
        return self

    @model_validator(mode="after")
    def _has_one_clock(self) -> "Setting":
        if self.longest_steps and self.step_ms is not None:
            raise ValueError("longest_steps: the clock has steps of step_ms; leave one of them out")
        return self

    def on(self, step_ms: float, *, is_events: bool) -> "Setting":
        """The setting on a set's clock: times are whole steps of it, and those that change nothing are left out.

        Afferents have a refractory period of at least a step, and events have one dead time.

        >>> Setting(t_ref_ms=(1, 12)).on(5.0, is_events=False).t_ref_ms
        (5.0, 10.0)
        >>> Setting(t_ref_ms=(1, 5), step_ms=5).on(5.0, is_events=False) == Setting()
        True
        """
        t_ref_ms, own_ms = self.t_ref_ms, self.step_ms
        if t_ref_ms is not None:
            least = 0 if is_events else 1
            ra1, sa1 = (max(least, round(period / step_ms)) for period in t_ref_ms)
            sa1 = ra1 if is_events else sa1
            changes_nothing = ra1 == sa1 == least and not self.longest_steps
            t_ref_ms = None if changes_nothing else (ra1 * step_ms, sa1 * step_ms)
        if own_ms is not None:
            own_ms = None if (n := round(own_ms / step_ms)) <= 1 else n * step_ms
        return self.model_copy(update={"t_ref_ms": t_ref_ms, "step_ms": own_ms})

    def first_training(self) -> str:
        """The keys that decide the first training, as JSON; settings with the same text share one training."""
        return self.model_dump_json(exclude={*AFTERWARDS})


class Bench(NamedTuple):
    """The inputs that all ways share.

    touches: recordings, to be encoded by `encoder`, or spikes if it is None; window: of the set; network: its spec;
    task: what else is asked of training, but for its window and its split. ranking: the afferents by taxel and
    population, those first that are needed most.
    """

    touches: Recordings | SpikeTrains
    encoder: AfferentSpec | None
    split: Split
    window: WindowSpec
    network: RSNNSpec
    seeds: tuple[int, int]
    task: Task = Task()
    ranking: tuple[Pair, ...] = ()


class Cut(NamedTuple):
    """The windows of each side under a setting, and the spikes of the remaining taxels, from which they are cut."""

    trains: SpikeTrains
    sides: Sides


class Fitted(NamedTuple):
    """A trained network, the spikes and windows that it was trained on, and the random generator of their order.

    training: its log. was_open: whether training decided if it is recurrent.
    """

    network: RSNN
    trains: SpikeTrains
    sides: Sides
    order: torch.Generator
    training: Training
    was_open: bool = False


def measured(
    bench: Bench, setting: Setting, known: dict[str, Fitted], prices: PriceList = ARITHMETIC_45NM
) -> dict[str, Any]:
    """A row of results: accuracies, SOPs, energy and signal of a decision with one setting.

    known: as of `trained`.
    """
    fitted = trained(bench, setting, known)
    rule = FULL_WINDOW if setting.exit_tolerance is None else exit_of(bench, fitted, setting.exit_tolerance).used
    return row_of(fitted, rule, prices=prices)


def exit_of(bench: Bench, fitted: Fitted, tolerance: float) -> ExitChoice:
    """The early exit of a network, as the task asks for it to be chosen."""
    sides, is_steady = fitted.sides, bench.task.exit_choice == "steady"
    return trainer.exit_of(fitted.network, sides.validation, tolerance, sides.train if is_steady else None)


def trained(bench: Bench, setting: Setting, known: dict[str, Fitted]) -> Fitted:
    """The network of a setting, pruned where it says so.

    known: first trainings by their key; a new one is added. With that of `Setting()`, which saves nothing, among them,
    whether a network is recurrent is decided there.
    """
    name = setting.first_training()
    if name not in known:
        own = cut(bench, setting)
        seen = recipe.Seen.of(own.sides.train.spikes, own.trains.sampling_rate_Hz)
        # A part of the window may lack the closest spikes; the clock stays that of the whole one.
        whole = own if setting.window == 1 else cut(bench, setting.model_copy(update={"window": 1.0}))
        whole_steps = round(bench.window.length_ms * 1e-3 * seen.sampling_rate_Hz)
        of_whole = seen if whole is own else recipe.Seen.of(whole.sides.train.spikes, seen.sampling_rate_Hz)
        # The longest steps that merge none may be longer than those that a recipe looks at.
        longest = clock.apart(whole.sides.train.spikes) if setting.longest_steps else 1
        seen = seen._replace(apart=max(of_whole.apart, longest))
        spec, plain = changed(bench.network, setting, seen, whole_steps), known.get(Setting().first_training())
        if spec.model == "auto" and plain is not None:  # a way changes nothing else
            spec = spec.of_model("rsnn" if plain.network.spec.recurrent else "snn")
        with warnings.catch_warnings():
            if setting.step_ms is not None:
                warnings.filterwarnings("ignore", MERGES)
            known[name] = fit(own, spec, bench.seeds)._replace(was_open=spec.model == "auto")
    fitted = known[name]
    return fitted if setting.prune is None else _pruned(fitted, setting)


def row_of(fitted: Fitted, rule: ExitRule = FULL_WINDOW, *, prices: PriceList = ARITHMETIC_45NM) -> dict[str, Any]:
    """Accuracies, SOPs, energy and what is counted of a decision."""
    network, (train, validation, test) = fitted.network, fitted.sides
    inferred = network.infer(test.spikes, rule)
    row = measuring.means(inferred, network, test, {})
    spikes = {name: float(getattr(inferred, name).double().mean()) for name in ("input_spikes", "hidden_spikes")}
    touched = measuring.touched(truncated.simulate_windows(network, test), network.steps_per_bin, inferred.steps)
    spent, by_events = (
        _cost(fitted, {**row, **spikes, **touched, **network.synapses}, inferred.steps, event_driven=event_driven)
        for event_driven in (False, True)
    )
    return {
        "accuracy_validation": measuring.accuracy_of(network.infer(validation.spikes, rule), validation),
        **row,
        **(by_events if prices.event_driven else spent).columns("energy_estimate_nJ", "signal_ms", prices=prices),
        **spikes,
        **touched,
        **by_list.counted(spent, by_events),
        "network_step_ms": network.spec.own_step_ms or 1e3 / network.sampling_rate_Hz,
        "n_train": len(train.labels),
        "n_validation": len(validation.labels),
        "n_test": len(test.labels),
    }


def cut(bench: Bench, setting: Setting) -> Cut:
    """The windows of each side under a setting's refractory periods, taxels and length."""
    trains = _encoded(bench, setting)
    step_ms = 1e3 / trains.sampling_rate_Hz
    hop_ms = bench.window.hop_ms or bench.window.length_ms
    length_ms = max(1, round(setting.window * bench.window.length_ms / step_ms)) * step_ms
    window = bench.window.model_copy(update={"length_ms": length_ms, "hop_ms": hop_ms})
    if setting.taxels < 1:
        training, _ = tasks.examples_of(trains, bench.split.train, bench.task, window)
        trains = trains.with_afferents(_varying(trains, training.spikes, setting.taxels))
    task = bench.task.model_copy(update={"window": window})
    return Cut(trains, tasks.sides_of(trains, task, bench.split))


def fit(own: Cut, spec: RSNNSpec, seeds: tuple[int, int]) -> Fitted:
    """A network trained on some windows; seeds: of its weights and of their order."""
    network, training = trainer.new_trained(own.trains, spec, seeds, own.sides.train, own.sides.validation)
    return Fitted(rsnn_of("c-integer", network), *own, torch.Generator().manual_seed(seeds[1]), training)


def changed(spec: RSNNSpec, setting: Setting, seen: recipe.Seen, whole_steps: int) -> RSNNSpec:
    """The network's spec with the choices of its recipe for the training windows, and the changes of the setting.

    whole_steps: steps of the full window. They decide the network's clock and whether it is recurrent, so a setting
    with a shorter window changes nothing else.

    >>> spec = changed(RSNNSpec(recipe="default", hidden=50), Setting(hidden=0.5, time_constants=2), recipe.Seen(
    ...     900, 200, 1000.0, 50.0), 800)
    >>> spec.hidden, spec.tau_mem_ms, spec.tau_syn_ms, spec.model
    (25, 20.0, 20.0, 'snn')
    """
    own_ms = seen.apart * 1e3 / seen.sampling_rate_Hz if setting.longest_steps else setting.step_ms
    if own_ms is not None:
        spec = spec.model_copy(update={"step_ms": float(f"{own_ms:.9g}")})
    whole = recipe.resolve(spec, seen._replace(steps=whole_steps))
    spec = recipe.resolve(spec.model_copy(update={"step_ms": whole.step_ms}), seen)
    least_ms = spec.own_step_ms or 1e3 / seen.sampling_rate_Hz
    update: dict[str, Any] = {
        "hidden": max(min(1, spec.hidden) if setting.hidden else 0, round(setting.hidden * spec.hidden)),
        "tau_mem_ms": max(least_ms, setting.time_constants * spec.tau_mem_ms),
        "tau_syn_ms": max(least_ms, setting.time_constants * spec.tau_syn_ms),
        "model": whole.model if setting.recurrence and setting.hidden else "snn",
        "surrogate_scale": whole.surrogate_scale,
    }
    if setting.adaptation:
        update["threshold_adaptation"] = setting.adaptation
    if setting.direct:
        update["direct"] = True
    table = {**spec.model_dump(mode="json"), **update}
    training = {"rate_penalty": setting.rate_penalty, "sparsity": setting.sparsity or None}
    table["training"] |= {key: value for key, value in training.items() if value is not None}
    return build(RSNNSpec, table, source="a way to save")


def _encoded(bench: Bench, setting: Setting) -> SpikeTrains:
    """The spikes of every trial under the setting's refractory periods."""
    if isinstance(bench.touches, SpikeTrains):
        if setting.t_ref_ms is None:
            return bench.touches
        return with_dead_time(bench.touches, round(setting.t_ref_ms[0] * 1e-3 * bench.touches.sampling_rate_Hz))
    assert bench.encoder is not None
    encoder = bench.encoder
    if setting.t_ref_ms is not None:
        periods = zip(("ra1", "sa1"), setting.t_ref_ms, strict=True)
        update = {part: getattr(encoder, part).model_copy(update={"t_ref_ms": period}) for part, period in periods}
        encoder = encoder.model_copy(update=update)
    if setting.encoder_ms is not None:
        encoder = _conditioned(encoder, resample_Hz=float(f"{1e3 / setting.encoder_ms:.9g}"))
    if setting.afferents < 1:
        encoder = encoder_without(encoder, bench.ranking[: n_kept(len(bench.ranking), setting.afferents)])
    if not setting.smoothing:
        encoder = _conditioned(encoder, ema_cutoff_Hz=None)
    return encode_recordings(bench.touches, encoder)


def _conditioned(encoder: AfferentSpec, **keys: Any) -> AfferentSpec:
    return encoder.model_copy(update={"conditioning": encoder.conditioning.model_copy(update=keys)})


def _varying(trains: SpikeTrains, training: torch.Tensor, share: float) -> list[int]:
    """The afferents of this share of the taxels, those with the largest variance of spikes per training window."""
    taxel_of = taxels_of(trains.afferents)
    taxels = list(dict.fromkeys(taxel_of))
    counts = training.sum(dim=1, dtype=torch.float64)
    spread = [float(counts[:, [own == taxel for own in taxel_of]].sum(dim=1).var(correction=0)) for taxel in taxels]
    best = np.argsort(spread, kind="stable")[::-1][: n_kept(len(taxels), share)]
    selected = {taxels[index] for index in best}
    return [index for index, taxel in enumerate(taxel_of) if taxel in selected]


def taxels_of(afferents: Sequence[str]) -> list[str]:
    """The taxel of each afferent: the part of its name after the population.

    >>> taxels_of(["SA-I left thumb", "RA-I left thumb", "key4"])
    ['left thumb', 'left thumb', 'key4']
    """
    return [name.partition(" ")[2] or name for name in afferents]


def n_kept(n_taxels: int, share: float) -> int:
    """
    >>> n_kept(12, 0.25), n_kept(1, 0.25)
    (3, 1)
    """
    return max(1, round(share * n_taxels))


def _pruned(fitted: Fitted, setting: Setting) -> Fitted:
    """A copy of the network with its smallest weights at 0, and with further training if the setting requests it."""
    assert setting.prune is not None
    before = fitted.network
    spec = before.spec
    if setting.train_on:
        epochs = max(1, round(TRAINED_ON * spec.training.epochs))
        training = spec.training.model_copy(update={"epochs": epochs, "patience": epochs})
        spec = spec.model_copy(update={"training": training})
    network = RSNN(before.n_inputs, before.n_classes, spec, before.sampling_rate_Hz, backend=before.backend)
    network.load_state_dict(before.state_dict())
    sparsity.prune(network, setting.prune)
    training = fitted.training
    if setting.train_on:
        order = torch.Generator().manual_seed(fitted.order.initial_seed() + 1)
        with sparsity.pruned_stay_pruned(network):
            training = train(network, fitted.sides.train, fitted.sides.validation, generator=order)
    return fitted._replace(network=network, training=training)


def _cost(fitted: Fitted, measured: Mapping[str, float], decided: torch.Tensor, *, event_driven: bool) -> Cost:
    """The cost of a decision. decided: the steps until each one, `(window,)`."""
    network, steps = fitted.network, float(decided.double().mean())
    signal_ms = 1e3 * steps / network.sampling_rate_Hz
    sizes = network.n_inputs, network.n_classes
    spent = network_cost(network.spec, *sizes, measured, steps=steps, signal_ms=signal_ms, event_driven=event_driven)
    if not fitted.trains.encoder:
        return spent
    # Counted before bins merge some, and before weights are pruned: the encoder has sent all of them.
    sent = fitted.sides.test.spikes.sum(dim=2, dtype=torch.float64).cumsum(dim=1)
    return spent + Afferents.of(fitted.trains).cost(steps, float(sent.gather(1, decided.cpu()[:, None] - 1).mean()))
