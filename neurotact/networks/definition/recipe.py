"""The default training of a network: rules that depend only on the training windows, never on the data set.

Time constants depend on the window, and learning rates on the weights; the rates fall to 0. Initial weights are scaled
on the spikes, and the readout adds up hidden spikes. `resolve` writes the choices into the spec, where they can be
read, changed and saved; given keys stay.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from neurotact import effects
from neurotact import spec as specs
from neurotact.errors import InputError
from neurotact.networks.definition import clock
from neurotact.networks.definition.specs import (
    BEST_MEMBERS,
    BUILT_IN,
    COMMON,
    MOST_HIDDEN,
    MOST_STRETCHES,
    OF_NUMBERS,
    RSNNSpec,
    TrainingSpec,
)
from neurotact.networks.definition.specs import void_keys as of_network

if TYPE_CHECKING:  # rules need no torch
    from torch import Tensor

    from neurotact.networks.definition.rsnn import RSNN

BATCH, EPOCHS, LEAST_STEPS, MOST_STEPS = 32, 40, 3000, 10_000
LEARNED = 0.01
"""Mean loss at which windows that are all right teach nothing more: their class has 99 % of the probability."""
QUICK = 3
"""How many times fewer epochs and steps `effort = "quick"` trains."""
LONGEST_STEPS_MS, STEPS, FEWEST_BINS = (5.0, 20.0), 100, 30
"""Of the network's clock: bounds of its longest step, which is a hundredth of the window; fewest steps of a window."""
MERGED = 0.005
"""Share of the spikes that may be close enough for the network's clock to merge: a rare pair does not decide it."""
HIDDEN, STRETCHES, FITTED_STRETCHES = 50, 4, 32
"""Hidden neurons; stretches of the readout, behind them and without them, where they are fitted with a penalty."""
NUMBER_STRETCHES = 16
"""Stretches behind hidden neurons that tell numbers, however few spikes are: on gratings a score of 0.83, not 0.72."""
RECURRENT_STEPS, RECURRENT_MS = 300, 1500.0
"""Where recurrence is tried: the most steps of the network, and the longest window."""
TAU_SHARE = 20
"""Time constants of neurons in a window."""
FEW, ENOUGH = 4.0, 6.0
"""Spikes per afferent and window: up to the first they are few, from the second on enough; between them rules fade."""


class Seen(NamedTuple):
    """The properties of training windows that the rules use.

    A thousandth of the spikes changes none of them much.

    windows, steps, sampling_rate_Hz: number of training windows, their length in steps, and steps per second.
    spikes: mean number per afferent and window. apart: the most steps such that at most `MERGED` of the spikes are
    fewer steps after another of their afferent. n_spikes: number of all spikes. merging: how many spikes bins of 1, 2,
    ... steps merge.
    """

    windows: int
    steps: int
    sampling_rate_Hz: float
    spikes: float
    apart: int = 1
    n_spikes: int = 0
    merging: tuple[int, ...] = ()

    @classmethod
    def of(cls, training: Tensor, sampling_rate_Hz: float) -> Seen:
        """Of the spikes of training windows, `(window, time, afferent)`.

        >>> import torch
        >>> Seen.of(torch.ones(4, 10, 3), 1000.0)
        Seen(windows=4, steps=10, sampling_rate_Hz=1000.0, spikes=10.0, apart=1, n_spikes=120, merging=(0, 60, 72, 84, 96))
        """  # noqa: E501
        n_windows, n_steps, n_afferents = training.shape
        # whole numbers a part at a time: torch adds up bytes as a copy that is eight times as large
        parts = [training] if training.is_floating_point() else training.split(clock.AT_ONCE)
        spikes = sum(float(part.sum()) for part in parts) / max(1, n_windows * n_afferents)
        n_spikes = int(training.count_nonzero())
        close = clock.close(training, math.ceil(_longest_step_ms(n_steps, sampling_rate_Hz) * 1e-3 * sampling_rate_Hz))
        apart = sum(n <= MERGED * n_spikes for n in close.following)
        return cls(n_windows, n_steps, sampling_rate_Hz, spikes, apart, n_spikes, close.merged)

    @property
    def steps_per_bin(self) -> int:
        """Steps of the encoder's clock in one of the network's.

        >>> Seen(900, 1000, 1000.0, 50.0, apart=6).steps_per_bin, Seen(900, 150, 1000.0, 50.0, apart=6).steps_per_bin
        (6, 5)
        """
        longest = int(self.limit_ms * 1e-3 * self.sampling_rate_Hz)
        least = math.ceil(self.few * self.steps / RECURRENT_STEPS) if self.must_remember else 1
        return max(1, min(max(min(self.apart, longest), least), self.steps // FEWEST_BINS))

    @property
    def limit_ms(self) -> float:
        """The longest step of the network's clock, where the spikes are far enough apart for it."""
        least_ms, _ = LONGEST_STEPS_MS
        longest_ms = _longest_step_ms(self.steps, self.sampling_rate_Hz)
        return longest_ms - self.few * (longest_ms - least_ms) if self.must_remember else longest_ms

    @property
    def few(self) -> float:
        """How few the spikes are: 1 up to `FEW` per afferent and window, 0 from `ENOUGH` on, and between them a part.

        >>> [Seen(900, 1300, 1000.0, spikes).few for spikes in (2.0, 4.5, 9.0)]
        [1.0, 0.75, 0.0]
        """
        return max(0.0, min(1.0, (ENOUGH - self.spikes) / (ENOUGH - FEW)))

    @property
    def must_remember(self) -> bool:
        """Whether spikes are so few, and the window so short, that a network may have to remember their order.

        >>> Seen(900, 1300, 1000.0, 2.0).must_remember, Seen(900, 4000, 1000.0, 2.0).must_remember
        (True, False)
        """
        return self.few > 0 and self.steps <= RECURRENT_MS * 1e-3 * self.sampling_rate_Hz


def _longest_step_ms(steps: int, sampling_rate_Hz: float) -> float:
    """The longest step of the network's clock in windows of so many steps of the encoder: a hundredth, 5 to 20 ms.

    >>> [_longest_step_ms(steps, 1000.0) for steps in (300, 1000, 4000)]
    [5.0, 10.0, 20.0]
    """
    least, most = LONGEST_STEPS_MS
    return max(least, min(most, 1e3 * steps / sampling_rate_Hz / STEPS))


class _Choice(NamedTuple):
    """A key of a network's spec, its value, and the rule in a few words."""

    key: str
    value: Any
    why: str


class _Chosen:
    """The choices, in which each rule reads what was taken before: a given key in place of the one that is chosen."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.given, self.made = specs.leaves(given), list[_Choice]()

    @property
    def has_layer(self) -> bool:
        """Whether the network has hidden neurons."""
        return self.given.get("hidden") != 0

    @property
    def of_numbers(self) -> bool:
        """Whether the network tells numbers."""
        return self.given.get("training.loss") in OF_NUMBERS

    def take(self, key: str, value: Any, why: str) -> Any:
        """Add a choice. The value of its key, which is the given one if there is one."""
        self.made.append(_Choice(key, value, why))
        return self.given.get(key, value)


def choices(seen: Seen, given: Mapping[str, Any] | None = None) -> list[_Choice]:
    """The choices of the default recipe for training windows.

    given: keys of the network that are given: the rules of others read them.

    >>> {choice.key: choice.value for choice in choices(Seen(900, 1000, 1000.0, 50.0))}["tau_mem_ms"]
    50.0
    """
    chosen = _Chosen(given or {})
    _choose_size(chosen)
    per_bin = _choose_model(chosen, seen)
    bins = math.ceil(seen.steps / per_bin)
    _choose_readout(chosen, seen, bins, per_bin)
    if not chosen.has_layer:  # nor neurons, nor a training by gradients
        return chosen.made
    step_ms = 1e3 / seen.sampling_rate_Hz
    tau_ms = _short(max(seen.steps * step_ms / TAU_SHARE, per_bin * step_ms))
    for key in ("tau_mem_ms", "tau_syn_ms"):
        chosen.take(key, tau_ms, "a twentieth of the window, at least one step")
    chosen.take("input_deviation", 1.0, "deviation of free membranes on the training windows, in thresholds")
    _choose_length(chosen, seen)
    _choose_training(chosen, seen)
    return chosen.made


def _choose_size(chosen: _Chosen) -> None:
    """Choose the hidden neurons, and whether smaller networks are tried: where no key of a hidden layer is given."""
    given = chosen.given
    of_layer = {key for key in effects.voids(hidden=0) if not key.startswith("training.")}
    if "hidden" in given or given.get("model", "auto") not in BUILT_IN:
        return
    chosen.take("hidden", HIDDEN, "neurons, where a hidden layer stays")
    adds_up = given.get("readout", "integrator") == "integrator" and given.get("readout_tau_ms") is None
    if adds_up and not of_layer & given.keys():
        chosen.take("direct", "auto", "the smallest network that no larger one clearly beats on validation windows")


def _choose_model(chosen: _Chosen, seen: Seen) -> int:
    """Choose recurrence and the clock; the encoder's steps in one of the network's."""
    rate_Hz, given = seen.sampling_rate_Hz, chosen.given
    per_bin = clock.steps_per_bin(given["step_ms"], rate_Hz) if "step_ms" in given else seen.steps_per_bin
    if not chosen.has_layer:
        chosen.take("model", "snn", "no recurrence without hidden neurons")
        chosen.take("step_ms", _exact(seen.steps_per_bin, rate_Hz), _why_step(seen))
        return per_bin
    model = chosen.take(
        "model",
        "auto" if seen.must_remember else "snn",
        f"recurrent where validation gains, for fewer than {ENOUGH:g} spikes per afferent and window, of at most "
        f"{RECURRENT_MS:g} ms",
    )
    chosen.take("step_ms", _exact(seen.steps_per_bin, rate_Hz), _why_step(seen))
    steeper = {"snn": 0.0, "rsnn": 1.0}.get(model, seen.few)
    chosen.take("surrogate_scale", _short(10.0 + 10.0 * steeper), "steeper if recurrence multiplies gradients")
    return per_bin


def _why_step(seen: Seen) -> str:
    """The rule of the clock in a few words."""
    step_ms, limit_ms = 1e3 / seen.sampling_rate_Hz, seen.limit_ms
    least_ms, most_ms = LONGEST_STEPS_MS
    if seen.steps_per_bin * step_ms > limit_ms * (1 + clock.NEARLY):
        if seen.steps_per_bin == 1:
            return "a step of the encoder's clock, the shortest that there is"
        return f"at most {RECURRENT_STEPS} steps, over which recurrence may have to remember the order of few spikes"
    few, many = "the order of few spikes may count", f"a hundredth of the window, {least_ms:g} to {most_ms:g} ms"
    return (
        f"at most {_short(limit_ms):g} ms ({few if seen.must_remember else many}), and at most "
        f"{100 * MERGED:g} % of the spikes less than a step after another of their afferent"
    )


def _choose_readout(chosen: _Chosen, seen: Seen, bins: int, per_bin: int) -> None:
    """Choose the readout, its stretches, and how fast they learn where spikes are hardly enough for them."""
    given = chosen.given
    heard = "hidden spikes" if chosen.has_layer else "spikes"
    readout = chosen.take("readout", "integrator", f"it adds up {heard} and does not spike")
    adds_up = readout == "integrator" and given.get("readout_tau_ms") is None
    most = min(NUMBER_STRETCHES, bins) if chosen.of_numbers else STRETCHES
    fit = most if adds_up and (seen.few < 1 or chosen.of_numbers) and bins >= most else 1
    if not chosen.has_layer:
        fit = fitted_stretches(bins)
    if adds_up and (own_ms := given.get("readout_stretch_ms")) is not None:
        fit = max(1, min(MOST_STRETCHES, math.ceil(_short(1e3 * seen.steps / seen.sampling_rate_Hz / own_ms))))
    stretches = chosen.take(
        "readout_stretches",
        fit,
        f"weights differ between {most} stretches of the window"
        + ("" if chosen.of_numbers else ", unless afferents send too few spikes")
        if chosen.has_layer
        else f"weights differ between at most {FITTED_STRETCHES} stretches of the window",
    )
    if stretches == 1:
        return
    stretch_ms = _exact(math.ceil(bins / stretches) * per_bin, seen.sampling_rate_Hz)
    chosen.take("readout_stretch_ms", stretch_ms, "a stretch of equal length")
    is_free = not chosen.of_numbers and not {"readout_stretches", "readout_stretch_ms"} & given.keys()
    if 0 < seen.few < 1 and chosen.has_layer and is_free:
        rate = _short((1 - seen.few) * TrainingSpec.model_fields["stretch_rate"].default)
        chosen.take("training.stretch_rate", rate, "of stretches, for which spikes are hardly enough")


def fitted_stretches(bins: int) -> int:
    """Stretches of equal length of a network without a hidden layer, in a window of so many steps of its clock.

    >>> fitted_stretches(1000), fitted_stretches(20)
    (32, 20)
    """
    return math.ceil(bins / math.ceil(bins / FITTED_STRETCHES))


def without_layer(network: RSNN, n_steps: int) -> RSNNSpec:
    """The network without a hidden layer for windows of so many steps of the encoder, on the clock of another one."""
    per_bin = network.steps_per_bin
    stretches = fitted_stretches(bins := math.ceil(n_steps / per_bin))
    stretch_ms = _exact(math.ceil(bins / stretches) * per_bin, network.sampling_rate_Hz)
    return network.spec.without_layer(stretches, stretch_ms)


def _choose_length(chosen: _Chosen, seen: Seen) -> None:
    """Choose how long training is, and how many networks are trained."""
    effort = chosen.given.get("effort", "default")
    fewer = QUICK if effort == "quick" else 1
    least_epochs, least_steps = math.ceil(EPOCHS / fewer), LEAST_STEPS // fewer
    most_epochs = max(EPOCHS, chosen.given.get("training.epochs", 0))
    batch = chosen.take(
        "training.batch",
        max(BATCH, math.ceil(seen.windows * most_epochs / MOST_STEPS)),
        f"windows per step: {BATCH}, or more for at most {MOST_STEPS} steps",
    )
    quick = f"; effort = 'quick': {QUICK} times fewer than by default" if fewer > 1 else ""
    epochs = chosen.take(
        "training.epochs",
        max(least_epochs, math.ceil(least_steps / max(1, math.ceil(seen.windows / batch)))),
        f"{least_epochs}, or more for at least {least_steps} steps{quick}",
    )
    chosen.take("training.patience", epochs, "all epochs run, since the rates fall to 0")
    if effort == "best":
        chosen.take(
            "training.members", BEST_MEMBERS, f"networks that are trained and joined; effort = 'best': {BEST_MEMBERS}"
        )


def _choose_training(chosen: _Chosen, seen: Seen) -> None:
    """Choose how training goes on."""
    few, window_ms = seen.few, 1e3 * seen.steps / seen.sampling_rate_Hz
    left_out = 0.0 if chosen.of_numbers else 0.2 * few  # without some neurons, a value is another
    scarce = f"against overfitting, if an afferent sends fewer than {FEW:g} to {ENOUGH:g} spikes per window"
    for key, value, why in (
        ("target_loss", LEARNED, "unless every window is right by far before: nothing is left to learn"),
        ("relative_learning_rate", 0.05, "in units of each matrix's standard deviation"),
        ("schedule", "cosine", "the rates fall to 0"),
        ("keep", "both", "of the best epoch on training and validation windows"),
        ("rate_penalty", 0.0, "none"),
        ("input_dropout", _short(0.1 * few), f"share of input spikes left out; {scarce}"),
        ("input_jitter_ms", _short(few * window_ms / 130), f"window / 130; {scarce}"),
        ("readout_dropout", _short(left_out), f"share of hidden neurons left out; {scarce}; of numbers none"),
    ):
        chosen.take(f"training.{key}", value, why)


def space(spec: RSNNSpec, seen: Seen) -> dict[str, dict[str, Any]]:
    """A search space around the choices of the recipe: for each key, the chosen value and others beside it.

    spec: gives the size, around which others are tried. Keys that it gives are not searched, but for `hidden`.
    Raises InputError without a hidden layer.

    >>> space(RSNNSpec(recipe="default", hidden=50), Seen(900, 1000, 1000.0, 50.0))["hidden"]
    {'_type': 'choice', '_value': [20, 30, 50, 80]}
    """
    chosen, given = resolve(spec, seen), spec.model_dump(mode="json")
    if chosen.own is None and not chosen.hidden:
        raise InputError("hidden: 0 leaves nothing to search: training fits the weights and their penalty; train it")
    step_ms, most = 1e3 / seen.sampling_rate_Hz, MOST_HIDDEN // chosen.n_members
    own = chosen if chosen.own is None else chosen.own

    def around(key: str, factors: Sequence[float], least: float = 0.0) -> list[float]:
        value = getattr(own, key, None)
        return _around(value, factors, least) if isinstance(value, float) else []

    values: dict[str, list[Any]] = {
        "hidden": sorted({min(most, max(1, round(share * chosen.hidden))) for share in (0.4, 0.6, 1.0, 1.6)}),
        "tau_mem_ms": around("tau_mem_ms", (0.25, 0.5, 1.0, 2.0, 4.0), step_ms),
        "tau_syn_ms": around("tau_syn_ms", (0.25, 0.5, 1.0, 2.0, 4.0), step_ms),
        "input_deviation": [0.5, 1.0, 2.0],
        "surrogate_scale": around("surrogate_scale", (0.5, 1.0, 2.0)),
        "training.relative_learning_rate": [0.02, 0.05, 0.1],
        "training.input_dropout": [0.0, 0.1, 0.2],
        "training.readout_dropout": [0.0, 0.2, 0.4],
    }
    if chosen.recurrent:  # or may be: the search decides, by which trials differ
        values |= {"model": ["rsnn", "snn"], "training.rate_penalty": [0.0, 0.001, 0.01]}
    known = {*given, *(f"training.{key}" for key in given.get("training", {}))} - {"hidden"}
    if chosen.own is not None:  # of its sizes only their owner knows others
        known |= {"hidden", *(key for key in values if not has_key(chosen, key))}
    return {key: {"_type": "choice", "_value": value} for key, value in values.items() if key not in known}


def resolve(spec: RSNNSpec, seen: Seen) -> RSNNSpec:
    """The spec with the choices of its recipe for training windows; given keys stay.

    A spec without a recipe is returned unchanged.

    >>> asked = RSNNSpec(recipe="default", tau_syn_ms=5.0)
    >>> chosen = resolve(asked, Seen(900, 1000, 1000.0, 50.0))
    >>> chosen.tau_mem_ms, chosen.tau_syn_ms, chosen.readout, chosen.recipe
    (50.0, 5.0, 'integrator', None)
    """
    if spec.recipe is None:
        return spec
    given = spec.model_dump(mode="json", exclude={"recipe"})
    without_effort = {key: value for key, value in given.items() if key != "effort"}
    chosen = {choice.key: choice.value for choice in choices(seen, given) if has_key(spec, choice.key)}
    training = without_effort.pop("training", {})
    table = specs.override(without_effort, {key: value for key, value in chosen.items() if key not in given})
    table["training"] = {**table.get("training", {}), **training}
    return specs.build(RSNNSpec, table, source=f"recipe = '{spec.recipe}'")


def has_key(spec: RSNNSpec, key: str) -> bool:
    """Whether a network has a key that the recipe chooses; one with keys of its own has those and a few of all.

    >>> has_key(RSNNSpec(), "readout_stretches"), has_key(RSNNSpec(hidden=[4, 2]), "readout_stretches")
    (True, False)
    """
    if spec.own is None:
        return True
    return key not in of_network(spec) and key.partition(".")[0] in (*COMMON, *type(spec.own).model_fields)


def first_of(spec: RSNNSpec, seen: Seen) -> RSNNSpec:
    """The network with which a search of `space` begins: the choices of the recipe, one model of `auto`.

    >>> first_of(RSNNSpec(recipe="default"), Seen(900, 260, 200.0, 2.0)).model
    'rsnn'
    """
    chosen = resolve(spec, seen)
    chosen = chosen.model_copy(update={"direct": False}) if chosen.direct == "auto" else chosen
    return chosen.of_model("rsnn") if chosen.model == "auto" else chosen


def chosen_for(spec: RSNNSpec, training: Tensor, sampling_rate_Hz: float) -> RSNNSpec:
    """The spec with the choices of its recipe for the spikes of training windows, `(window, time, afferent)`.

    Without a recipe the windows are not looked at.

    >>> import torch
    >>> chosen_for(RSNNSpec(recipe="default"), torch.zeros(4, 1000, 2, dtype=torch.uint8), 1000.0).step_ms
    5.0
    """
    return spec if spec.recipe is None else resolve(spec, Seen.of(training, sampling_rate_Hz))


def void_keys(spec: RSNNSpec) -> dict[str, str]:
    """The keys of a network that have no effect, and why; with a recipe those that have none in windows of any length.

    >>> {*void_keys(RSNNSpec(recipe="default"))} - {*void_keys(RSNNSpec(recipe="default", model="rsnn"))}
    set()
    >>> "forward_weight_scale" in void_keys(RSNNSpec(recipe="default", model="snn"))
    True
    """
    rate_Hz = _suited_Hz(spec)
    lengths = STRETCHES, 1 + int(RECURRENT_MS * 1e-3 * rate_Hz)
    kinds = [Seen(1, steps, rate_Hz, n) for steps in lengths for n in (FEW, ENOUGH)]
    first, *others = (of_network(resolve(spec, seen)) for seen in kinds)
    return {key: why for key, why in first.items() if all(key in other for other in others)}


def training_of(spec: RSNNSpec) -> TrainingSpec:
    """The training keys that do not depend on the windows: `keep`, `schedule`.

    >>> training_of(RSNNSpec(recipe="default")).keep, training_of(RSNNSpec()).keep
    ('both', 'loss')
    """
    return resolve(spec, Seen(1, 1, _suited_Hz(spec), 1.0)).training


def _suited_Hz(spec: RSNNSpec) -> float:  # noqa: N802
    """A clock of the encoder on which a given step of the network is whole, where the encoder's is not known."""
    return 1e3 / spec.own_step_ms if spec.own_step_ms else 1000.0


def described(spec: RSNNSpec, seen: Seen, kept: RSNNSpec | None = None) -> Iterator[str]:
    """The choices of a spec's recipe, one line per key, without given keys; then what the clock merges, `joined_cost`.

    kept: the spec of the network that was kept; keys without effect in it are left out.
    What is more than the clock of a recipe merges is not among them: the network warns of it where it begins.
    """
    if spec.recipe is not None:
        given = spec.model_dump(mode="json")
        known, void = specs.leaves(given), {} if kept is None else of_network(kept)
        own = {} if kept is None else specs.leaves(kept.model_dump(mode="json"))
        for choice in choices(seen, given):
            if choice.key not in known and has_key(spec, choice.key) and choice.key not in void:
                value = own.get(choice.key, choice.value)
                why = choice.why if value == choice.value else "that of the network which validation windows chose"
                yield f"{choice.key} = {value} ({why})"
    per_bin = clock.steps_per_bin(resolve(spec, seen).step_ms, seen.sampling_rate_Hz)
    n_merged = seen.merging[per_bin - 1] if per_bin <= len(seen.merging) else 0
    if 0 < n_merged <= MERGED * seen.n_spikes:
        yield clock.in_words(n_merged, seen.n_spikes)
    yield from joined_cost(resolve(spec, seen))


def joined_cost(spec: RSNNSpec) -> Iterator[str]:
    """What it costs that several networks are joined, in one line; nothing where one is trained.

    >>> print(*joined_cost(RSNNSpec(hidden=4, readout="integrator", training=TrainingSpec(members=2))))
    2 networks of 4 neurons are joined into one of 8: up to 2 times the training time, and 2 times the SOPs and energy
    """
    if (n := spec.n_members) > 1:
        yield (
            f"{n} networks of {spec.hidden} neurons are joined into one of {spec.joined_hidden}: up to {n} times the "
            f"training time, and {n} times the SOPs and energy"
        )


def _around(value: float, factors: Sequence[float], least: float = 0.0) -> list[float]:
    """Multiples of a chosen value, none below `least`, each once."""
    return sorted({_short(max(factor * value, least)) for factor in factors})


def _exact(steps: int, sampling_rate_Hz: float) -> float:
    """The duration of so many steps in ms, exact enough to be a whole number of them."""
    return float(f"{steps * 1e3 / sampling_rate_Hz:.9g}")


def _short(value: float) -> float:
    """A number rounded to four digits."""
    return float(f"{value:.4g}")
