"""Taxels that have names are matched by them, at every door where a network takes samples; other names are refused."""

import json

import numpy as np
import pandas as pd
import pytest
from in_process import typed
from made_chains import make_encoder, make_run, make_signal

import neurotact as nt
from neurotact.encoders.specs import afferent_names, taxel_names
from neurotact.errors import InputError

NAMES = ("left", "right")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("named"), channels=NAMES)


def swapped(touches: nt.Recordings, names=("right", "left")) -> nt.Recordings:
    signals = [np.asarray(signal)[:, ::-1] for signal in touches.signals]
    return nt.Recordings(signals, touches.sampling_rate_Hz, touches.unit, touches.conditions, names)


def text(signal: np.ndarray, *names: str) -> str:
    rows = "".join(",".join(map(repr, row)) + "\n" for row in signal.astype(float).tolist())
    return ",".join(names) + "\n" + rows


def decided(*words) -> list[dict]:
    done = typed("stream", *words, "--json")
    assert done.code == 0, done.err
    return [json.loads(line) for line in done.out.splitlines()]


def test_a_stream_takes_columns_by_name(run, tmp_path):
    signal, rows = make_signal(130, seed=3), tmp_path / "rows.csv"
    rows.write_text(text(signal, *NAMES))
    expected = decided(run / "run", "--from", rows)
    rows.write_text(text(signal[:, ::-1], "right", "left"))
    assert decided(run / "run", "--from", rows) == expected
    rows.write_text(text(signal[:, ::-1], "a", "b"))
    assert "has the taxel 'a' where left, right are expected" in typed("stream", run / "run", "--from", rows).err
    stamped = np.column_stack([np.arange(130.0), signal[:, ::-1]])
    rows.write_text(text(stamped, "t", "right", "left"))
    assert decided(run / "run", "--from", rows, "--time-column", "ms") == expected


def test_a_stream_takes_tables_of_pandas_by_name(run):
    signal = make_signal(130, seed=3)
    expected = nt.Stream(run / "run").push(signal)
    assert nt.Stream(run / "run").push(pd.DataFrame(signal[:, ::-1], columns=["right", "left"])) == expected
    with pytest.raises(InputError, match="samples: has the column 'a'"):
        nt.Stream(run / "run").push(pd.DataFrame(signal, columns=["a", "b"]))


def test_a_stream_takes_recordings_by_name(run, tmp_path):
    nt.save(swapped(nt.load(run / "skin.h5")), tmp_path / "swapped.h5")
    expected = decided(run / "run", "--from", run / "skin.h5")
    assert decided(run / "run", "--from", tmp_path / "swapped.h5") == expected


def test_an_encoder_takes_recordings_by_name(run, tmp_path):
    touches = nt.load(run / "skin.h5")
    encoder = nt.calibrate(touches, tell=lambda line: None)
    assert encoder.conditioning.taxels == NAMES
    nt.save(swapped(touches), tmp_path / "swapped.h5")
    nt.encode_file(tmp_path / "swapped.h5", tmp_path / "spikes.h5", encoder)
    expected, again = nt.encode(touches, encoder), nt.encode(swapped(touches), encoder)
    for found in (again, nt.load(tmp_path / "spikes.h5")):
        assert found.afferents == expected.afferents
        assert all((a == b).all() for a, b in zip(found.units, expected.units, strict=True))
        assert found.trial_digests == expected.trial_digests
    with pytest.raises(InputError, match="has the taxel 'a' where left, right are expected"):
        nt.encode(swapped(touches, ("a", "b")), encoder)
    unnamed = nt.encode(swapped(touches, ()), encoder)  # by place
    assert unnamed.afferents[0] == "SA-I taxel1"


@pytest.mark.thorough
def test_integers_are_exported_from_recordings_in_another_order(tmp_path):
    make_run(tmp_path, channels=NAMES)
    touches = nt.load(tmp_path / "skin.h5")
    encoder = make_encoder(baseline="start", offset=(0.0, 0.5), scale=(1.0, 2.0), taxels=NAMES)
    for name, recordings in (("same", touches), ("swapped", swapped(touches))):
        nt.save(recordings, tmp_path / f"{name}.h5")
        nt.encode_file(tmp_path / f"{name}.h5", tmp_path / f"{name}-spikes.h5", encoder)
        settings = {"hidden": 4, "training.epochs": 1}
        nt.train(
            tmp_path / f"{name}-spikes.h5", tmp_path / f"{name}-run", "rsnn", settings, window=nt.Window(length_ms=40)
        )
        nt.export_c(tmp_path / f"{name}-run", tmp_path / name)
    written = [{path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ("same", "swapped")]
    assert written[0].keys() == written[1].keys()
    assert [name for name in written[0] if written[0][name] != written[1][name]] == []


@pytest.mark.parametrize("encoder", [{}, {"sa1": {"grades": [0.5, 1.0]}}, {"model": "send-on-delta"}])
def test_names_of_taxels_are_those_of_which_afferents_were_named(encoder):
    assert taxel_names(afferent_names(("a b", "x1", ""), encoder), encoder) == ("a b", "x1", "")
    assert taxel_names(("one", "two"), encoder) is None
