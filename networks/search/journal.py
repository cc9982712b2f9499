"""The journal of a search: one line of JSON per trial; it survives interruptions of the search."""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, TypeAdapter, ValidationError

from neurotact import files
from neurotact.errors import InputError
from neurotact.metrics import synops

JOURNAL = "journal.jsonl"
FINISHED, STOPPED, FAILED = "finished", "stopped", "failed"


@dataclass(frozen=True)
class Trial:
    """A line of the journal.

    epochs: validation accuracy after each epoch.
    outcome: finished, stopped (by the assessor) or failed.
    accuracy, sops: of the trained network on validation windows; if stopped, of the network after the last epoch. sops
    is None where they are not counted.
    value: what the tuner received.
    """

    __pydantic_config__ = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
    id: int
    parameters: dict[str, Any]
    epochs: list[float]
    outcome: str
    accuracy: float | None = None
    sops: float | None = None
    value: float | None = None
    error: str | None = None

    def line(self) -> str:
        return json.dumps({k: v for k, v in asdict(self).items() if v is not None}, allow_nan=False) + "\n"


_TRIAL = TypeAdapter(Trial)


def read_journal(path: Path) -> list[Trial]:
    """The trials of a journal; an incomplete last line is removed from the file, and its trial runs again."""
    if not path.is_file():
        return []
    lines = files.read_bytes(path).splitlines(keepends=True)
    trials: list[Trial] = []
    for number, line in enumerate(lines):
        try:
            trials.append(_parse(line, number))
        except (ValueError, TypeError, RecursionError) as error:
            if number + 1 < len(lines):
                where = f"{path}: line {number + 1}"
                raise InputError(f"{where} is damaged ({error}); truncate the file before it") from error
            os.truncate(path, sum(map(len, lines[:-1])))
    return trials


def _parse(line: bytes, number: int) -> Trial:
    """A line of the journal; ValueError or TypeError if it is incomplete or not of trial `number`."""
    if not line.endswith(b"\n"):
        raise ValueError("it is incomplete")
    try:
        trial = _TRIAL.validate_json(line)
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(": ".join([*map(str, first["loc"]), first["msg"]])) from error
    if trial.id != number:
        raise ValueError(f"it is of trial {trial.id}")
    if trial.outcome not in (FINISHED, STOPPED, FAILED):
        raise ValueError("its outcome is unknown")
    if trial.outcome != FAILED and None in (trial.accuracy, trial.value):
        raise ValueError("its accuracy or its value is missing")
    if not all(0 <= accuracy <= 1 for accuracy in trial.epochs):
        raise ValueError("an accuracy is not between 0 and 1")
    ended = trial.epochs[-1:] if trial.outcome == STOPPED else trial.epochs
    if trial.outcome != FAILED and trial.accuracy not in ended:
        raise ValueError("none of its epochs has its accuracy")
    return trial


def best_of(trials: Sequence[Trial]) -> Trial:
    """The finished trial of the largest value, among equal ones of the fewest SOPs, and of these the first.

    Raises InputError if none has finished.

    >>> best_of([Trial(i, {}, [0.9], "finished", 0.9, sops, 0.9) for i, sops in enumerate((12_829.0, 1_566.0))]).id
    1
    """
    finished = [trial for trial in trials if trial.outcome == FINISHED]
    if not finished:
        why = next((f"; trial {t.id}: {t.error}" for t in trials if t.error), "")
        none = f"none of {len(trials)} trials finished" if len(trials) > 1 else "its only trial did not finish"
        raise InputError(f"search: {none}{why}; change the space or the training")
    return min(finished, key=lambda trial: (-value_of(trial), trial.sops or 0.0, trial.id))


def note(trials: Sequence[Trial]) -> str:
    """The best trial so far, in a few words."""
    finished = [trial for trial in trials if trial.outcome == FINISHED]
    if not finished:
        return ""
    best = best_of(finished)
    return f"best {value_of(best):.4f} (trial {best.id}, validation accuracy {best.accuracy:.3f})"


def beside_given(trials: Sequence[Trial]) -> str:
    """The best trial beside the network as given, trial 0, in a sentence; both on validation windows.

    >>> given, other = (Trial(i, {}, [x], "finished", x, sops, x) for i, x, sops in ((0, 0.8, 5e3), (1, 0.9, 4e3)))
    >>> beside_given([given, other])
    'validation accuracy 90.0 %, 4,000 SOPs per window; the network as given (trial 0) has 80.0 %, 5,000 SOPs'
    """
    best, given = best_of(trials), trials[0]
    if best is given:
        return f"no trial of {len(trials)} is better than the network as given (trial 0)"
    sops = synops.in_words(best.sops) + ("" if best.sops is None else " per window")
    shown = f"validation accuracy {_percent(best)}, {sops}; the network as given (trial 0)"
    if given.outcome == FAILED:
        return f"{shown} cannot be trained"
    return f"{shown} has {_percent(given)}, {synops.in_words(given.sops)}"


def _percent(trial: Trial) -> str:
    return f"{100 * (trial.accuracy or 0):.1f} %"


def value_of(trial: Trial) -> float:
    """The value that the tuner received; InputError if there is none."""
    if trial.value is None:
        raise InputError(f"journal: trial {trial.id} has no value; truncate the file before its line")
    return trial.value
