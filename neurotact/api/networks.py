"""Networks: train one, decide with one, count what it costs."""

from pathlib import Path
from typing import Any

from neurotact import effects, files, spec
from neurotact.api.arguments import (
    Conditions,
    LeftOut,
    Settings,
    Tell,
    check_instance,
    silent,
)  # fmt: skip
from neurotact.data import hdf5
from neurotact.data.conditioning import acausal_note
from neurotact.data.copies import copies_of
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Splits, check_each
from neurotact.data.trial_choice import TrialChoice, chosen_trials
from neurotact.data.windows import WindowSpec
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.metrics import synops
from neurotact.metrics.prices import DEFAULT, PriceList, price_list
from neurotact.networks.definition.learned import LearnSpec
from neurotact.networks.definition.specs import RSNNSpec, given_keys
from neurotact.spec import takes_specs
from neurotact.tables import write_table

with lazily():
    import pandas as pd

    from neurotact.networks.definition import native
    from neurotact.networks.definition import network as definition
    from neurotact.networks.training import cautions, cross_validation, outcome, resumable, run_folder, tasks
    from neurotact.networks.use import fitted, inference, ledger


REPEATED = ["folder", "accuracy_validation", "accuracy_test", "baseline", "sops_total", "exit_steps"]
COSTS = ["name", "macs", "acs", "parameters", "signal_ms", "energy_estimate_nJ", "prices"]
"""The columns of tables that are told; the files hold all of them."""


@takes_specs
def train(
    spikes: str | Path,
    folder: str | Path,
    network: str | Path | RSNNSpec = "default",
    settings: Settings | None = None,
    *,
    window: WindowSpec = WindowSpec(),
    where: Conditions | None = None,
    leave_out: LeftOut = None,
    split: Splits = Splits(),
    augmentation: str | None = None,
    learn: LearnSpec = LearnSpec(),
    exit_tolerance: float = 0.01,
    seed: int = 0,
    device: str = "cpu",
    resume: bool = False,
    force: bool = False,
    tell: Tell = silent,
) -> dict[str, Any]:
    """Train a network on windows of a file of spikes and save it in `folder`, as `neurotact train` does.

    Returns what it came to: `accuracy_test` with its 95 % interval (`low`, `high`, over `trials` test trials);
    `chance`, `commonest` and `baseline_accuracy` (of `baseline`, the best of eight classifiers on the same spikes) to
    compare it with; SOPs and steps, also with early exit (`exit_...`); and `cautions`, the list of what may be wrong.
    Where the split has turns, one network is trained for each, in a folder of its own: then the means
    `accuracy_test` (`low`, `high`; NaN for fewer than three splits), `baseline_accuracy` and `sops_total`, `cautions`,
    and `splits`, a table with a row per split.

    network: a spec, or the name or path of one. settings: changes of it, dotted keys.
    window: how trials are cut, as for `windows`. split: how they are divided, such as
        `nt.Split(test_where={"speed": 450})`, also several times in turn: into folds, with each value of a condition
        left out, with several seeds.
    where, leave_out: the trials that are used at all, as of `read`.
    augmentation: which varied copies of training trials are trained on, too, of those in the file (see `encode`); None
        takes them if there is one kind, "none" leaves them out.
    learn: what is learned of a window: its class or, as `nt.Learn(target="force_N")`, numbers, or none of the classes
        (`nt.Learn(refuse=0.05)`), and which windows count the same: `nt.Learn(balance="classes")` weights training
        windows so that each class does in the loss, "conditions" so that each value of the split's conditions (to test,
        to group by, to stratify) does within a class, too. Of numbers, accuracies are scores: 1 less the squared error
        in units of the deviation in training; and there are `rmse_NAME`, `mae_NAME` and `r2_NAME` of each target.
    exit_tolerance: validation accuracy that early exit may lose.
    seed: of the weights and of the order of windows. device: a torch device.
    resume: go on with a training that was interrupted. force: replace one that is in the folder.
    tell: called with what the command prints.
    The spikes stay in their file, by whose content `resume` knows them; `save` writes one.
    Raises InputError for a folder that is not free, for spikes that cannot be used and for unknown keys; `Interrupted`,
    a KeyboardInterrupt with the number of saved `epochs`, on Ctrl-C.

    >>> settings = {"hidden": 4, "training.epochs": 2}
    >>> found = nt.train("spikes.h5", "felt-or-silk", "rsnn", settings, window=nt.Window(length_ms=50))
    >>> 0 <= found["low"] <= found["accuracy_test"] <= found["high"] <= 1
    True
    """
    what, given = spec.resolve(RSNNSpec, network, settings), given_keys(network, settings)
    trains, task = tasks.of_file("train", spikes, window, split, exit_tolerance, where, leave_out, learn, what)
    kind = tasks.kind_of_copies(trains, augmentation, tell)
    task = spec.build(tasks.Task, {**task.model_dump(), "augmentation": kind}, source="train")
    tasks.check_refuse(trains, task)
    path, spikes = Path(folder), Path(spikes)
    native.device_of(device)
    options = {"given": given, "seed": seed, "device": device, "force": force, "resume": resume, "tell": tell}
    if split.is_in_turn:
        splits = cross_validation.tasks_of(task, split, trains.conditions)
        tests = [one.split.test_where for one in splits.values() if one.split.seed == task.split.seed]
        for line in check_each(trains.conditions, tests, task.split, copies_of(trains).first):
            tell(line)
        return _of_repeated(cross_validation.run(spikes, path, what, splits, **options), path, trains, split, tell)
    done = resumable.run(spikes, path, what, task, **options)
    if done is None:
        tell(f"{path}: this training is done already; its result is in {path / resumable.RESULT}")
    else:
        for line in (*done.lines(), resumable.saved_in(path)):
            tell(line)
    return result(path)


def _of_repeated(
    repeats: "cross_validation.Repeated", folder: Path, trains: SpikeTrains, split: Splits, tell: Tell
) -> dict[str, Any]:
    """What several trainings came to."""
    turns = {"leave_out_each": [*split.leave_out_each], "folds": split.every_fold and split.folds}
    key, value = next(((key, value) for key, value in turns.items() if value), ("repeats", split.repeats))
    each = f"split=nt.Split({key}={value})"
    tell(repeats.table[REPEATED])
    tell(f"{folder / cross_validation.TABLE}: {cross_validation.line(repeats)}")
    return {
        "accuracy_test": repeats.accuracy.mean, "low": repeats.accuracy.low, "high": repeats.accuracy.high,
        "baseline_accuracy": repeats.table["baseline"].mean(), "sops_total": repeats.table["sops_total"].mean(),
        "splits": repeats.table, "cautions": [
            *cautions.copies(len(copies_of(trains).trials), len(trains)), *cautions.calibrated(trains.encoder, each),
        ],
    }  # fmt: skip


def result(run: str | Path) -> dict[str, Any]:
    """What the training in the run folder `run` came to, as `train` returns it.

    Raises InputError where there is none.

    >>> sorted(nt.result("run"))[:3]
    ['accuracy_test', 'accuracy_validation', 'baseline']
    """
    return outcome.summary_of(files.read_json(Path(run) / resumable.RESULT))


def infer(
    run: "fitted.Fitted",
    spikes: SpikeTrains | str | Path,
    *,
    early_exit: bool = False,
    test_only: bool = False,
    where: Conditions | None = None,
    leave_out: LeftOut = None,
    allow_other_encoder: bool = False,
    device: str = "cpu",
    out: str | Path | None = None,
    force: bool = False,
    tell: Tell = silent,
) -> "pd.DataFrame":
    """Decide every window of spike trains, or of a file of them, with the network in the run folder `run`.

    run: the folder, or a fitted `SpikingClassifier` or a pipeline that ends in one, whose windows are cut as those that
    it was fitted on; it does not know the trials of these (side "unknown").
    One row per window, with its spikes and SOPs. Columns: trial, side (training, validation, test, unseen), label,
    predicted, steps, input_spikes, hidden_spikes and sops_*. Of a detector one row per mark and per detection: trial,
    label, start_s, stop_s, detected_s, ended_s, delay_ms, outcome and side. `summarise` gives their means.
    early_exit: stop where the validated rule says so. test_only: the network's own test trials alone.
    where, leave_out: the trials to decide, as of `read`; they are numbered anew in the column trial.
    device: a torch device. out: a file to write (.csv, .json, .md, .tex); one that exists is refused unless `force`.
    tell: called with a note where windows know samples after them.
    Raises InputError for spikes of another encoder, unless `allow_other_encoder`.

    >>> table = nt.infer("run", "spikes.h5")
    >>> table.columns[:5].tolist()
    ['trial', 'side', 'label', 'predicted', 'steps']
    """
    effects.check(force=force, out=out)
    is_file = isinstance(spikes, (str, Path))
    if out:
        of_run = [] if fitted.is_in_memory(run) else run_folder.files_of(str(run))
        files.check_new(out, force=force, inputs=[*of_run, *([spikes] if is_file else [])])
    restored = fitted.restore(run, device=str(native.device_of(device)))
    if test_only and fitted.is_in_memory(run):
        raise InputError("test_only: an estimator does not know its test trials; give the spikes of these alone")
    trains = hdf5.load_spikes(spikes) if is_file else spikes
    check_instance("spikes", trains, SpikeTrains, "nt.encode and nt.load return them")
    trains = chosen_trials(trains, TrialChoice.of(where, leave_out), str(spikes) if is_file else "spikes")
    table = inference.infer(
        restored, trains, early_exit=early_exit, test_only=test_only, allow_other_encoder=allow_other_encoder
    )
    if out:
        write_table(table, out)
    _tell_note(trains, tell)
    return table


def _tell_note(trains: SpikeTrains, tell: Tell) -> None:
    if note := acausal_note(trains.encoder):
        tell(note)


def sops(
    run: str | Path,
    out: str | Path,
    *,
    spikes: str | Path | None = None,
    early_exit: bool = False,
    allow_other_encoder: bool = False,
    prices: str | Path | PriceList = DEFAULT,
    force: bool = False,
    tell: Tell = silent,
) -> "pd.DataFrame":
    """Write the synaptic operations of each test window of a run to `out` (.csv, .json, .md, .tex); returns the rows.

    spikes: that the run was trained on, where they moved since. early_exit: count with early exit. prices: name or
        path of the price list by which energy is estimated. force: replace a file.
    tell: called with what `neurotact sops` prints beside the means. Columns as of `infer`.
    Raises InputError for a file that exists, and for spikes of another encoder, unless `allow_other_encoder`.

    >>> nt.sops("run", "sops.csv")["side"].unique().tolist()
    ['test']
    """
    why = "whose test windows it counts (SpikingClassifier.sops counts those of any windows)"
    fitted.check_folder(run, "sops", why)
    run, out = Path(run), Path(out)
    files.check_new(out, force=force, inputs=[*run_folder.files_of(run), spikes])
    priced = price_list(prices)
    restored = run_folder.restore(run, spikes=spikes)
    files.check_new(out, force=force, inputs=[restored.spikes_path])
    trains = run_folder.load_spikes_of(restored)
    table = inference.infer(
        restored, trains, early_exit=early_exit, test_only=True, allow_other_encoder=allow_other_encoder
    )
    means = summarise(table)
    what = f"{run.resolve().name}, {'early exit' if early_exit else 'full window'}"
    write_table(table, out, about=synops.summary_markdown(means, what))
    _tell_note(trains, tell)
    tell(f"saved in {out}, a row per window")
    network = restored.network
    sizes = len(trains.afferents), network.n_classes
    made_by = {"encoder": trains.encoder or None, "recorded_Hz": trains.recorded_Hz, "synapses": network.synapses}
    costs = ledger.decision_ledger(network.spec, *sizes, trains.sampling_rate_Hz, means, **made_by, prices=priced)
    shown = costs[COSTS].astype(object)
    tell(shown.where(shown.notna(), "not counted"))
    alone = costs.set_index("name")["energy_estimate_nJ"]
    if {"encoder", "both"} <= {*alone.index} and alone["both"] > 1.001 * (alone["encoder"] + alone["network"]):
        tell("both lie in one memory, where an access takes more energy than in two smaller ones")
    return table


def summarise(decisions: "pd.DataFrame") -> "pd.DataFrame":
    """Means of what `infer` or `sops` returned, for each side and class, and for `all` windows of a side.

    Columns: side, label, windows (how many), accuracy, and the means of steps, spikes and SOPs. Of a detector: side,
    label, outcome, events (how many) and the mean of delay_ms.
    Raises InputError for a table without these columns.

    >>> nt.summarise(nt.infer("run", "spikes.h5"))["label"].tolist()[:3]
    ['felt', 'silk', 'all']
    """
    if "outcome" in decisions:
        groups = decisions.groupby(["side", "label", "outcome"], sort=False)
        return groups.agg(events=("trial", "size"), delay_ms=("delay_ms", "mean")).reset_index()
    return synops.summary(decisions)


def save_network(network: "definition.Network", folder: str | Path, *, force: bool = False) -> None:
    """Save a network as safetensors and JSON in `folder`; an existing network is refused unless `force`.

    >>> nt.save_network(nt.RSNN(16, 8, hidden=20, sampling_rate_Hz=2000.0), "network")
    >>> sorted(path.name for path in Path("network").iterdir())
    ['network.json', 'weights.safetensors']
    """
    check_instance("network", network, definition.Network, "a SpikingClassifier has one in network_")
    files.check_new(Path(folder) / run_folder.NETWORK, force=force)
    run_folder.save_network(network, folder)


def load_network(folder: str | Path) -> "definition.Network":
    """The network in a folder that `save_network`, `train` or the command line wrote.

    >>> nt.load_network("run").n_inputs
    4
    """
    return run_folder.load_network(folder)[0]
