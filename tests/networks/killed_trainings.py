"""Kill a training before each step of its writing in turn, go on with it, and compare what it leaves.

    python killed_trainings.py SPIKES FOLDER nothing|done|interrupted

The last word says what another training left in the folder, which this one replaces by force. Prints how many steps
there were, and how often the other training was still there, untouched. Every training runs in a process forked
from this one, which never runs a kernel itself.
"""

import os
import shutil
import signal
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import torch._dynamo  # noqa: F401 - the first optimiser of each child would import it

from neurotact.files import DRAFT, LOCK
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import resumable
from neurotact.networks.training.tasks import Task

NETWORK = RSNNSpec(hidden=6, training=TrainingSpec(epochs=3, batch=8))
TASK = Task(window={"length_ms": 40})
STEPS = ((Path, "touch"), (Path, "replace"), (Path, "unlink"), (os, "ftruncate"))
"""How files are begun, renamed, removed and locked."""


def train(spikes: Path, folder: Path, **options) -> None:
    resumable.track = lambda *_, **__: nullcontext(lambda *_: None)
    resumable.SECONDS_BETWEEN = 0.0
    resumable.run(spikes, folder, NETWORK, TASK, **options)


def kill_before(step: int) -> None:
    """Have this process killed before it takes so many steps."""
    left = step

    def counted(call: Callable) -> Callable:
        def counting(*args, **kwargs):
            nonlocal left
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            left -= 1
            return call(*args, **kwargs)

        return counting

    for owner, name in STEPS:
        setattr(owner, name, counted(getattr(owner, name)))


def in_a_child(*work: Callable[[], None]) -> bool:
    """Whether a child lives to the end of the work."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1] == 0
    for part in work:
        part()
    os._exit(0)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def without_traces(found: dict[str, bytes]) -> dict[str, bytes]:
    """Without what a killed process may leave until the next one comes."""
    return {name: content for name, content in found.items() if name != LOCK and not name.startswith(DRAFT)}


def main(spikes: Path, base: Path, before: str) -> None:
    whole, other = base / "whole", base / "other"
    assert in_a_child(lambda: train(spikes, whole))
    if before != "nothing":
        assert in_a_child(lambda: train(spikes, other, seed=7))
    if before == "interrupted":
        (other / resumable.RESULT).rename(other / resumable.CHECKPOINT)
    step = untouched = 0
    while True:
        folder = base / str(step)
        if other.exists():
            shutil.copytree(other, folder)
        force = other.exists()
        if in_a_child(lambda: kill_before(step), lambda: train(spikes, folder, force=force)):  # noqa: B023 - done here
            break
        if other.exists() and without_traces(contents(folder)) == contents(other):
            untouched += 1
        else:
            assert in_a_child(lambda: train(spikes, folder, resume=True)), f"step {step}"  # noqa: B023 - done here
            assert contents(folder) == contents(whole), f"step {step}: {sorted(contents(folder))}"
        step += 1
    assert contents(folder) == contents(whole)
    print(step, untouched)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
