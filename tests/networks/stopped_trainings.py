"""Trainings in a folder that are stopped after an epoch, as by Ctrl-C."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from neurotact.networks.training import resumable
from neurotact.networks.training.resumable import Interrupted


@contextmanager
def stopped_after(n_epochs: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Interrupt the training in the block after so many epochs of all its networks, which are saved."""
    keep = resumable._CheckpointWriter.keep

    def stopped(writer, latest):
        keep(writer, latest)
        if len(latest.epochs) == n_epochs:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(resumable._CheckpointWriter, "keep", stopped)
        with pytest.raises(Interrupted) as raised:
            yield
    assert raised.value.epochs == n_epochs
