"""A paragraph on the methods of a study in plain English; every number in it is one of the study's spec or data."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

from neurotact_parts.studies.publishing.references import sets

from neurotact.baselines import opponents
from neurotact.data.augmentation import NONE
from neurotact.data.conditioning import ConditioningSpec
from neurotact.data.dataset import DatasetSpec
from neurotact.data.fetch import SETS
from neurotact.data.splits import SplitSpec
from neurotact.data.windows import WindowSpec
from neurotact.encoders import model as encoders
from neurotact.encoders.model import SENSITIVITY
from neurotact.figures.columns import quantity
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.studies.loading import Study
from neurotact.studies.study import StudySpec
from neurotact.studies.way_study import WayStudy

BASELINES = {
    "mean": "the mean of each whole trial",
    "start": "the mean of its first {start_ms:g} ms",
    "high-pass": "a moving average with a cut-off at {high_pass_Hz:g} Hz",
}
NETWORKS = {"rsnn": "a recurrent spiking network", "snn": "a feed-forward spiking network"}


WORDS = {
    "hidden": "hidden neurons", "t ref": "refractory period", "v rest": "resting potential",
    "v reset": "reset potential", "v threshold": "threshold", "tau mem": "membrane time constant",
    "tau syn": "synaptic time constant",
    "sa1": "SA-I", "ra1": "RA-I", "pc": "PC", "rate penalty": "penalty of the spike rate", "batch": "batches of",
    "epochs": "epochs at most", "membrane": "membrane equation",
}  # fmt: skip
"""Names of settings that are short in specs."""
UNTOLD = {"loss", "keep", "stretch_rate", "readout_stretches", "model", "effort", "recurrent_blocks", "members"}
"""Keys of a network that other sentences tell, or that stand for an option where they are not 1."""
CHOSEN = {
    "choose_ema": "the cut-off of the moving average", "choose_opposite": "whether some SA-I follow the falling signal",
    "choose_grades": "whether there are SA-I of several thresholds",
}  # fmt: skip
"""What calibration may choose beside the baseline, the standardisation and the gains."""


def in_words(study: Study, facts: Sequence[str] = ()) -> str:
    """The methods of a study, a paragraph for each step. facts: the summaries of its recordings.

    >>> from neurotact.studies import loading
    >>> in_words(loading.resolve("refractory-period")).partition(".")[0]
    'Recordings were simulated by the simulator gratings with trials 100'
    """
    return "\n\n".join(" ".join(part) for part in map(list, _paragraphs(study, facts)) if part)


def _paragraphs(study: Study, facts: Sequence[str]) -> Iterator[Iterator[str]]:
    used = (f"The data were {fact}." for fact in facts)
    if not isinstance(study, StudySpec):
        yield chain(_of_way(study), used)
        return
    yield chain(_recordings(study.dataset), used)
    yield _encoding(study)
    yield _windows(study.window, study.split, study.dataset.stratify)
    if study.network is not None:
        yield _network(study, study.network)
    yield _comparison(study)


def _of_way(study: WayStudy) -> Iterator[str]:
    yield from filter(None, (" ".join(study.about.split()), *(f"Data: {SETS[name].about}." for name in sets(study))))
    plain = {key: value for key, value in study.parameters.items() if _is_plain(value)}
    if listed(plain):
        yield f"Its parameters: {listed(plain)}."
    yield _sweep(study)
    yield "The spec has all other parameters."


def _is_plain(value: Any) -> bool:
    """Whether a sentence can tell a value: it has no table of tables in it."""
    if isinstance(value, Mapping):
        return not any(isinstance(one, (Mapping, list)) for one in value.values())
    return not isinstance(value, list) or not any(isinstance(one, (Mapping, list)) for one in value)


def listed(table: Mapping[str, Any]) -> str:
    """Settings in words, those of inner tables after the name of their table.

    >>> listed({"tau_mem_ms": 10.0, "sa1": {"gain": 3.2, "grades": [1.0, 0.5]}, "opposite": False, "rate_ms": None})
    'membrane time constant 10 ms, SA-I (gain 3.2, grades 1 and 0.5)'
    """
    return ", ".join(filter(None, (_setting(key, value) for key, value in table.items())))


def _setting(key: str, value: Any) -> str:
    """One setting; empty for one that is absent or off, and for the place of recordings."""
    if (value in (None, False, "", [], {}) and key != "seed") or key in ("file", "path"):
        return ""
    name, unit = _named(key)
    if isinstance(value, Mapping):
        return f"{name} ({listed(value)})" if listed(value) else ""
    return name if value is True else f"{name} {_value(value)} {unit}".strip()


def _named(key: str) -> tuple[str, str]:
    """The name and the unit of a setting."""
    name, unit = quantity(key)
    return WORDS.get(name, name), unit


def _value(value: Any) -> str:
    """A value; of a list, all of them.

    >>> _value([[1, 1], [5, 10]]), _value([20, 30, 40])
    ('1 with 1 and 5 with 10', '20, 30 and 40')
    """
    if isinstance(value, (list, tuple)):
        each = [" with ".join(map(_value, one)) if isinstance(one, (list, tuple)) else _value(one) for one in value]
        return " and ".join(filter(None, (", ".join(each[:-1]), *each[-1:])))
    if isinstance(value, Mapping):
        return f"({listed(value)})"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _recordings(dataset: DatasetSpec) -> Iterator[str]:
    if dataset.simulate is not None:
        yield f"Recordings were simulated by the simulator {dataset.simulate} with {listed(dataset.parameters)}."
    elif dataset.read is not None:
        about = next((f": {one.about}" for one in SETS.values() if one.reader == dataset.read), "")
        yield f"Recordings were those of the published set {dataset.read}{about}."
    elif dataset.arrays is not None:
        yield f"Recordings were sampled at {dataset.arrays.sampling_rate_Hz:g} Hz, in {dataset.arrays.unit}."
    else:
        yield "Recordings were those of the authors' own file."
    if dataset.choice:
        yield f"Of all trials, those were used that meet these conditions: {dataset.choice}."
    if dataset.at_most is not None:
        yield f"At most {dataset.at_most} trials were used, evenly spaced within each class and condition."


def _encoding(study: StudySpec) -> Iterator[str]:
    encoder, how = study.encoder, study.encoder.conditioning
    steps = [*_conditioning(how.model_copy(update={"baseline": "none"}) if study.calibrate else how)]
    if steps:
        yield f"Signals were {_value(steps)}."
    title = encoders.of_name(encoder.model).title
    keys = encoder.model_dump(mode="json", exclude={"conditioning", "model", "unit"})
    told = listed(_untold(keys, "encoder.", study, SENSITIVITY if study.calibrate else ()))
    yield f"They were encoded as spikes by the model `{encoder.model}` ({title}){told and ' with '}{told}."
    if study.calibrate:
        rate = "" if study.spikes_per_s is None else f", at {study.spikes_per_s:g} spikes per second of an afferent"
        fitted = ["the baseline", "the standardisation", "the gains"]
        fitted += [words for key, words in CHOSEN.items() if getattr(study, key)]
        yield f"These were chosen on the training trials alone: {_value(fitted)}{rate}."


def _untold(table: Mapping[str, Any], before: str, study: Study, ends: tuple[str, ...] = ()) -> dict[str, Any]:
    """Settings without those that the study sweeps, and those whose name begins with one of `ends`."""
    swept = {key for axis in study.sweep for key in axis.split(" & ")}
    return {
        key: _untold(value, f"{before}{key}.", study, ends) if isinstance(value, Mapping) else value
        for key, value in table.items()
        if f"{before}{key}" not in swept and not (ends and key.startswith(ends))
    }


def _conditioning(how: ConditioningSpec) -> Iterator[str]:
    if how.ema_cutoff_Hz is not None:
        yield f"smoothed by an exponential moving average with a cut-off at {how.ema_cutoff_Hz:g} Hz"
    if how.resample_Hz is not None:
        yield f"put on a clock of {how.resample_Hz:g} Hz"
    if how.baseline in BASELINES:
        yield f"taken relative to {BASELINES[how.baseline].format(**how.model_dump())}"
    if how.rectify:
        yield "rectified"


def _windows(window: WindowSpec, split: SplitSpec, stratify: tuple[str, ...]) -> Iterator[str]:
    begin = "the onset of contact" if window.align == "onset" else "the beginning of a trial"
    hop = window.length_ms if window.hop_ms is None else window.hop_ms
    most = "" if window.per_trial is None else f", at most {window.per_trial} a trial"
    yield (
        f"Windows of {window.length_ms:g} ms were classified, the first of which begins {window.start_ms:g} ms after "
        f"{begin}; they begin {hop:g} ms apart{most}."
    )
    if split.folds is not None:
        tested = f"Trials were divided into {split.folds} folds, of which one was tested"
    elif split.test_where:
        tested = f"The test trials were those with {listed(split.test_where)}"
    elif split.order is not None:
        tested = (
            f"The last {100 * split.test:g} % of the trials of each class, in the order of {split.order}, were tested"
        )
    else:
        tested = f"Trials were divided at random (seed {split.seed}); {100 * split.test:g} % of them were tested"
    rest = " of the others" if split.folds is not None or split.test_where else ""
    yield f"{tested}, and {100 * split.validation:g} %{rest} were kept for validation, by which every choice was made."
    if split.group:
        yield f"Trials with the same {_value(split.group)} were on one side."
    if stratify:
        yield f"Classes and {_value([_named(name)[0] for name in stratify])} were balanced over the sides."


def _network(study: StudySpec, network: RSNNSpec) -> Iterator[str]:
    keys = network.model_dump(mode="json", exclude_none=True)
    training, recipe = keys.pop("training", {}), keys.pop("recipe", None)
    told = listed(_untold({key: value for key, value in keys.items() if key not in UNTOLD}, "network.", study))
    name = NETWORKS.get(network.model, f"the network `{network.model}`")
    yield f"Windows were classified by {name}{told and ' with '}{told}."
    if recipe is not None:
        yield "Settings of it that are not named here were chosen from the training windows (recipe `default`)."
    keys = {key: value for key, value in training.items() if key not in UNTOLD}
    told = listed(_untold(keys, "network.training.", study))
    joined = "" if network.training.members == 1 else f" of {network.training.members} networks that are joined"
    yield f"Training{joined} minimised the {network.training.loss}{told and '; '}{told}."
    if study.search is not None:
        yield (
            f"Hyperparameters were searched on the validation trials: {study.search.trials} networks, proposed by "
            f"{study.search.tuner}, for {study.search.objective}."
        )
    if study.augmentation is not None and study.augmentation.kind != NONE and study.split.test_where:
        yield f"Varied copies of the training trials were tried: {listed(study.augmentation.model_dump())}."
    if study.balance != "none":
        yield f"Training windows were weighted so that all {study.balance} count the same."
    yield _sweep(study)
    yield (
        "Early exit stops a window where its decision is stable; its patience may lose "
        f"{100 * study.early_exit.tolerance:g} % of the validation trials."
    )


def _sweep(study: Study) -> str:
    axes = [
        f"{_axis(key)} ({_value(values)})" if all(map(_is_plain, values)) or " & " in key else _axis(key)
        for key, values in study.sweep.items()
    ]
    return f"These were varied: {'; '.join(axes)}." if axes else ""


def _axis(key: str) -> str:
    """The name of an axis of a sweep.

    >>> _axis("encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms"), _axis("network.hidden")
    ('RA-I refractory period in ms with SA-I refractory period in ms', 'hidden neurons')
    """
    parts = [[_named(name) for name in part.split(".")] for part in key.split(" & ")]
    words = (" ".join([*(name for name, _ in part), *(f"in {unit}" for _, unit in part if unit)]) for part in parts)
    return " with ".join(word.removeprefix("encoder ").removeprefix("network ") for word in words)


def _comparison(study: StudySpec) -> Iterator[str]:
    if study.baselines != "none":
        yield f"{opponents.in_words(study.baselines)} They had the same windows and the same split."
    yield "A synaptic operation (SOP) is a spike at a neuron that receives it."
    yield study.prices.in_words()
