"""The methods of a study in plain English; every number is one of the study's spec, of its data, or of what ran.

A spec leaves to the run what calibration, a recipe or a search chooses. Where the networks are known (`ran.Ran`), their
own encoders and settings are told in its place.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

from neurotact_parts.studies.publishing.ran import NOTHING, Ran, shared
from neurotact_parts.studies.publishing.references import has_copies, sets

from neurotact.baselines import opponents
from neurotact.data.conditioning import ACAUSAL, ConditioningSpec
from neurotact.data.dataset import DatasetSpec
from neurotact.data.fetch import SETS
from neurotact.encoders import model as encoders
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.model import SENSITIVITY
from neurotact.encoders.sensitivity import sensitivities_of
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
    "epochs": "epochs at most", "opposite": "for the rising and the falling signal", "membrane": "membrane equation",
}  # fmt: skip
"""Names of settings that are short in specs."""
UNTOLD = {
    "loss", "keep", "stretch_rate", "readout_stretches", "model", "effort", "recurrent_blocks", "members", "recipe",
    "training",
}  # fmt: skip
"""Keys of a network that other sentences tell, or that stand for an option where they are not 1."""
KEPT = {
    "loss": "the lowest validation loss", "accuracy": "the highest validation accuracy",
    "both": "the highest mean of training and validation accuracy",
}  # fmt: skip
EVENTS = "events"
CHOSEN = {
    "choose_ema": "the cut-off of the moving average", "choose_opposite": "whether some SA-I follow the falling signal",
    "choose_grades": "whether there are SA-I of several thresholds",
}  # fmt: skip
"""What calibration may choose beside the baseline, the standardisation and the gains."""
ALWAYS = {"choose_ema", "choose_opposite"}
"""The others are chosen only where networks train on varied copies."""


def in_words(study: Study, facts: Sequence[str] = (), ran: Ran = NOTHING) -> str:
    """The methods of a study, a paragraph for each step. facts: the summaries of its recordings. ran: what ran.

    >>> from neurotact.studies import loading
    >>> in_words(loading.resolve("refractory-period")).partition(".")[0]
    'Recordings were simulated by the simulator gratings with trials 100'
    """
    return "\n\n".join(" ".join(part) for part in map(list, _paragraphs(study, facts, ran)) if part)


def _paragraphs(study: Study, facts: Sequence[str], ran: Ran) -> Iterator[Iterator[str]]:
    used = (f"The data were {fact}." for fact in facts)
    if not isinstance(study, StudySpec):
        yield chain(_of_way(study), used)
    else:
        yield chain(_recordings(study.dataset, facts), used)
        yield _encoding(study, ran)
        yield _windows(study)
        if study.network is not None:
            yield _network(study, study.network, ran)
        yield _comparison(study, ran)
    if ran.versions:
        yield _machine(ran)


def _target(study: Study) -> list[str]:
    """What networks tell in place of classes: the names of numbers, or `events`; empty for classes."""
    return list(study.parameters.get("target", ())) if study.way == "targets" else []


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


def _recordings(dataset: DatasetSpec, facts: Sequence[str]) -> Iterator[str]:
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
    there = max((int(fact.split()[0].replace(",", "")) for fact in facts), default=None)
    if dataset.at_most is not None and (there is None or there > dataset.at_most):
        yield f"At most {dataset.at_most} trials were used, evenly spaced within each class and condition."


def _encoding(study: StudySpec, ran: Ran) -> Iterator[str]:
    encoder, ends = study.encoder, SENSITIVITY if study.calibrate else ()
    how, keys = encoder.conditioning, encoder.model_dump(mode="json", exclude={"conditioning", "model", "unit"})
    differ: dict[str, Any] = {}
    if ran.encoders:
        conditioned = [{**one.get("conditioning", {}), "taxels": None} for one in ran.encoders]
        how, ends = ConditioningSpec.model_validate(conditioned[0]), ()
        keys, differ = shared([{**one, "conditioning": None, "unit": None, "model": None} for one in ran.encoders])
    elif study.calibrate:
        how = how.model_copy(update={"baseline": "none"})
        how = how.model_copy(update={"ema_cutoff_Hz": None}) if study.choose_ema else how
    steps = [*_conditioning(how)]
    if steps:
        yield f"Signals were {_value(steps)}."
    title = encoders.of_name(encoder.model).title
    told = listed(_untold(keys, "encoder.", study, ends))
    yield f"They were encoded as spikes by the model `{encoder.model}` ({title}){told and ' with '}{told}."
    if found := listed(_untold(differ, "encoder.", study)):
        yield f"These differ between the networks: {found}."
    if ran.afferents:
        yield f"There were {_value(sorted({*ran.afferents}))} afferents."
    if study.calibrate:
        rate = "" if study.spikes_per_s is None else f", at {study.spikes_per_s:g} spikes per second of an afferent"
        fitted = ["the standardisation", *dict.fromkeys(f"the {one.kind}s" for one in sensitivities_of(encoder))]
        if encoder.conditioning.baseline in ACAUSAL:  # as `calibration_for` asks; a causal one is the study's own
            asked = [key for key in CHOSEN if getattr(study, key) and (key in ALWAYS or has_copies(study))]
            has_sa1 = isinstance(encoder, AfferentSpec)
            fitted = ["the baseline", *fitted, *(CHOSEN[key] for key in asked if has_sa1 or key == "choose_ema")]
        yield f"These were chosen on the training trials alone: {_value(fitted)}{rate}."
        if _target(study):
            yield from (note for note in study.notes if note.startswith("Gains:"))


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
    if how.offset is not None or how.scale is not None:
        yield "standardised, taxel by taxel, with an offset and a scale of the training trials"
    if how.baseline in BASELINES:
        yield f"taken relative to {BASELINES[how.baseline].format(**how.model_dump())}"
    if how.rectify:
        yield "rectified"


def _windows(study: StudySpec) -> Iterator[str]:
    window, split, stratify, target = study.window, study.split, study.dataset.stratify, _target(study)
    begin = "the onset of contact" if window.align == "onset" else "the beginning of a trial"
    hop = window.length_ms if window.hop_ms is None else window.hop_ms
    most = "" if window.per_trial is None else f", at most {window.per_trial} a trial"
    if target == [EVENTS]:
        yield (
            f"Detectors were trained on windows of {window.length_ms:g} ms that begin {hop:g} ms apart{most}, and run "
            "through whole recordings without a reset."
        )
    else:
        used = f"used to tell {_value(target)}" if target else "classified"
        yield (
            f"Windows of {window.length_ms:g} ms were {used}, the first of which begins {window.start_ms:g} ms after "
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


def _network(study: StudySpec, network: RSNNSpec, ran: Ran) -> Iterator[str]:
    every = ran.networks or [network.model_dump(mode="json", exclude_none=True)]
    layered = [one for one in every if one.get("hidden", 1) or one["model"] not in NETWORKS]
    keys, differ = shared(layered)
    models = list(dict.fromkeys(str(one["model"]) for one in layered))
    if models == ["snn"]:
        keys = {key: value for key, value in keys.items() if not key.startswith("recurrent_")}
    names = [NETWORKS.get(name, f"the network `{name}`") for name in models]
    told = listed(_untold({key: value for key, value in keys.items() if key not in UNTOLD}, "network.", study))
    if layered:
        yield f"{_answered(_target(study))} {_value(names)}{told and ' with '}{told}."
        yield from _training(study, network, keys.get("training", {}))
        yield from _differences(study, layered, differ)
    if len(layered) < len(every):
        fit = "ridge" if _target(study) else "logistic"
        if not layered:
            yield f"{_answered(_target(study))} networks without a hidden layer."
        yield (
            "Networks without a hidden layer have a readout that integrates the afferents' spikes. Its weights were "
            f"fitted by {fit} regression, with a penalty that was chosen on the validation windows."
        )
    if network.recipe is not None:
        which = "These settings" if ran.networks else "Settings of it"
        yield f"{which} were chosen from the training windows (recipe `{network.recipe}`) where the study names none."
    if study.search is not None:
        yield (
            f"Hyperparameters were searched on the validation trials: {study.search.trials} networks, proposed by "
            f"{study.search.tuner}, for {study.search.objective}, over {_value([*map(_axis, study.search.space)])}."
        )
    if has_copies(study) and study.augmentation is not None:
        yield f"Varied copies of the training trials were tried: {listed(study.augmentation.model_dump())}."
    if study.balance != "none":
        yield f"Training windows were weighted so that all {study.balance} count the same."
    yield _sweep(study)
    yield from _early_exit(study)


def _early_exit(study: StudySpec) -> Iterator[str]:
    tolerance = study.early_exit.tolerance
    if not _target(study):
        yield (
            "Early exit stops a window where its decision is stable; its patience may lose "
            f"{100 * tolerance:g} % of the validation trials."
        )
    elif _target(study) != ["events"]:
        yield (
            "Early exit stops a window where its numbers have settled; its patience and band may lose "
            f"{tolerance:g} of the score on validation trials."
        )


def _training(study: StudySpec, network: RSNNSpec, training: Mapping[str, Any]) -> Iterator[str]:
    told = listed(
        _untold({key: value for key, value in training.items() if key not in UNTOLD}, "network.training.", study)
    )
    joined = "" if network.training.members == 1 else f" of {network.training.members} networks that are joined"
    yield f"Training{joined} minimised the {training.get('loss', network.training.loss)}{told and '; '}{told}."
    if training.get("keep") in KEPT:
        yield f"The weights are those of the epoch of {KEPT[training['keep']]}."


def _differences(study: StudySpec, every: Sequence[Mapping[str, Any]], differ: Mapping[str, Any]) -> Iterator[str]:
    """The settings that the networks have not alike: those of each size, then those that differ within a size."""
    sizes = differ.get("hidden", ())
    within: dict[str, Any] = {} if sizes else _flat(differ)
    for size in sizes:
        alike, apart = map(_flat, shared([one for one in every if one.get("hidden") == size]))
        own = {key: value for key, value in alike.items() if key in _flat(differ) and key != "hidden"}
        if found := listed(_untold(own, "network.", study)):
            named = "+".join(map(str, size)) if isinstance(size, list) else size  # of several layers
            yield f"Networks of {named} hidden neurons had {found}."
        for key, values in apart.items():
            known = within.setdefault(key, [])
            known += [value for value in values if value not in known]
    if found := listed(_untold(within, "network.", study)):
        yield f"These differ between networks of one size: {found}."


def _flat(table: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a network and of its training that other sentences do not tell."""
    own = {key: value for key, value in table.items() if key not in UNTOLD}
    return own | {f"training {key}": value for key, value in table.get("training", {}).items() if key not in UNTOLD}


def _answered(target: Sequence[str]) -> str:
    """How a sentence begins whose end names what decides."""
    if not target:
        return "Windows were classified by"
    return "Events were detected by" if [*target] == [EVENTS] else f"{_value(target)} was told by"


def _sweep(study: Study) -> str:
    axes = [
        f"{_axis(key)} ({_value(values)})" if all(map(_is_plain, values)) or " & " in key else _axis(key)
        for key, values in study.sweep.items()
        if key != "seed"
    ]
    told = [f"These were varied: {'; '.join(axes)}."] if axes else []
    if seeds := study.sweep.get("seed"):
        told.append(f"Each was trained from {len(seeds)} start{'s' * (len(seeds) > 1)} (seed {_value(seeds)}).")
    return " ".join(told)


def _axis(key: str) -> str:
    """The name of an axis of a sweep.

    >>> _axis("encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms"), _axis("network.hidden")
    ('RA-I refractory period in ms with SA-I refractory period in ms', 'hidden neurons')
    """
    parts = [[_named(name) for name in part.split(".")] for part in key.split(" & ")]
    words = (" ".join([*(name for name, _ in part), *(f"in {unit}" for _, unit in part if unit)]) for part in parts)
    return " with ".join(word.removeprefix("encoder ").removeprefix("network ") for word in words)


def _comparison(study: StudySpec, ran: Ran) -> Iterator[str]:
    if ran.rivals:
        places = {place: "{} ({})".format(*place.split(": ")) if ": " in place else place for place in ran.rivals}
        told = "; ".join(f"on {places[place]}: {_value(names)}" for place, names in ran.rivals.items())
        yield f"Compared with these classifiers and regressions, tuned on the validation trials: {told}."
    elif study.baselines != "none" and not _target(study):
        yield opponents.in_words(study.baselines)
    if study.baselines != "none":
        yield "They had the same windows and the same split."
    if study.network is not None:
        yield (
            "Networks were chosen by validation trials alone. On test trials the chosen one was compared with every "
            "rival that validation trials cannot tell from the best one, by paired tests that exchange the signs of "
            "the differences of trials (McNemar's exact test where a trial is right or wrong), with Holm's correction; "
            "differences over random splits by the corrected resampled t test (Nadeau and Bengio 2003). Intervals "
            "cover 95 %."
        )
    yield "A synaptic operation (SOP) is a spike at a neuron that receives it."
    yield study.prices.in_words()


def _machine(ran: Ran) -> Iterator[str]:
    """The software and the machine."""
    apart = ("machine", "instructions", "backend", "python")
    used = [f"{name} {version}" for name, version in ran.versions.items() if name not in (*apart, "snntorch", "nni")]
    names = {key: ran.versions.get(key, "unknown") for key in apart}
    yield (
        f"Computed on processors of {names['machine']} with {names['instructions']}, by the {names['backend']} "
        f"kernels, Python {names['python']}, {_value(used)}."
    )
