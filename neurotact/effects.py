"""Parameters that have an effect only beside others: where one would change nothing, it is refused, not ignored.

The command line and Python share the table `NEEDS`. A message names parameters as in Python, in backquotes; the command
line writes them as options.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, NamedTuple

from neurotact.errors import InputError


class NoEffectError(InputError):
    """A parameter that is given and would change nothing."""


def is_given(value: Any) -> bool:
    """Whether a parameter has a value: neither None nor False, nor an empty list or table.

    >>> [is_given(value) for value in (0, 0.0, True, None, False, [], {})]
    [True, True, True, False, False, False, False]
    """
    return not (value is None or value is False or (hasattr(value, "__len__") and not len(value)))


def _is_absent(value: Any) -> bool:
    """Whether a parameter has no value."""
    return not is_given(value)


def _is_in(*values: Any) -> Callable[[Any], bool]:
    """Whether a parameter has one of these values."""
    return lambda value: value in values


def _more_than_one(value: Any) -> bool:
    """Whether a number is above 1."""
    return value > 1


def _more_than_one_of(value: Any) -> bool:
    """Whether a list or a table has more than one entry."""
    return value is not None and len(value) > 1


class _Need(NamedTuple):
    """names: of parameters. beside: another parameter. suits: the values of it with which they have an effect.

    why: after "has no effect", in words. fix: what to do.
    """

    names: str
    beside: str
    suits: Callable[[Any], bool]
    why: str
    fix: str = "leave it out"


OR_GIVE = "give that, or leave it out"
SAMPLES = _is_in("pipe", "serial port", "file")
"""Kinds of sources of which samples are read as text or bytes; the others are recordings, a simulation and LSL."""
LIVE = _is_in("pipe", "serial port", "file", "LSL stream")
"""Kinds of sources whose sampling rate may differ from that of the training."""

NEEDS = (
    # windows and split
    _Need("onset.rest_ms onset.bin_ms onset.deviations", "align", _is_in("onset"), "without `align='onset'`", OR_GIVE),
    _Need("fold", "folds", is_given, "without `folds`, the number of folds", OR_GIVE),
    _Need("split.seed", "order", _is_absent, "with `order`, which draws nothing at random"),
    _Need("nested", "test_where", is_given, "without `test_where`", OR_GIVE),
    _Need("leave_aside", "test_where", _more_than_one_of, "without several conditions in `test_where`", OR_GIVE),
    _Need("stratify", "drawn", bool, "with `test_where`, where validation leaves out one of the other values"),
    _Need("test", "test_where", _is_absent, "with `test_where`, which selects the test trials"),
    _Need("test", "folds", _is_absent, "with `folds`, of which one is tested"),
    _Need("test", "leave_out_each", _is_absent, "with `leave_out_each`, which selects the test trials"),
    _Need("copies", "augmentation", is_given, "without `augmentation`, which says what varies", OR_GIVE),
    # train, tune, infer
    _Need("false_alarms_per_h", "target", _is_in(("events",)), "without `target='events'`", OR_GIVE),
    _Need("sops_weight", "objective", _is_in("accuracy-sops"), "without `objective='accuracy-sops'`", OR_GIVE),
    _Need("start_epoch", "assessor", _is_in("median-stop"), "with `assessor='none'`, which stops no trial"),
    _Need("workers", "scheduler", _is_absent, "with `scheduler`, whose cluster has the workers that have joined it"),
    _Need("step_ms", "clock_ms", is_given, "with this reader, whose files have no events"),
    _Need("force", "out", is_given, "without `out`, since nothing is written", OR_GIVE),
    # fine_tune, export
    _Need("seed", "epochs", lambda epochs: epochs != 0, "with `epochs=0`, which only rounds"),
    _Need("weight_bits state_bits lsb", "variant", _is_in(None, "integer"), "with `variant='float'`"),
    _Need("new_classes", "variant", _is_in("float"), "without `variant='float'`", OR_GIVE),
    _Need("quiet_ms", "contact", bool, "without `contact=True`: windows then start one after the other", OR_GIVE),
    _Need("hop_ms", "contact", _is_absent, "with `contact=True`: each window then starts at a contact"),
    _Need("recordings spikes", "ranges", bool, "where no recordings are read: only integers and `prove` need them"),
    # stream, live
    _Need("format lsb zero time_column", "source", SAMPLES, "with this `source`, which has a format of its own"),
    _Need("sampling_rate_Hz", "source", LIVE, "with this `source`, which has a sampling rate of its own"),
    _Need(
        "format unit time_column lsb zero hold_ms stall_s sampling_rate_Hz",
        "takes_events",
        _is_absent,
        "with a network that takes the events of a sensor, not samples",
    ),
    _Need("time_unit origin polarity", "takes_events", bool, "with a network that takes samples, not events"),
    _Need("baud", "source", _is_in("serial port"), "without a serial port, as in `source='serial:/dev/ttyUSB0'`"),
    _Need("stall_s", "source", _is_in("pipe", "serial port", "LSL stream"), "with this `source`, which is never late"),
    _Need("speed", "source", _is_in("recordings", "simulation"), "with a device, whose samples come at their own rate"),
    _Need("settings", "source", _is_in("simulation"), "without a simulated finger, as in `source='gratings'`"),
    _Need("loop shuffle", "source", _is_in("recordings"), "without recordings, as in `source='FILE.h5'`"),
    _Need("time_column", "format", _is_in(None, "csv"), "without `format='csv'`: other frames have no time", OR_GIVE),
    _Need("lsb zero", "format", _is_in("int16"), "without `format='int16'`", OR_GIVE),
    # keys of a network
    _Need(
        "recurrent_weight_scale recurrent_delay_steps recurrent_blocks",
        "model",
        _is_in("rsnn", "auto"),
        "with model = 'snn'",
    ),
    _Need("readout_surrogate_scale", "readout", _is_in("count"), "with a readout that does not spike"),
    _Need("training.readout_dropout", "readout", _is_in("integrator", "max"), "with readout = 'count'"),
    _Need(
        "readout_stretch_ms training.stretch_rate", "readout_stretches", _more_than_one, "with readout_stretches = 1"
    ),
    _Need(
        "model membrane reset tau_mem_ms tau_syn_ms threshold_adaptation tau_adaptation_ms surrogate surrogate_scale "
        "recurrent_weight_scale recurrent_delay_steps recurrent_blocks forward_weight_scale input_deviation learn "
        "training.loss training.batch training.epochs training.patience training.target_loss training.optimiser "
        "training.learning_rate training.relative_learning_rate training.schedule training.keep training.stretch_rate "
        "training.betas training.weight_decay training.rate_penalty training.population_penalty "
        "training.input_dropout training.input_jitter_ms training.readout_dropout",
        "hidden",
        bool,
        "without a hidden layer (hidden = 0), since a regression fits the weights, without gradient steps",
    ),
    _Need("forward_weight_scale", "keeps_scale", bool, "with input_deviation, to which all weights are scaled"),
    _Need("training.betas", "has_betas", bool, "with a training.optimiser that has none"),
    _Need("training.weight_decay", "has_weight_decay", bool, "with a training.optimiser that has none"),
    _Need(
        "training.learning_rate", "has_others", bool, "with training.relative_learning_rate, the rate of all weights"
    ),
    # SpikingClassifier
    _Need(
        "validation_fraction groups", "held_out", bool, "where validation windows are given, since none are held out"
    ),
    # others
    _Need("out", "name", is_given, "without the name of a set, since the sets are then only listed", OR_GIVE),
    _Need("trial start_s stop_s recordings", "file", _is_in("picture"), "in a file of events, which holds all of them"),
    _Need("all", "content", _is_in("recordings"), "with spikes, whose afferents are always shown by population"),
)  # fmt: skip


def voids(**values: Any) -> dict[str, str]:
    """The parameters that have no effect beside these values, given or not, and the rest of the sentence on each."""
    unmet = [need for need in NEEDS if need.beside in values and not need.suits(values[need.beside])]
    reasons = [(name, f"has no effect {need.why}; {need.fix}") for need in unmet for name in need.names.split()]
    return dict(reversed(reasons))  # the first need of a name counts


def check(**values: Any) -> None:
    """NoEffectError for the first given parameter that has no effect beside the others; None means not given.

    >>> check(sops_weight=0.1, objective="accuracy-sops")
    >>> check(lsb=0.1, format="csv")
    Traceback (most recent call last):
    neurotact.effects.NoEffectError: `lsb`: has no effect without `format='int16'`; give that, or leave it out
    """
    reasons = voids(**values)
    for name in values:
        if name in reasons and is_given(values[name]):
            raise NoEffectError(f"`{name}`: {reasons[name]}")


def check_given(given: Iterable[str], **beside: Any) -> None:
    """NoEffectError for the first given field of a spec that has no effect beside these values.

    >>> check_given(["onset.rest_ms"], align="trial")
    Traceback (most recent call last):
    neurotact.effects.NoEffectError: `onset.rest_ms`: has no effect without `align='onset'`; give that, or leave it out
    """
    reasons = voids(**beside)
    for name in given:
        if name in reasons:
            raise NoEffectError(f"`{name}`: {reasons[name]}")


def check_keys(given: Collection[str], every: Iterable[Mapping[str, str]], source: str) -> None:
    """InputError for the first given key of a spec that has no effect.

    every: for each place where the spec is used, its keys without an effect, as of `voids`; a key that has an effect in
    one of them is not refused.

    >>> check_keys(["fold"], [voids(folds=None), voids(folds=5)], "study.toml")
    """
    common: dict[str, str] | None = None
    for keys in every:
        common = {**keys} if common is None else {key: why for key, why in common.items() if key in keys}
    for key in given:
        if common and key in common:
            raise InputError(f"{key}: {common[key]} ({source})")
