"""Proposals of a hyperparameter search: ask for networks to try, tell their results.

NNI's own tuners (TPE, random, grid) and its median-stop assessor run in this process, without a server. One seed gives
the same proposals every time: the spec sets the size of batches, and results are reported in the order of proposals.
"""

import logging
import math
import platform
import warnings
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any, NamedTuple

from neurotact.errors import InputError
from neurotact.networks.definition.space import SearchSpec, Space, tidy


class Proposal(NamedTuple):
    """A trial to run: its number, counted from 0, and the network's keys that it changes."""

    id: int
    parameters: dict[str, Any]


class MedianStop:
    """NNI's median-stop rule, over the trials that have finished; it can be sent to another process.

    >>> rule = MedianStop(start_epoch=2)
    >>> rule.end(0, [0.6, 0.8], finished=True)
    >>> rule.stops(1, [0.1]), rule.stops(1, [0.1, 0.2]), rule.stops(2, [0.1, 0.9])
    (False, True, False)
    """

    def __init__(self, start_epoch: int) -> None:
        self._start_epoch = start_epoch
        self._assessor = _nni().MedianstopAssessor("maximize", start_epoch)

    def stops(self, trial: int, values: Sequence[float]) -> bool:
        """Whether the trial ends after these epochs."""
        return self._assessor.assess_trial(trial, list(values)) is _nni().AssessResult.Bad

    def end(self, trial: int, values: Sequence[float], *, finished: bool) -> None:
        """Record the end of a trial; later trials are compared only with finished ones."""
        if values:
            self._assessor.assess_trial(trial, list(values))
            self._assessor.trial_end(trial, finished)

    def __getstate__(self) -> dict[str, Any]:
        return {"start_epoch": self._start_epoch, "assessor": vars(self._assessor)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["start_epoch"])
        vars(self._assessor).update(state["assessor"])


class Tuner:
    """Proposes trials in batches; call `tell` or `fail` for each, in the order of ids, before the next batch.

    >>> space = {"hidden": {"_type": "choice", "_value": [20, 30]}}
    >>> tuner = Tuner(SearchSpec(space=space, trials=10, batch=1))
    >>> while batch := tuner.ask():
    ...     for trial in batch:
    ...         tuner.tell(trial.id, value=trial.parameters["hidden"] / 100)
    >>> tuner.asked  # and there is nothing more to try
    2
    """

    def __init__(self, spec: SearchSpec) -> None:
        self.spec = spec
        self.asked = 0
        self.median_stop = MedianStop(spec.start_epoch) if spec.assessor == "median-stop" else None
        self._open: list[Proposal] = []
        self._tuner = _tuner(spec)

    def ask(self) -> list[Proposal]:
        """The next batch; empty when all trials are used or the space holds no other point."""
        if self._open:
            raise InputError(f"trial {self._open[0].id}: has no result yet; tell or fail it before asking for more")
        for number in range(self.asked, min(self.asked + self.spec.batch, self.spec.trials)):
            if self._is_given(number):
                self._open.append(Proposal(number, dict(self.spec.first or {})))
                continue
            try:
                proposed = self._tuner.generate_parameters(number)
            except _nni().NoMoreTrialError:
                break
            self._open.append(Proposal(number, {key: tidy(self.spec.space[key], v) for key, v in proposed.items()}))
        self.asked += len(self._open)
        return list(self._open)

    def tell(self, trial: int, value: float, epochs: Sequence[float] = (), *, stopped: bool = False) -> None:
        """Report the `value` of a trial, the higher the better; `epochs`: what the median-stop rule saw of it.

        Raises InputError if the value is not finite, or if it is not the turn of this trial.
        """
        if not math.isfinite(value):
            raise InputError(f"trial {trial}: its value must be finite; got {value}; fail the trial instead")
        parameters = self._close(trial, epochs, finished=not stopped)
        if not self._is_given(trial):
            self._tuner.receive_trial_result(trial, parameters, value)
            self._tuner.trial_end(trial, True)

    def fail(self, trial: int, epochs: Sequence[float] = ()) -> None:
        """Report that a trial has no value; the tuner learns nothing from it."""
        self._close(trial, epochs, finished=False)
        if not self._is_given(trial):
            self._tuner.trial_end(trial, False)

    def _is_given(self, trial: int) -> bool:
        """Whether a trial is the one that the spec gives; NNI, which did not propose it, cannot learn from it."""
        return trial == 0 and self.spec.first is not None

    def _close(self, trial: int, epochs: Sequence[float], *, finished: bool) -> dict[str, Any]:
        if not self._open or self._open[0].id != trial:
            turn = f"it is the turn of trial {self._open[0].id}" if self._open else "ask for trials first"
            raise InputError(f"trial {trial}: cannot be reported now; {turn}")
        if self.median_stop:
            self.median_stop.end(trial, epochs, finished=finished)
        return self._open.pop(0).parameters


FEW_RESULTS = {"n_startup_jobs": 0, "prior_weight": 0.2, "gamma": 0.5, "n_ei_candidates": 1}
"""NNI's arguments of TPE in `proposed`. Of several candidates it would take the least known value of each key."""


def proposed(space: Space, known: Sequence[tuple[Mapping[str, Any], float]], n: int, seed: int) -> list[dict[str, Any]]:
    """Points that TPE proposes from results of any origin, at most `n`; none of them is known.

    known: points of the space and their values, the higher the better. Each key has, at random, a value of the best
    points or, more rarely, any other: of many keys a proposal changes few, as little can be learned from few results.

    >>> space = {"hidden": {"_type": "choice", "_value": [20, 30, 50]}}
    >>> len(proposed(space, [({"hidden": 20}, 0.9), ({"hidden": 30}, 0.8)], 4, seed=0))
    1
    """
    tuner, found = _nni().TpeTuner("maximize", seed, FEW_RESULTS), []
    tuner.update_search_space({key: _ordered(dict(dimension)) for key, dimension in space.items()})
    tuner.import_data([{"parameter": dict(point), "value": value} for point, value in known])
    for number in range(n):
        try:
            point = tuner.generate_parameters(number)
        except _nni().NoMoreTrialError:
            break
        found.append({key: tidy(space[key], value) for key, value in point.items()})
    return found


@cache
def _nni() -> SimpleNamespace:
    """The parts of NNI that are used, imported when a search starts, because this takes a second.

    On import, NNI warns about its own dependencies, and its loggers print to stdout.
    Raises InputError if it is not installed: it has no wheel for Linux aarch64 and macOS arm64.
    """
    if find_spec("nni") is None:
        raise InputError(
            "search: NNI is not installed (it has no wheel for this machine: "
            f"{platform.system()} {platform.machine()}); search on Linux or Windows x86-64; everything else works here"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import nni
        from nni.algorithms.hpo.gridsearch_tuner import GridSearchTuner
        from nni.algorithms.hpo.medianstop_assessor import MedianstopAssessor
        from nni.algorithms.hpo.random_tuner import RandomTuner
        from nni.algorithms.hpo.tpe_tuner import TpeTuner
        from nni.assessor import AssessResult
    nni.silence_stdout()
    for name in ("nni", "medianstop_Assessor"):
        logging.getLogger(name).setLevel(logging.ERROR)
    return SimpleNamespace(
        AssessResult=AssessResult,
        GridSearchTuner=GridSearchTuner,
        MedianstopAssessor=MedianstopAssessor,
        NoMoreTrialError=nni.NoMoreTrialError,
        RandomTuner=RandomTuner,
        TpeTuner=TpeTuner,
    )


def _tuner(spec: SearchSpec) -> Any:
    """NNI's tuner, with its space."""
    nni = _nni()
    space = {key: dict(dimension) for key, dimension in spec.space.items()}
    if spec.tuner == "tpe":
        tuner = nni.TpeTuner("maximize", spec.seed)
        space = {key: _ordered(dimension) for key, dimension in space.items()}
    else:
        tuner = nni.RandomTuner(spec.seed) if spec.tuner == "random" else nni.GridSearchTuner()
    tuner.update_search_space(space)
    return tuner


def _ordered(dimension: dict[str, Any]) -> dict[str, Any]:
    """A randint as a rounded range of numbers, which keeps its order; TPE treats a randint as unordered choices."""
    if dimension["_type"] != "randint":
        return dimension
    lower, upper = dimension["_value"]
    # Half a step on both sides gives the ends as much room as the numbers between them.
    return {"_type": "quniform", "_value": [lower - 0.4999, upper - 1 + 0.4999, 1]}
