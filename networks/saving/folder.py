"""The points of a search as run folders, with what their decisions on test windows are and cost."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from neurotact_parts.exporters.c.measured import in_integers
from neurotact_parts.networks.saving.choice import Chosen, Found, in_words, interval
from neurotact_parts.networks.saving.proposals import Asked, keeps
from neurotact_parts.networks.saving.start import Start
from neurotact_parts.networks.saving.trial import EARLY, Job, fitted_of
from neurotact_parts.studies.comparison.saving import Fitted

from neurotact import files, workers
from neurotact.data import hdf5
from neurotact.data.copies import copies_of
from neurotact.metrics.paired import by_trial, compare_by_trial
from neurotact.networks.exit.rule import FULL_WINDOW
from neurotact.networks.training import resumable, run_folder, tasks, trainer
from neurotact.networks.training.outcome import outcome_of
from neurotact.networks.training.trainer import Trained
from neurotact.networks.use import measuring
from neurotact.spec import to_toml


def write(found: Found, start: Start, asked: Asked, folder: Path) -> list[dict[str, Any]]:
    """Write each point as a run folder, `1`, `2` and so on; what each one is and does, beside the run.

    Its spikes, and the encoder that makes them, are beside it: points with one encoder share the file.
    """
    rights = _right(start.base, FULL_WINDOW, start)
    spikes: dict[str, Path] = {}
    rows = []
    for number, point in enumerate(found.points, 1):
        place = folder / str(number)
        with workers.one_thread():  # as in the search, to be the same network to the last bit
            fitted = fitted_of(Job(point.trial.id, point.trial.point, point.trial.member), start)
        task = start.bench.task.model_copy(update={"window": window_of(fitted, start)})
        done = trainer.finished(fitted.network, fitted.training, fitted.sides, task)
        path = _spikes_of(fitted, folder, spikes)
        _save(done, fitted, task, path, start, place)
        rule = done.held.used if point.how == EARLY and done.held is not None else FULL_WINDOW
        rows.append(
            {
                "folder": str(number),
                "spikes": path.name,
                **_row(point, found, asked),
                **_tested(rights, _right(fitted, rule, start)),
                "integers": in_integers(fitted.network, fitted.sides)[0],
            }
        )
    return rows


def window_of(fitted: Fitted, start: Start) -> Any:
    """The windows of a network, which are as far apart as those of the run."""
    window = start.bench.window
    length_ms = float(f"{1e3 * fitted.sides.test.spikes.shape[1] / fitted.trains.sampling_rate_Hz:.9g}")
    return window.model_copy(update={"length_ms": length_ms, "hop_ms": window.hop_ms or window.length_ms})


def _save(done: Trained, fitted: Fitted, task: Any, spikes: Path, start: Start, place: Path) -> None:
    outcome = outcome_of(done, fitted.sides, fitted.trains, task, "fine-tune")
    resumable.clear(place)
    run_folder.save(done, place, fitted.trains, spikes, task, start.bench.split)
    files.write_json(place / resumable.RESULT, outcome.as_json())


def _spikes_of(fitted: Fitted, folder: Path, known: dict[str, Path]) -> Path:
    """The file of the spikes of a point; that of the run where nothing changed in them."""
    table = to_toml({key: value for key, value in fitted.trains.encoder.items() if value is not None})
    if table not in known:
        name = f"{len(known) + 1}"
        known[table] = folder / f"spikes-{name}.h5"
        hdf5.save_spikes(fitted.trains, known[table])
        if fitted.trains.encoder:
            files.write_text(folder / f"encoder-{name}.toml", table)
    return known[table]


def _right(fitted: Fitted, rule: Any, start: Start) -> dict[int, float]:
    """The share of the windows of each test trial that are decided correctly."""
    window = window_of(fitted, start)
    examples, windows = tasks.examples_of(fitted.trains, start.bench.split.test, start.bench.task, window)
    trial = copies_of(start.base.trains).first[windows.trial]
    return by_trial(trial, measuring.right_of(fitted.network.infer(examples.spikes, rule), examples))


def _tested(base: dict[int, float], mine: dict[int, float]) -> dict[str, float]:
    """What a point loses on test trials, with its 95 % interval, and the p of the paired test."""
    lost = np.array([base[trial] - mine[trial] for trial in sorted(base)])
    mean, low, high = interval(lost)
    found = compare_by_trial(base, mine)
    return {
        "accuracy_test_run": float(np.mean([*base.values()])), "accuracy_test": float(np.mean([*mine.values()])),
        "lost_test": mean, "lost_test_low": low, "lost_test_high": high, "p_test": found.p, "test_trials": len(lost),
    }  # fmt: skip


def _row(point: Chosen, found: Found, asked: Asked) -> dict[str, Any]:
    """A point in numbers, beside the run; costs are means over validation windows, of the network that is used."""
    lost = interval(found.base.mean.right - point.mean.right)
    base, mine = found.base.trial.decided[found.base.how], point.trial.decided[point.how]
    left = {
        name: mine[name] / base[name] if base[name] else float("nan")
        for name in base
        if not name.startswith("test_") and "accuracy" not in name
    }
    return {
        "setting": in_words(point.trial.about, found.base.trial.about, point.how),
        "decides": point.how,
        "accuracy_validation": point.mean.accuracy,
        "accuracy_validation_run": found.base.mean.accuracy,
        "was_judged": found.was_judged,
        "keeps": keeps(point.mean, found.base.mean, asked),
        **dict(zip(("lost_validation", "lost_validation_low", "lost_validation_high"), lost, strict=True)),
        "left": left,
        "costs": {name: mine[name] for name in left},
        "costs_run": {name: base[name] for name in left},
    }


def clear(folder: Path, names: Sequence[str]) -> None:
    """Remove earlier points of a search."""
    for path in [*folder.glob("spikes-*.h5"), *folder.glob("encoder-*.toml"), *(folder / name for name in names)]:
        path.unlink(missing_ok=True)
    for path in folder.iterdir():
        if path.is_dir() and path.name.isdigit():
            shutil.rmtree(path)
