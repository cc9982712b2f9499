"""A stream that is saved and loaded in the middle decides as one that ran through; other files are refused."""

import json

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import ADAPTING, READOUTS, make_chain, make_signal
from neurotact_parts.streams.stream import Stream
from safetensors import safe_open
from test_stream import CONDITIONINGS, MEMBRANES, WINDOWS

from neurotact.backend import native
from neurotact.errors import InputError

BACKENDS = ["reference", *(["native"] if native else [])]


@given(
    seed=st.integers(0, 50),
    at=st.integers(0, 200),
    conditioning=st.sampled_from(CONDITIONINGS),
    rate_Hz=st.sampled_from([None, 700.0, 1700.0]),
    windows=st.sampled_from(WINDOWS),
    kind=st.sampled_from(MEMBRANES),
    readout=st.sampled_from([*READOUTS]),
    adapting=st.sampled_from([{}, ADAPTING]),
    step_ms=st.sampled_from([None, 3.0]),
    backends=st.tuples(st.sampled_from(BACKENDS), st.sampled_from(BACKENDS)),
)
@examples(25)
def test_a_saved_stream_goes_on_as_if_nothing_had_happened(
    tmp_path, seed, at, conditioning, rate_Hz, windows, kind, readout, adapting, step_ms, backends
):
    conditioning = conditioning | ({} if rate_Hz is None else {"resample_Hz": 1000.0})
    settings = {"rate_Hz": rate_Hz or 1000.0, "windows": windows, "patience": 4, "seed": seed}
    network = {"membrane": kind[0], "reset": kind[1], "step_ms": step_ms, **adapting}
    chain = make_chain(conditioning, readout=readout, **network, **settings)
    signal = make_signal(260, seed=seed)
    signal[at // 2] = np.nan
    whole = Stream(chain, backend="reference")
    due = [*whole.push(signal), *whole.finish()]
    first, second = (Stream(chain, backend=each) for each in backends)
    told = first.push(signal[:at])
    first.save(tmp_path / "state", force=True)
    second.push(signal[:7])
    second.load(tmp_path / "state")
    told += [*second.push(signal[at:]), *second.finish()]
    assert told == due
    assert second.tally == whole.tally


@pytest.mark.parametrize("backend", BACKENDS)
def test_how_far_thresholds_are_raised_is_saved_where_they_adapt(tmp_path, backend):
    for adapting, names in (({}, []), (ADAPTING, ["window0.hidden.adaptation"])):
        stream = Stream(make_chain({"baseline": "start"}, **adapting), backend=backend)
        stream.push(make_signal(30))
        stream.save(tmp_path / "state", force=True)
        with safe_open(tmp_path / "state", "numpy") as file:
            assert [name for name in file.keys() if "adaptation" in name] == names  # noqa: SIM118
            assert all(file.get_tensor(name).any() for name in names)


@pytest.fixture
def saved(tmp_path):
    stream = Stream(make_chain({"baseline": "start"}, windows={"length_ms": 30, "hop_ms": 7}))
    stream.push(make_signal(100))
    stream.save(tmp_path / "state")
    return stream, tmp_path / "state"


def test_an_existing_file_is_kept_unless_forced(saved):
    stream, path = saved
    with pytest.raises(InputError, match="already exists"):
        stream.save(path)
    stream.save(path, force=True)


def test_a_state_of_another_chain_is_refused(saved):
    _, path = saved
    for other in ({"seed": 1}, {"patience": 3}, {"windows": {"length_ms": 40}}):
        stream = Stream(make_chain({"baseline": "start"}, **({"windows": {"length_ms": 30, "hop_ms": 7}} | other)))
        with pytest.raises(InputError, match="another chain"):
            stream.load(path)


@pytest.mark.parametrize("at", [0.1, 0.5, 0.9])
def test_a_changed_byte_is_noticed_and_the_stream_stays(saved, at):
    stream, path = saved
    content = bytearray(path.read_bytes())
    content[int(at * len(content))] ^= 1
    path.write_bytes(content)
    before = stream.push(make_signal(40, seed=3))
    with pytest.raises(InputError, match=r"is damaged|is not the state of a stream"):
        stream.load(path)
    twin = Stream(stream.chain)
    twin.push(make_signal(100))
    assert twin.push(make_signal(40, seed=3)) == before


@pytest.mark.parametrize("change", ["drop", "add", "shape", "windows"])
def test_a_state_that_does_not_fit_is_refused_whole(saved, change, tmp_path):
    from neurotact_parts.streams import stream_file

    stream, path = saved
    with safe_open(path, "numpy") as file:
        table = json.loads(file.metadata()["stream"])
    arrays = safetensors.numpy.load(path.read_bytes())
    name = "window0.hidden.membrane"
    if change == "drop":
        del arrays[name]
    elif change == "add":
        arrays["other"] = np.zeros(1, np.float32)
    elif change == "shape":
        arrays[name] = arrays[name][:, :-1].copy()
    else:
        table["windows"] = table["windows"] * 100
    text = json.dumps(table)
    metadata = {"stream": text, "sha256": stream_file._hash(text, arrays)}
    path.write_bytes(safetensors.numpy.save(arrays, metadata=metadata))
    with pytest.raises(InputError, match="of this version"):
        stream.load(path)


def test_other_files_are_refused(saved, tmp_path):
    stream, _ = saved
    (tmp_path / "text").write_text("no state")
    with pytest.raises(InputError, match="is not the state of a stream"):
        stream.load(tmp_path / "text")
    with pytest.raises(InputError, match="there is no such file"):
        stream.load(tmp_path / "nothing")
