"""None of these, for a network that is trained already: the least lead is chosen anew, and nothing is trained."""

from pathlib import Path

from neurotact import files
from neurotact.lazily import lazily
from neurotact.progress import Tell, untold
from neurotact.spec import build

with lazily():
    from neurotact.networks.exit.refusal import Refusal
    from neurotact.networks.training import run_folder, tasks, trainer


def refuse(
    run: str | Path, share: float | None, *, spikes: str | Path | None = None, tell: Tell = untold
) -> "Refusal | None":
    """Let a trained network refuse touches that are none of its classes, as `train(refuse=share)` does.

    run: its folder, whose `network.json` is changed; `result.json` is that of the training. share: of known touches
    that may be refused; None: refuse none, as without it. spikes: its file of spikes, if they were moved.
    tell: called with what is refused.
    Returns the least leads with the `interval` of the share of new known touches that is refused.
    Raises InputError for spikes that are not those of the training, and for a class that is called none.

    >>> found = nt.refuse("run", 0.5)
    >>> found.share, nt.refuse("run", None) is None
    (0.5, True)
    """
    folder = Path(run)
    with files.locked(folder):
        restored = run_folder.restore(folder, spikes=spikes)
        task = build(tasks.Task, {**restored.task.model_dump(), "refuse": share}, source="refuse")
        trains = run_folder.trained_spikes_of(restored)
        tasks.check_refuse(trains, task)
        found = trainer.refusal_of(restored.network, restored.rule, tasks.sides_of(trains, task).validation, task)
        table = files.read_json(folder / run_folder.NETWORK)
        extra = {key: value for key, value in table["extra"].items() if key != "refusal"}
        extra |= {"task": task.model_dump(mode="json"), **({} if found is None else {"refusal": found._asdict()})}
        files.write_json(folder / run_folder.NETWORK, {**table, "extra": extra})
    if found is not None:
        tell(found.in_words)
    return found
