"""Random seeds of a training, drawn from its seed and its split: the same start wherever the network is trained.

Networks of one split and one seed start alike, whether a study or `train` trains them; those of other splits do not,
so that the spread of accuracies over splits is that of starts, too. Trials of a search draw theirs from their settings.
"""

from typing import Any

from neurotact.data.splits import SplitSpec
from neurotact.spec import Spec, digest

FIRST = {
    "OnsetSpec": {"rest_ms", "bin_ms", "deviations"},
    "RSNNSpec": {
        "model", "hidden", "membrane", "reset", "tau_mem_ms", "tau_syn_ms", "surrogate_scale", "forward_weight_scale",
        "recurrent_weight_scale", "learn", "training",
    },
    "SplitSpec": {"validation", "test", "seed"},
    "Task": {"window", "split", "stratify", "subset", "training_windows", "exit_tolerance"},
    "TrainingSpec": {"learning_rate", "batch", "epochs", "patience", "rate_penalty", "population_penalty"},
    "WindowSpec": {"length_ms", "start_ms", "hop_ms", "per_trial"},
}  # fmt: skip
"""Keys of each kind of spec that always count. Any other key, also one that is added, counts if it is not at its
default: so a new key changes no seed, and no number, of a network that does not use it."""


def of_start(seed: int, split: SplitSpec) -> tuple[int, int]:
    """The seeds of the initial weights and of the order of trials of a network that is trained on a split.

    Of the split count what repetitions vary: its own seed, the fold and the condition that is tested.

    >>> of_start(0, SplitSpec()) == of_start(0, SplitSpec(test=0.3)) != of_start(0, SplitSpec(folds=5, fold=1))
    True
    """
    tested = {key: f"{value:g}" if isinstance(value, int | float) else value for key, value in split.test_where.items()}
    return drawn([seed, split.seed, split.fold, tested])  # 450 and 450.0 are one condition


def drawn(settings: Any) -> tuple[int, int]:
    """The seeds of a network's initial weights and of the order of its trials; settings: specs, tables and lists.

    >>> from neurotact.networks.definition.specs import RSNNSpec
    >>> drawn([RSNNSpec(), 0]) == drawn([RSNNSpec(readout="count"), 0]) != drawn([RSNNSpec(readout="max"), 0])
    True
    """
    content = digest(_counted(settings))
    return int(content[:6], 16), int(content[6:], 16)


def of_member(first: tuple[int, int], member: int) -> tuple[int, int]:
    """The two seeds of the members of a network, from those of the first one, whose `member` is 1.

    >>> of_member((3, 4), 1), of_member((3, 4), 2) != of_member((3, 4), 3)
    ((3, 4), True)
    """
    return first if member == 1 else drawn(["member", *first, member])


def _counted(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _counted(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_counted(inner) for inner in value]
    if not isinstance(value, Spec):
        return value
    table, fields = value.model_dump(mode="json"), type(value).model_fields
    if table.get("recipe") is not None:  # such a spec is written with the given keys alone: all count
        return table
    first = FIRST.get(type(value).__name__, table)
    kept = {key: getattr(value, key) for key in table}
    kept = {key: inner for key, inner in kept.items() if key in first or inner != fields[key].default}
    return {key: _counted(inner) if isinstance(inner, Spec) else table[key] for key, inner in kept.items()}
