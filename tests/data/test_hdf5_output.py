"""A disk that is full while HDF5 is written: one error, no crash, nothing lost of what the library reads back."""

import errno
import io
import subprocess
import sys
from importlib.util import find_spec

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.data.hdf5_output import Output, create

WRITES = st.lists(
    st.tuples(st.integers(0, 30_000), st.binary(min_size=1, max_size=9000)) | st.integers(0, 30_000), max_size=8
)
"""Places with what is written there, and lengths to cut the file to."""


class FullDisk(io.FileIO):
    """Takes `room` bytes, the last of them in a short write."""

    room = 0

    def write(self, data):
        if self.tell() >= self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(memoryview(data)[: self.room - self.tell()])


@given(writes=WRITES, room=st.integers(0, 50_000))
def test_what_was_written_is_read_back_whether_the_disk_took_it_or_not(tmp_path, writes, room):
    path, model = tmp_path / "a.bin", bytearray()
    with Output(path) as output:
        output._file.close()
        output._file = FullDisk(path, "w+b")
        output._file.room = room
        for what in writes:
            if isinstance(what, int):
                if output.error is None:
                    output.truncate(what)
                    model[:] = model[:what].ljust(what, b"\0")
                continue
            place, data = what
            output.seek(place)
            assert output.write(data) == len(data)
            model[:] = model.ljust(place, b"\0")
            model[place : place + len(data)] = data
        output.seek(0)
        assert output.read(len(model)) == model
        # What the disk did not take may by chance be the zeros that the file was lengthened by.
        assert output.error is not None or path.read_bytes() == bytes(model)
        if output.error is not None:
            with pytest.raises(OSError, match="No space left"):
                output.check()


def test_the_same_objects_are_written_as_through_the_default_driver(tmp_path):
    def fill(file: h5py.File) -> None:
        file["a/b"] = np.arange(10_000.0)
        file.attrs["kind"] = "felt"

    with create(tmp_path / "a.h5") as (file, _):
        fill(file)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        fill(file)
    with h5py.File(tmp_path / "a.h5") as one, h5py.File(tmp_path / "b.h5") as other:
        np.testing.assert_array_equal(one["a/b"], other["a/b"], strict=True)
        assert dict(one.attrs) == dict(other.attrs)


@pytest.mark.parametrize("at", [0, 1, 5, 20])
def test_an_interrupt_within_a_write_comes_out_and_leaves_the_library_usable(tmp_path, monkeypatch, at):
    calls = iter(range(10**9))
    write_to_disk = Output._write_to_disk

    def interrupted(self, view):
        if next(calls) == at:
            raise KeyboardInterrupt
        write_to_disk(self, view)

    monkeypatch.setattr(Output, "_write_to_disk", interrupted)

    def fill() -> None:
        with create(tmp_path / "a.h5") as (file, _):
            for i in range(20):
                file[f"values{i}"] = np.zeros(20_000)

    with pytest.raises(KeyboardInterrupt):
        fill()
    monkeypatch.undo()
    with create(tmp_path / "b.h5") as (file, _):
        file["values"] = np.ones(3)
    assert h5py.File(tmp_path / "b.h5")["values"][()].tolist() == [1, 1, 1]


FILL = """
import resource, sys
from pathlib import Path
import numpy as np, pandas as pd
import neurotact as nt
from neurotact.data.hdf5 import save_recordings, save_spikes
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import from_rasters
from neurotact.errors import InputError

folder, rng = Path(sys.argv[1]), np.random.default_rng(0)
table = pd.DataFrame({"label": ["felt", "silk"] * 20})
touch = Recordings([rng.normal(size=(500, 4)) for _ in range(40)], 1000.0, "mV", table)
names = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")
trains = from_rasters([rng.random((500, 4)) < 0.3 for _ in range(40)], 1000.0, names, table)
given = {"h5": (save_recordings, touch), "spikes": (save_spikes, trains)}
if "nir" in sys.argv:
    given["nir"] = nt.to_nir, nt.RSNN(40, 8, hidden=30, sampling_rate_Hz=1000.0)
if "pynwb" in sys.argv:
    from neurotact_parts.readers.nwb_output import to_nwb
    given["nwb"] = to_nwb, trains
for kind, (save, what) in given.items():
    whole = folder / "whole.h5"
    save(what, whole)
    size = whole.stat().st_size
    for limit in [0, 1, 100, 2048, 5000, *rng.integers(0, size, 6 if kind == "nwb" else 20).tolist(), size - 1]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        try:
            save(what, folder / "full.h5")
        except InputError as error:
            assert "full.h5: cannot be written (File too large); free space there" in str(error), error
        else:
            raise AssertionError(f"{limit} bytes of {size} were enough")
        assert [path.name for path in folder.iterdir()] == ["whole.h5"], list(folder.iterdir())
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    save(what, folder / "full.h5")
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    if kind == "nwb":  # each has its own random identifiers
        one, other = (nt.read("nwb", path) for path in (whole, folder / "full.h5"))
        assert all(map(np.array_equal, one.steps, other.steps))
        assert all(map(np.array_equal, one.units, other.units))
    else:
        assert (folder / "full.h5").read_bytes() == whole.read_bytes()
    (folder / "full.h5").unlink()
    whole.unlink()
print(*given)
"""


@pytest.mark.thorough
def test_a_full_disk_is_one_sentence_at_any_size(tmp_path):
    """In a process of its own: without the care taken, the library crashes it, if only at its end."""
    pytest.importorskip("resource")
    optional = [name for name in ("nir", "pynwb") if find_spec(name)]
    words = [sys.executable, "-c", FILL, str(tmp_path), *optional]
    found = subprocess.run(words, capture_output=True, text=True, timeout=300)
    written = ["h5", "spikes", *(name.removeprefix("py") for name in optional)]
    assert (found.returncode, found.stdout.split(), found.stderr) == (0, written, "")


def test_the_place_can_be_found_from_each_end(tmp_path):
    with Output(tmp_path / "a.bin") as output:
        output.write(b"felt")
        assert output.seek(-1, io.SEEK_END) == 3
        assert output.seek(-2, io.SEEK_CUR) == 1
        assert output.read() == b"elt"
        assert output.tell() == 4
