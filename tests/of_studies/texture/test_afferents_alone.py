"""A study of afferents encodes alone, and what it tells of intervals is what the spikes say."""

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from in_process import typed
from neurotact_parts.studies.texture import afferents

from neurotact.data.dataset import load_recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.metrics import firing
from neurotact.metrics.spike_trains import isis_ms
from neurotact.studies import loading, study
from neurotact.studies.study import Cell

TINY = Path(__file__).parents[2] / "studies" / "tiny-encoder.toml"
WHAT = study.resolve(TINY)
CELLS = list(study.cells(WHAT))


@pytest.fixture(scope="module")
def encoded() -> list[tuple[Cell, SpikeTrains, dict, pd.DataFrame]]:
    """Each cell with its spike trains, its row and its distributions."""
    recordings = load_recordings(WHAT.dataset)
    found = []
    for cell in CELLS:
        trains = encode_recordings(recordings, cell.encoder)
        left = afferents.run(cell, trains)
        table = pd.read_csv(BytesIO(left["isi.csv"]), dtype={"label": str})
        found.append((cell, trains, json.loads(left["result.json"])["row"], table))
    return found


def test_a_cell_without_a_network_has_a_name_of_its_own():
    assert all(cell.network is None for cell in CELLS)
    assert len({cell.digest() for cell in CELLS}) == len(CELLS) == 8
    assert len({cell.spikes_name for cell in CELLS}) == 4


def test_no_interval_is_shorter_than_the_refractory_period_and_a_step(encoded):
    step_ms = 0.5
    for cell, _, row, table in encoded:
        for name, kind, part in (("SA-I", "sa", cell.encoder.sa1), ("RA-I", "ra", cell.encoder.ra1)):
            least_ms = row[f"isi_least_{kind}_ms"]
            assert least_ms is None or least_ms >= part.t_ref_ms + step_ms
            assert (table["isi_to_ms"][table["population"] == name] > part.t_ref_ms + step_ms).all()


def test_the_distributions_count_every_interval_once(encoded):
    for cell, trains, row, table in encoded:
        keep = trains.select(trains.conditions["force_N"].isin([12.0] if cell.dataset == "12 N" else [3.0, 12.0]))
        found = isis_ms(firing.touch_spikes(keep, cell.window.start_ms), trains.sampling_rate_Hz)
        is_sa = keep.is_sa[found.afferent]
        for name, kind, mine in (("SA-I", "sa", is_sa), ("RA-I", "ra", ~is_sa)):
            rows = table[table["population"] == name]
            assert rows["n"].sum() == mine.sum()
            np.testing.assert_allclose(rows.groupby("label")["share"].sum(), 1.0)
            if mine.any():
                assert row[f"isi_{kind}_ms"] == pytest.approx(found.isi_ms[mine].mean())


def test_a_higher_gain_speaks_more_and_sooner(encoded):
    rows = pd.DataFrame([{**row, "gain": cell.encoder.sa1.gain} for cell, _, row, _ in encoded])
    low, high = (rows[rows["gain"] == gain].reset_index() for gain in (1.8, 6.4))
    for kind in ("sa", "ra"):
        assert (high[f"spikes_{kind}_per_s"] >= low[f"spikes_{kind}_per_s"]).all()
        assert (high[f"latency_{kind}_ms"] <= low[f"latency_{kind}_ms"]).all()
        assert (high[f"silent_share_{kind}"] <= low[f"silent_share_{kind}"]).all()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"sweep.network.hidden": [20]}, "network.hidden needs a network"),
        ({"search.space": "texture"}, "search needs a network"),
    ],
)
def test_what_needs_a_network_is_refused_without_one(overrides, message):
    with pytest.raises(InputError, match=message):
        study.resolve(TINY, overrides)


@pytest.mark.parametrize("overrides", [{"network": "rsnn"}, {"way": "networks"}])
def test_the_way_says_whether_there_is_a_network(overrides):
    with pytest.raises(InputError, match=r"network: (the way 'afferents' trains none|is missing)"):
        loading.resolve(TINY, overrides)
    both = loading.resolve(TINY, {"network": "rsnn", "way": "networks"})
    assert both.network is not None


@pytest.mark.thorough
def test_the_command_leaves_tables_figures_and_a_report(tmp_path):
    folder = tmp_path / "run"
    done = typed("study", "run", TINY, "--workers", 1, "-o", folder)
    assert done.code == 0, done.err
    results, isi = pd.read_csv(folder / "results.csv"), pd.read_csv(folder / "isi.csv")
    encoding = pd.read_csv(folder / "encoding.csv")
    assert len(results) == 8
    assert list(results["encoder.sa1.gain"]) == [1.8, 1.8, 6.4, 6.4] * 2
    assert len(encoding) == 4 * 4  # encoders, and two gratings at two forces
    assert sorted(set(encoding["encoder.ra1.gain"])) == [9.0, 32.0]
    assert list(isi)[:4] == ["dataset", "population", "gain", "t_ref_ms"]
    page = (folder / "report.html").read_text()
    assert "of 1 claims reproduced" in page
    for name in ("isi-distributions", "gain-and-t-ref-2", "compromise"):
        assert f'id="figure-{name}"' in page
        assert (folder / "figures" / f"{name}.svg").is_file()
