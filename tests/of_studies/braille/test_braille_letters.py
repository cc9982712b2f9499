"""Braille letters: the published form and its repack say the same, and nothing of a file is ever executed."""

import io
import os
import pickle as maker  # to make files; nothing here reads them with it
from pathlib import Path
from pickletools import opcodes

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.braille import plain_objects
from neurotact_parts.studies.braille.plain_objects import read_plain
from neurotact_parts.studies.braille.reader import AFFERENTS, read

from neurotact import cli
from neurotact.data.hdf5 import load_spikes
from neurotact.errors import InputError

DATA = Path(os.environ.get("NEUROTACT_DATA", Path(__file__).parents[4] / "shared" / "data")) / "braille-th10"

times = st.lists(st.floats(0, 2.0), max_size=4)
taxels = st.lists(st.tuples(times, times).map(list), min_size=12, max_size=12)
letters = st.lists(
    st.fixed_dictionaries({"letter": st.sampled_from(["A", "B", "Space"]), "events": taxels}), min_size=1, max_size=4
)
plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.lists(inner).map(tuple),
    max_leaves=20,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("braille")


def written(folder: Path, content: bytes) -> Path:
    path = folder / "data_braille_letters"
    path.write_bytes(content)
    return path


@given(plain, st.integers(0, maker.HIGHEST_PROTOCOL))
def test_plain_values_come_back_in_every_protocol(folder, value, protocol):
    if protocol < 2 and "True" in repr(value) + "False" in repr(value):
        return
    assert read_plain(written(folder, maker.dumps(value, protocol))) == value


def test_what_stands_twice_is_read_twice(folder):
    same = ["x", 1.5]
    assert read_plain(written(folder, maker.dumps([same, same, "x"]))) == [same, same, "x"]


class Trap:
    """Would make a file if it were executed."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


@pytest.mark.parametrize("protocol", range(maker.HIGHEST_PROTOCOL + 1))
def test_a_file_that_would_run_code_is_refused_and_does_not_run(folder, protocol):
    target = folder / f"made-{protocol}"
    for value in ([{"letter": "A", "events": Trap(target)}], np.float64(1.0), {1, 2}, io.StringIO):
        with pytest.raises(InputError, match="holds more than lists, tables, text and numbers"):
            read(written(folder, maker.dumps(value, protocol)))
    assert not target.exists()


def test_were_an_opcode_let_through_no_name_would_be_found(folder, monkeypatch):
    monkeypatch.setattr(plain_objects, "VALUES", {opcode.name for opcode in opcodes})
    with pytest.raises(InputError, match=r"is damaged \(it names \w+\.Path"):
        read_plain(written(folder, maker.dumps(Trap(folder / "made"))))
    assert not (folder / "made").exists()


def test_a_number_that_would_take_memory_is_refused(folder):
    """The place of a value in a table, which pickle would make that long; a million are little enough for a mutant."""
    for place in (10**6, 2**31 - 1):
        with pytest.raises(InputError, match=rf"is damaged \(it numbers a value {place}\)"):
            read_plain(written(folder, b"\x80\x02]r" + place.to_bytes(4, "little") + b"."))


@given(st.binary(max_size=60))
def test_damaged_bytes_are_one_sentence(folder, content):
    with pytest.raises(InputError, match="data_braille_letters"):  # so few bytes are never a recording
        read(written(folder, content))


def repacked(folder: Path, given_letters: list) -> Path:
    rows = [
        (number, taxel, polarity, time)
        for number, entry in enumerate(given_letters)
        for taxel, pair in enumerate(entry["events"])
        for polarity, values in enumerate(pair)
        for time in values
    ]
    recording, taxel, polarity, time = np.array(rows).reshape(-1, 4).T
    np.savez(
        folder / "events.npz", letter=[entry["letter"] for entry in given_letters],
        event_recording=recording.astype(int), event_taxel=taxel.astype(int), event_polarity=polarity.astype(int),
        event_time_s=time,
    )  # fmt: skip
    return folder / "events.npz"


@given(letters, st.sampled_from([1.0, 5.0, 7.3]))
def test_both_forms_give_each_event_its_step(folder, given_letters, step_ms):
    published = read(written(folder, maker.dumps(given_letters)), step_ms)
    again = read(repacked(folder, given_letters), step_ms)
    assert published.sampling_rate_Hz == again.sampling_rate_Hz == 1e3 / step_ms
    assert published.afferents == AFFERENTS
    for number, entry in enumerate(given_letters):
        expected = {
            (int(time * 1e3 / step_ms + 1e-9), 12 * polarity + taxel)
            for taxel, pair in enumerate(entry["events"])
            for polarity, values in enumerate(pair)
            for time in values
        }
        for trains in (published, again):
            found = list(zip(trains.steps[number].tolist(), trains.units[number].tolist(), strict=True))
            assert len(found) == len(set(found))
            assert set(found) == expected
            assert trains.conditions.label[number] == entry["letter"]
    assert len(set(published.trial_steps.tolist())) == 1


@given(letters, st.sampled_from([1.0, 5.0, 7.3]), st.sampled_from([50.0, 900.0, 2500.0]))
def test_nearest_steps_and_a_given_length_are_those_of_the_published_study(folder, given_letters, step_ms, length_ms):
    trains = read(repacked(folder, given_letters), step_ms, binning="nearest", length_ms=length_ms)
    n_steps = int(length_ms / step_ms + 1e-9)
    assert set(trains.trial_steps.tolist()) == {n_steps}
    longest = read(repacked(folder, given_letters), step_ms, binning="nearest")
    for number, entry in enumerate(given_letters):
        expected = {
            (round(time * 1e3 / step_ms), 12 * polarity + taxel)  # round() as there
            for taxel, pair in enumerate(entry["events"])
            for polarity, values in enumerate(pair)
            for time in values
        }
        assert set(zip(longest.steps[number].tolist(), longest.units[number].tolist(), strict=True)) == expected
        found = set(zip(trains.steps[number].tolist(), trains.units[number].tolist(), strict=True))
        assert found == {(step, unit) for step, unit in expected if step < n_steps}


@pytest.mark.parametrize("length_ms", [0.0, 4.9, float("nan"), float("inf")])
def test_an_impossible_length_is_refused(folder, length_ms):
    with pytest.raises(InputError, match="length_ms: must be one step of 5 ms or more"):
        read(written(folder, maker.dumps(GOOD)), 5.0, length_ms=length_ms)


GOOD = [{"letter": "A", "events": [[[0.1], [0.2]]] * 12}]


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({}, "holds a dict where a list"),
        ([], "holds no recording"),
        ([{"letter": "A"}], "recording 0 is not a table"),
        ([{"letter": 3, "events": []}], "recording 0 is not a table"),
        ([*GOOD, {"letter": "A", "events": [[[], []]] * 11}], "recording 1: its events are not 12 taxels"),
        ([{"letter": "A", "events": [[[], [], []]] * 12}], "recording 0: its events are not 12 taxels"),
        ([{"letter": "A", "events": [[["x"], []]] * 12}], "recording 0, taxel 1: its times are not numbers"),
        ([{"letter": "A", "events": [[[-1.0], []]] * 12}], "times of events must be numbers"),
        ([{"letter": "A", "events": [[[float("inf")], []]] * 12}], "times of events must be numbers"),
        ([{"letter": "A", "events": [[[1e300], []]] * 12}], "is beyond any clock"),
    ],
)
def test_what_is_no_braille_is_refused_by_its_place(folder, table, words):
    with pytest.raises(InputError, match=words):
        read(written(folder, maker.dumps(table)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"event_taxel": [12]}, "event_taxel must hold whole numbers from 0 to 11"),
        ({"event_polarity": [2]}, "event_polarity must hold"),
        ({"event_recording": [1]}, "event_recording must hold"),
        ({"event_time_s": [np.nan]}, "times of events must be numbers"),
        ({"event_time_s": [0.1, 0.2]}, "differ in length"),
        ({"letter": None}, "the array 'letter' is missing"),
    ],
)
def test_a_repack_that_does_not_fit_is_refused(folder, change, words):
    arrays = {"letter": ["A"], "event_recording": [0], "event_taxel": [0], "event_polarity": [0], "event_time_s": [0.1]}
    arrays = {name: value for name, value in (arrays | change).items() if value is not None}
    np.savez(folder / "wrong.npz", **arrays)
    with pytest.raises(InputError, match=words):
        read(folder / "wrong.npz")


@pytest.mark.parametrize("step_ms", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_clock_is_refused(folder, step_ms):
    with pytest.raises(InputError, match="`step_ms`: must be a positive number"):
        read(written(folder, maker.dumps(GOOD)), step_ms)


@pytest.mark.skipif(not DATA.is_dir(), reason="the Braille letters are not here; set NEUROTACT_DATA")
def test_the_published_letters():
    trains = read(DATA / "events.npz")
    assert len(trains) == 4320
    assert len(trains.classes) == 27
    assert trains.sampling_rate_Hz == 200.0
    assert 35 < np.mean([len(steps) for steps in trains.steps]) <= 41.1


def test_letters_become_a_file_of_spikes_on_any_clock(folder, monkeypatch, capsys):
    source, out = repacked(folder, GOOD), folder / "spikes.h5"
    words = ("import", "braille-letters", str(source), "-o", str(out), "--step-ms", "10")
    monkeypatch.setattr("sys.argv", ["neurotact", *words])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 0
    assert (
        "1 trial of 1 class, 24 spikes of 24 afferents (12 ON, 12 OFF), 21 steps at 100 Hz" in capsys.readouterr().out
    )
    assert load_spikes(out).steps[0].tolist() == 12 * [10] + 12 * [20]
