"""The keys of a network spec (`networks/*.toml`)."""

import json
from collections.abc import Collection, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from neurotact import effects, plugins
from neurotact import spec as specs
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.networks.definition import optimisers
from neurotact.neurons import FAST_SIGMOID, Membrane, Reset, SpikeFunction
from neurotact.spec import Spec

with lazily():
    from neurotact.networks.definition import parts
    from neurotact.networks.definition import surrogate as surrogates


Keep = Literal["loss", "accuracy", "both"]
Model = Literal["rsnn", "snn"]
BUILT_IN = ("rsnn", "snn", "auto")
"""Models whose keys are those of `RSNNSpec`; another model is a part with keys of its own."""
COMMON = ("model", "step_ms", "recipe", "effort", "training")
"""Keys of every network."""
LAYERED = "layered"
"""The model of a network whose `hidden` is a list."""
Effort = Literal["quick", "default", "best"]
MOST_HIDDEN = 1024
"""Neurons of the largest hidden layer."""
MOST_MEMBERS = 16
"""The most networks that are joined into one."""
BEST_MEMBERS = 3
"""Networks that `effort = "best"` joins."""
MOST_STRETCHES = 64
"""The most stretches of a window with readout weights of their own."""


OF_NUMBERS = ("squared-error", "absolute-error")
"""Losses of numbers, the usual one first."""


class TrainingSpec(Spec):
    """How a network is trained (texture paper, Sec. III-B; loss and regularisers from the Braille study).

    >>> TrainingSpec(epochs=20, schedule="cosine")
    TrainingSpec(epochs=20, schedule='cosine')
    """

    optimiser: Annotated[str, AfterValidator(optimisers.named)] = "Adam"
    """An optimiser of `torch.optim`, by the name of its class in any case: Adam, Adamax (Kingma and Ba 2015, Sec. 7.1),
    AdamW, SGD and so on, with its own defaults beyond the keys here."""
    betas: tuple[Annotated[float, Field(ge=0, lt=1)], Annotated[float, Field(ge=0, lt=1)]] = (0.9, 0.999)
    """Factors per step of the running means of the gradient and of its square (Adamax: of its largest size), of an
    optimiser that has them."""
    weight_decay: float = Field(default=0.0, ge=0)
    """The optimiser's decay of weights, as it defines it: Adam adds it to the gradient, AdamW shrinks the weights.
    Biases and learned dynamics do not decay."""
    learning_rate: float = Field(default=1e-3, gt=0)
    """Learning rate of the optimiser."""
    batch: int = Field(default=128, ge=1)
    """Windows per training step."""
    epochs: int = Field(default=100, ge=1)
    """The most epochs of a training."""
    patience: int = Field(default=7, ge=1)
    """Epochs without a better one after which training stops."""
    target_loss: float = Field(default=0.0, ge=0)
    """Training stops, too, at an epoch in which all training and validation windows are right and the mean loss of each
    of the two is at most this: nothing is left to learn from them. 0: never."""
    rate_penalty: float = Field(default=0.0015, ge=0)
    """lambda1, on the mean over trials and hidden neurons of the spikes in a window."""
    population_penalty: float = Field(default=0.0, ge=0)
    """lambda2, on the mean over hidden neurons of the squared spike count of a batch."""
    loss: Annotated[str, AfterValidator(partial(plugins.known, "losses"))] = "cross-entropy"
    """What training minimises beside the penalties: `cross-entropy`, `hinge`, or one of another package
    (`docs/plugins.md`)."""
    temperature: float = Field(default=1.0, gt=0)
    """Factor of the readout before the loss: in a cross-entropy of counts of tens, softmax is a hard maximum."""
    stretch_rate: float = Field(default=0.2, gt=0, le=1)
    """Learning rate of the deviations of `readout_stretches`, as a share of the rate of the shared weights."""
    relative_learning_rate: float | None = Field(default=None, gt=0)
    """The optimiser's rate of each weight matrix in units of the standard deviation of its initial weights. It replaces
    `learning_rate`, which then applies only to biases and learned dynamics."""
    schedule: Literal["constant", "cosine"] = "constant"
    """cosine: the rates fall to 0 over all epochs, step by step, along half a cosine; with `sparsity` over those after
    pruning has ended."""

    keep: Keep = "loss"
    """The epoch whose weights are used, and from which patience counts: the one of the lowest validation loss
    (`loss`), the highest validation accuracy (`accuracy`), or the highest mean of training and validation accuracy
    (`both`); among equally accurate epochs, the one of the lowest loss."""
    input_dropout: float = Field(default=0.0, ge=0, lt=1)
    """Share of input spikes that each training step leaves out at random."""
    input_jitter_ms: float = Field(default=0.0, ge=0)
    """Largest random shift of each input spike in time, earlier or later, drawn in each training step."""
    readout_dropout: float = Field(default=0.0, ge=0, lt=1)
    """Share of hidden neurons from which an integrator receives nothing in training. They are drawn for each window, or
    for each training step if the integrator leaks or takes a maximum. A readout that counts receives all."""
    sparsity: float = Field(default=0.0, ge=0, lt=1)
    """Share of the weights of each matrix that are 0 at the end: the smallest ones, ever more of them from a tenth to
    two thirds of the epochs (`networks.training.sparsity`); the others then train on. An epoch before is not kept. A
    weight of 0 is no synapse: it costs no operation."""
    members: int = Field(default=1, ge=1, le=MOST_MEMBERS)
    """Networks that are trained on the same windows from different initial weights, and then joined into one network,
    whose class scores are the means of theirs (`networks.training.ensemble`): a deep ensemble (Lakshminarayanan et
    al. 2017, arXiv 1612.01474). It has as many times the hidden neurons, and costs as many times the training."""

    @property
    def lower_rate(self) -> str:
        """The learning rate that applies, halved, as the key and value that set it.

        >>> TrainingSpec(learning_rate=0.001).lower_rate, TrainingSpec(relative_learning_rate=0.05).lower_rate
        ('training.learning_rate=0.0005', 'training.relative_learning_rate=0.025')
        """
        key = "learning_rate" if self.relative_learning_rate is None else "relative_learning_rate"
        return f"training.{key}={getattr(self, key) / 2:g}"


def _known_model(name: str) -> str:
    return name if name in BUILT_IN else plugins.known("networks", name)


def _of_layers(table: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of a network whose `hidden` is a list, as those of the part `layered`."""
    model = table.get("model")
    if model == "auto":
        raise InputError("model: 'auto' tries recurrence with one hidden layer; set model = 'layered', or one number")
    recurrent = {} if model is None else {"recurrent": model == "rsnn"}
    own, known = RSNNSpec.model_fields, part_of(LAYERED).keys.model_fields
    unused = {k for k, v in table.items() if k in own and k not in (*COMMON, *known) and v == own[k].default}
    return {**recurrent, **{key: value for key, value in table.items() if key not in unused}, "model": LAYERED}


def part_of(model: str) -> "parts.NetworkPart":
    """The part that a model names; InputError if it cannot be used."""
    part = plugins.load("networks", model, parts.NetworkPart)
    if not (isinstance(part.keys, type) and issubclass(part.keys, Spec) and callable(part.module)):
        raise plugins.unfit("networks", model, "has keys that are not a Spec, or no module to call")
    taken = [key for key in part.keys.model_fields if key in COMMON] if part.keys is not RSNNSpec else []
    if taken:
        raise plugins.unfit("networks", model, f"has a key '{taken[0]}', which every network has")
    return part


class RSNNSpec(Spec):
    """A spiking network: recurrent (texture paper, Fig. 1c and Eqs. 4 to 7) or feed-forward.

    With a `recipe`, the keys that are not given are chosen from the training windows (`networks.recipe`); such a spec
    is written with only the given keys.

    >>> RSNNSpec(hidden=20, readout="integrator").recurrent
    True
    """

    folder: ClassVar[str] = "networks"

    model: Annotated[str, AfterValidator(_known_model)] = "rsnn"
    """rsnn: the hidden layer is recurrent; snn: it is not, and the `recurrent_...` keys are ignored. auto: both are
    trained, and recurrence stays if it classifies more validation windows correctly, by more than the standard error;
    a trained network is one of the two. Another name: a network of several layers (`layered`), or of another package
    (`docs/plugins.md`), with keys of its own beside step_ms, recipe and training."""
    hidden: int = Field(default=30, ge=0, le=MOST_HIDDEN)
    """Neurons in the hidden layer. 0: none; the integrator hears the afferents and is fitted by logistic or, of
    numbers, ridge regression. A list, such as [20, 10]: of several layers (`model = "layered"`)."""
    direct: bool | Literal["auto"] = False
    """Whether an integrator also hears the afferents themselves, past the hidden layer. Without one it always does.
    auto: networks are tried from the smallest up: without a hidden layer, with it (`model`), with a path past it. Each
    step stays if it classifies more validation windows correctly, by more than the standard error; a trained network is
    one of them."""
    step_ms: Annotated[float, Field(gt=0)] | Literal["encoder"] | None = None
    """Step of the network's clock, a whole number of steps of the encoder's clock. Input spikes are put into bins of
    this length; several of one afferent in a bin are one. `encoder`, or absent without a recipe: the encoder's step."""
    membrane: Membrane = "eq4"
    """How current enters the membrane: `eq4` b(U[t] + I[t]), `delayed` b U[t] + I[t], `immediate` b U[t] + I[t+1],
    with b = exp(-dt / tau_mem)."""
    reset: Reset = "zero"
    """After a spike: `zero` makes the next membrane potential 0, `subtract` subtracts the threshold from it (with its
    adaptation, if any), `hard` sets U[t] to 0 before the next one is computed."""
    recurrent_delay_steps: int = Field(default=0, ge=0, le=1, strict=True)
    """d of `I[t+1] = alpha I[t] + W x[t] + V s[t-d]`: additional delay of a recurrent spike, in steps."""
    tau_mem_ms: float = Field(default=20.0, gt=0)
    """Time constant of the membranes."""
    tau_syn_ms: float = Field(default=10.0, gt=0)
    """Time constant of the synaptic currents."""
    threshold_adaptation: float = Field(default=0.0, ge=0)
    """k: by how much each spike of a hidden neuron raises its threshold, which is 1 at rest. 0: thresholds are fixed.
    Thresholds of the readout do not adapt."""
    tau_adaptation_ms: float = Field(default=100.0, gt=0)
    """Time constant with which a raised threshold decays."""
    surrogate: Annotated[str, AfterValidator(partial(plugins.known, "surrogates"))] = FAST_SIGMOID
    """The slope of a spike in training: `fast-sigmoid`, `arctan`, or one of another package (`docs/plugins.md`). The
    kernels have the fast sigmoid; with another one the reference in torch runs."""
    surrogate_scale: float = Field(default=10.0, gt=0)
    """lambda of the surrogate."""
    readout_surrogate_scale: float | None = Field(default=None, gt=0)
    """lambda of the readout neurons, if it differs; an integrator does not use it."""
    forward_weight_scale: float = Field(default=1.0, gt=0)
    """g: w ~ N(0, (g / sqrt(fan-in))^2)."""
    recurrent_weight_scale: float = Field(default=0.1, ge=0)
    """r: v ~ N(0, (g r / sqrt(hidden))^2)."""
    recurrent_blocks: int = Field(default=1, ge=1)
    """Blocks of equal size into which the hidden neurons are divided: recurrent synapses exist only within a block."""
    learn: tuple[Literal["alpha", "beta", "threshold"], ...] = ()
    """Which dynamics are learned with the weights: one value for the hidden layer, one for the readout."""
    readout: Literal["count", "integrator", "max"] = "count"
    """count: readout neurons spike and are counted. integrator: a bias and the weights of all hidden spikes are added
    up. max: the weights are added up with a leak, and the largest value over time counts. The last two do not spike."""
    readout_tau_ms: float | None = Field(default=None, gt=0)
    """Time constant with which the sum of an integrator or a maximum decays. If absent, an integrator does not leak,
    and a maximum leaks with `tau_mem_ms`."""
    readout_stretches: int = Field(default=1, ge=1, le=MOST_STRETCHES)
    """K: stretches of a window, in each of which an integrator without a leak has weights of its own: shared ones plus
    a deviation. 1: the same weights at all times."""
    readout_stretch_ms: float | None = Field(default=None, gt=0)
    """Length of a stretch, a whole number of steps of the network's clock; the last one has no end."""
    input_deviation: float | None = Field(default=None, gt=0)
    """Standard deviation, in thresholds, of each hidden neuron's free membrane (without reset or recurrence) over the
    training windows: its initial input weights are scaled to it, and the weights of an integrator to a deviation of 1
    per class. If absent, weights are not scaled."""
    recipe: Literal["default"] | None = None
    """The rules that choose the keys that are not given."""
    effort: Effort = "default"
    """What the recipe spends on accuracy: `quick` trains for a third of the steps, `best` joins three networks
    (`training.members`)."""
    training: TrainingSpec = TrainingSpec()

    _own: Spec | None = PrivateAttr(default=None)

    @property
    def own(self) -> Spec | None:
        """The keys of a network that is a part with keys of its own; None of an RSNN."""
        return self._own

    @model_validator(mode="wrap")
    @classmethod
    def _with_own_keys(cls, table: Any, handler: ModelWrapValidatorHandler["RSNNSpec"]) -> "RSNNSpec":
        """Build the keys of a part from those that are not keys of every network."""
        if not isinstance(table, Mapping):
            return handler(table)
        if isinstance(table.get("hidden"), (list, tuple)) and table.get("model", "rsnn") in BUILT_IN:
            table = _of_layers(table)
        model = table.get("model", "rsnn")
        if model in BUILT_IN or not isinstance(model, str) or not plugins.has("networks", model):
            return handler(table)
        keys = {key: value for key, value in table.items() if key not in COMMON}
        spec = handler({key: value for key, value in table.items() if key in COMMON})
        if spec.n_members > 1:
            raise ValueError(f"{spec.n_members} networks (training.members) join only if they are an rsnn or an snn")
        part = part_of(model)
        if part.keys is not RSNNSpec:
            spec._own = specs.build(part.keys, keys, source=f"model = '{model}'")
        return spec

    @classmethod
    def keys_with(cls, model: object) -> Collection[str]:
        """The keys of every network and those of a part; empty for a built-in model, which has all of this spec."""
        is_part = model not in BUILT_IN and plugins.has("networks", model)
        return (*COMMON, *part_of(str(model)).keys.model_fields) if is_part else ()

    @classmethod
    def of_parts(cls, asked: str | None) -> Mapping[str, Mapping[str, Any]]:
        """The name of a network gives the defaults of its keys, and the training that the recipe chooses."""
        plugins.has("networks", asked)
        return {name: {"model": name, "recipe": "default"} for name in plugins.names("networks")}

    @property
    def own_keys(self) -> str:
        """The model and the keys of its own that differ from its defaults, as JSON."""
        own = {} if self.own is None else self.own.model_dump(mode="json", exclude_defaults=True)
        return json.dumps({"model": self.model, **own})

    def __repr_args__(self) -> Iterator[tuple[str, Any]]:
        yield from super().__repr_args__()
        if self.own is not None:
            yield from self.own.__repr_args__()

    @property
    def n_hidden(self) -> int:
        """Hidden neurons; 0 of a part that does not say it."""
        return self.hidden if self.own is None else int(getattr(self.own, "n_hidden", 0))

    @property
    def layers(self) -> str:
        """The neurons of each hidden layer, if there are several; else empty.

        >>> RSNNSpec(hidden=[20, 10]).layers, RSNNSpec(hidden=30).layers
        ('20+10', '')
        """
        each = getattr(self.own, "hidden", 0)
        return "+".join(map(str, each)) if isinstance(each, tuple) and len(each) > 1 else ""

    @property
    def spike(self) -> SpikeFunction:
        """What a hidden neuron sends, with its surrogate gradient."""
        return surrogates.spike_function(self.surrogate, self.surrogate_scale)

    @property
    def own_step_ms(self) -> float | None:
        """The step of the network's clock; None if it is the encoder's."""
        return None if self.step_ms == "encoder" else self.step_ms

    @property
    def recurrent(self) -> bool:
        """Whether hidden neurons are connected to one another, or may be after training."""
        return self.model != "snn" and self.own is None and self.hidden > 0

    @property
    def hears_afferents(self) -> bool:
        """Whether input spikes reach the readout directly."""
        return self.own is None and (self.direct is True or not self.hidden)

    def heard(self, n_inputs: int) -> int:
        """Neurons whose spikes reach the readout: the hidden ones, then the afferents where it hears them.

        >>> [spec.heard(16) for spec in (RSNNSpec(hidden=5), RSNNSpec(hidden=5, readout="integrator", direct=True))]
        [5, 21]
        """
        return self.hidden + n_inputs * self.hears_afferents

    @property
    def fan_among(self) -> int:
        """Hidden neurons that the spike of a hidden neuron reaches.

        >>> [RSNNSpec(hidden=12, recurrent_blocks=3).fan_among, RSNNSpec(model="snn").fan_among]
        [4, 0]
        """
        return self.hidden // self.recurrent_blocks if self.recurrent else 0

    @property
    def n_members(self) -> int:
        """Networks that training joins, with the choice of the recipe.

        >>> [RSNNSpec(recipe="default", effort=effort).n_members for effort in ("quick", "best")]
        [1, 3]
        """
        return BEST_MEMBERS if self.effort == "best" and self.hidden else self.training.members

    @property
    def n_trainings(self) -> int:
        """The most networks that are trained, one after another.

        >>> RSNNSpec().n_trainings, RSNNSpec(model="auto", recipe="default", effort="best").n_trainings
        (1, 4)
        """
        return self.n_members + (self.model == "auto") + (self.direct == "auto")

    def of_model(self, model: Model) -> "RSNNSpec":
        """The same network with this model in place of its own; one without recurrence has no keys of recurrence.

        >>> chosen = RSNNSpec(model="auto", hidden=8, recurrent_blocks=2).of_model("snn")
        >>> chosen.model, chosen.hidden, chosen.recurrent_blocks
        ('snn', 8, 1)
        """
        fields = type(self).model_fields
        unused = effects.voids(model=model).keys() & self.model_fields_set
        return self.model_copy(update={"model": model, **{key: fields[key].default for key in unused}})

    def without_layer(self, stretches: int, stretch_ms: float) -> "RSNNSpec":
        """The network on the same clock that has no hidden layer, with so many stretches.

        >>> RSNNSpec(readout="integrator", direct="auto").without_layer(8, 25.0).readout_stretches
        8
        """
        table = {
            "model": "snn",
            "hidden": 0,
            "readout": "integrator",
            "training": {key: getattr(self.training, key) for key in ("temperature", "sparsity")},
        }
        own = {"readout_stretches": stretches, "readout_stretch_ms": stretch_ms} if stretches > 1 else {}
        return specs.build(type(self), {**table, **own, "step_ms": self.step_ms}, source="hidden = 0")

    @property
    def joined_hidden(self) -> int:
        """Hidden neurons of the trained network.

        >>> RSNNSpec(recipe="default", hidden=50, effort="best").joined_hidden
        150
        """
        return self.n_members * self.hidden

    @property
    def integrates(self) -> bool:
        """Whether the readout adds up weights and a bias, and does not spike."""
        return self.readout != "count"

    @property
    def readout_leak_ms(self) -> float | None:
        """The time constant of a readout that does not spike; None without a leak."""
        return self.tau_mem_ms if self.readout == "max" and self.readout_tau_ms is None else self.readout_tau_ms

    @model_validator(mode="after")
    def _leak_has_a_readout(self) -> "RSNNSpec":
        if self.readout_tau_ms is not None and self.readout == "count" and self.recipe is None:
            raise ValueError("readout_tau_ms needs readout = 'integrator' or 'max'; set that, or drop the key")
        return self

    @model_validator(mode="after")
    def _afferents_have_a_sum(self) -> "RSNNSpec":
        if not (self.hears_afferents or self.direct):
            return self
        what = f"direct = {json.dumps(self.direct)}" if self.direct else "hidden = 0"
        if self.direct == "auto" and not self.hidden:
            raise ValueError("direct = 'auto' tries hidden neurons, too; set hidden above 0, or drop direct")
        if not (self.direct or self.hidden) and "direct" in self.model_fields_set:
            raise ValueError("direct = false leaves a network with hidden = 0 nothing to hear; drop it, or set hidden")
        if not self.hidden and self.training.members > 1:
            raise ValueError("training.members: networks with hidden = 0 are all the same; set 1, or hidden")
        chooses = self.recipe is not None and "readout" not in self.model_fields_set
        if self.readout_tau_ms is not None or not (chooses or self.readout == "integrator"):
            raise ValueError(f"{what} needs readout = 'integrator' without readout_tau_ms; set that, or change {what}")
        return self

    @model_validator(mode="after")
    def _stretches_have_a_sum(self) -> "RSNNSpec":
        if self.readout_stretches == 1 or self.recipe is not None:
            return self
        if self.readout != "integrator" or self.readout_tau_ms is not None:
            raise ValueError("readout_stretches needs readout = 'integrator' without readout_tau_ms; set that, or 1")
        if self.readout_stretch_ms is None:
            raise ValueError("readout_stretches needs readout_stretch_ms, the length of a stretch; set both")
        return self

    @model_validator(mode="after")
    def _decay_has_an_adaptation(self) -> "RSNNSpec":
        if "tau_adaptation_ms" in self.model_fields_set and not self.threshold_adaptation:
            raise ValueError("tau_adaptation_ms needs threshold_adaptation above 0; set that, or drop the key")
        return self

    @model_validator(mode="after")
    def _effort_has_an_effect(self) -> "RSNNSpec":
        if "effort" in self.model_fields_set and self.recipe is None:
            raise ValueError(
                "effort has no effect without a recipe; set recipe = 'default' or training.members, or drop the key"
            )
        key = {"quick": "epochs", "best": "members"}.get(self.effort)
        if key in self.training.model_fields_set:
            raise ValueError(f"effort = '{self.effort}' has no effect beside training.{key}; leave out either")
        return self

    @model_validator(mode="after")
    def _members_can_be_joined(self) -> "RSNNSpec":
        if self.n_members == 1 or self.model not in BUILT_IN:
            return self
        chooses = self.recipe is not None and "readout" not in self.model_fields_set
        if self.learn or not (chooses or self.readout == "integrator"):
            raise ValueError(
                f"{self.n_members} networks (training.members) join into one only with readout = 'integrator' and "
                "without learn; set these, or training.members = 1"
            )
        if self.joined_hidden > MOST_HIDDEN:
            raise ValueError(
                f"{self.n_members} networks (training.members) of {self.hidden} hidden neurons join into one of "
                f"{self.joined_hidden}, and {MOST_HIDDEN} is the most; take smaller or fewer ones"
            )
        return self

    @model_validator(mode="after")
    def _blocks_are_equal(self) -> "RSNNSpec":
        if self.hidden % self.recurrent_blocks:
            raise ValueError(
                f"recurrent_blocks: {self.hidden} hidden neurons are not divisible into {self.recurrent_blocks} equal "
                "blocks; change either"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_unused(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        table = dump(self)
        own = {} if self.own is None else self.own.model_dump(mode="json", exclude_unset=self.recipe is not None)
        if self.own is not None:
            table = {**{key: value for key, value in table.items() if key in COMMON}, **own}
        if self.recipe is None:
            unused = {"effort"} | (set() if self.threshold_adaptation else {"tau_adaptation_ms"})
            unused |= set() if self.direct else {"direct"}
            return {key: value for key, value in table.items() if key not in unused}  # which no spec may name then
        names = {*self.model_fields_set, *own} - {"training"}
        given = {key: value for key, value in table.items() if key in names}
        training = {key: getattr(self.training, key) for key in sorted(self.training.model_fields_set)}
        return {**given, "training": training} if training else given


def _counts_nothing(model: str) -> bool:
    """Whether the class of a part's module cannot count spikes."""
    module = part_of(model).module
    return isinstance(module, type) and not hasattr(module, "counted")


def void_keys(spec: RSNNSpec) -> dict[str, str]:
    """The keys that have no effect in a network without a recipe, and why.

    >>> list(void_keys(RSNNSpec(model="snn", training=TrainingSpec(readout_dropout=0.1))))[-4:]
    ['training.readout_dropout', 'recurrent_blocks', 'recurrent_delay_steps', 'recurrent_weight_scale']
    """
    scales_all = spec.input_deviation is not None and spec.integrates and not spec.recurrent
    is_relative = spec.training.relative_learning_rate is not None
    if spec.own is not None:
        optimiser = spec.training.optimiser
        of_rsnn = "has no effect with a network of another model; leave it out"
        penalties = [key for key in ("rate_penalty", "population_penalty") if getattr(spec.training, key)]
        unheard = penalties if _counts_nothing(spec.model) else []
        return {
            **{f"training.{key}": of_rsnn for key in ("readout_dropout", "stretch_rate")},
            **{f"training.{key}": "has no effect where no hidden spikes are counted; leave it out" for key in unheard},
            **effects.voids(**{f"has_{key}": optimisers.takes(optimiser, key) for key in ("betas", "weight_decay")}),
        }
    return effects.voids(
        model=spec.model,
        readout=spec.readout,
        keeps_scale=not scales_all,
        has_others=not is_relative or spec.integrates or bool(spec.learn),
        readout_stretches=spec.readout_stretches,
        hidden=spec.hidden,
        has_betas=optimisers.takes(spec.training.optimiser, "betas"),
        has_weight_decay=optimisers.takes(spec.training.optimiser, "weight_decay"),
    )


def given_keys(network: str | Path | RSNNSpec, settings: Mapping[str, Any] | None) -> list[str]:
    """The keys that a user has given for a network: the `settings`, and of a spec with a recipe all of its keys.

    Of a complete spec, those keys which differ from the default and have no effect even before the settings.
    """
    if isinstance(network, RSNNSpec):
        before, table = network, network.model_dump(mode="json")
    else:
        before, (table, _) = specs.load(RSNNSpec, network), specs.table_of(RSNNSpec, network)
    table = specs.leaves(table)
    if before.recipe is None:
        usual = specs.leaves(RSNNSpec().model_dump(mode="json"))
        table = {key: value for key, value in table.items() if key in void_keys(before) and value != usual.get(key)}
    return [*specs.leaves(settings or {}), *table]
