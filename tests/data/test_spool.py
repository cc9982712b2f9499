"""Signals in a temporary file come back as they went."""

from io import FileIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from neurotact.data import spool
from neurotact.data.spool import Spool
from neurotact.errors import InputError


@given(st.lists(st.integers(0, 5).flatmap(lambda n: hnp.arrays(np.float32, (n, 2))), max_size=5), st.booleans())
def test_signals_come_back(signals, on_disk):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spool, "IN_MEMORY_BYTES", 1 if on_disk else 10**6)
        found = Spool(signals)
    assert found.lengths == [len(signal) for signal in signals]
    for _ in range(2):
        for one, other in zip(found, signals, strict=True):
            np.testing.assert_array_equal(one, other, strict=True)
    assert [len(x) for x in found[1:]] == found.lengths[1:]


def test_a_full_disk_is_named(monkeypatch):
    monkeypatch.setattr(spool, "IN_MEMORY_BYTES", 1)
    monkeypatch.setattr(spool.tempfile, "SpooledTemporaryFile", lambda _: FileIO("/dev/full", "wb"))
    with pytest.raises(
        InputError, match=r"cannot hold the signals .*No space left on device.*; free space there or name"
    ):
        Spool([np.ones((3, 2), np.float32)])
