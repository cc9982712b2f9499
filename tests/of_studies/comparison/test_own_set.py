"""A file of one's own in place of the sets of ways-to-save: what is chosen for it, what decides it, what is refused."""

import shutil
import warnings
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from browser import browser
from hypothesis import given
from hypothesis import strategies as st
from in_process import studies_here
from levels import examples
from neurotact_parts.studies.comparison import sets
from neurotact_parts.studies.comparison.fronts import NOTHING
from neurotact_parts.studies.comparison.saving import Setting, cut
from neurotact_parts.studies.comparison.together import TOGETHER
from neurotact_parts.studies.comparison.ways_to_save import Parameters

import neurotact as nt
from neurotact import files
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import from_rasters
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.metrics import prices
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.studies import automatic, loading, runner, way_study

WAYS = {
    "refractory period": [{"t_ref_ms": [20, 20]}],
    "fewer taxels": [{"taxels": 0.75}, {"taxels": 0.5}, {"taxels": 0.25}],
    "pruning": [{"prune": 0.5}],
    "early exit": [{"exit_tolerance": 0.5}],
}
NETWORK = {"recipe": "default", "hidden": 8, "training": {"epochs": 2, "patience": 2}}
SMALL = {"ways": WAYS, "network": NETWORK, "sweep.seed": [0, 1]}


def touches(lengths=(40,) * 24, rate_Hz=93.0, unit="count", n_taxels=2, channels=()) -> Recordings:
    """Two surfaces that press on one taxel after the other, by three people."""
    noise = np.random.default_rng(0)
    signals = []
    for number, n_samples in enumerate(lengths):
        press = np.sin(np.linspace(0, 6 + 6 * (number % 2), n_samples))[:, None] * np.linspace(1, 2, n_taxels)
        signals.append((500 + 40 * press + noise.normal(0, 4, press.shape)).astype(np.float32))
    conditions = pd.DataFrame({"label": ["felt", "silk"] * (len(lengths) // 2)})
    conditions["subject"] = [f"s{number // 4}" for number in range(len(lengths))]
    return Recordings(signals, rate_Hz, unit, conditions, channels)


def saved(folder: Path, **how) -> Path:
    hdf5.save_recordings(touches(**how), folder / "touches.h5")
    return folder / "touches.h5"


def sent(folder: Path) -> Path:
    """Events of two keys, in trials of several lengths."""
    noise = np.random.default_rng(0)
    rasters = [(noise.random((60 + 5 * (n % 3), 2)) < [0.1 + 0.2 * (n % 2), 0.1]).astype(np.uint8) for n in range(24)]
    trains = from_rasters(rasters, 200.0, ("key1", "key2"), pd.DataFrame({"label": ["felt", "silk"] * 12}))
    hdf5.save_spikes(trains, folder / "events.h5")
    return folder / "events.h5"


def resolved(path: Path, **changes):
    return loading.resolve("ways-to-save", {**SMALL, **changes}, data=path)


def cells_of(study):
    return list(way_study.cells(study))


def bench_of(path: Path, **changes):
    """The bench of the first seed."""
    parameters: Parameters = cells_of(resolved(path, **changes))[0].built()
    arrays = sets.load(parameters.data)
    return sets.bench_of(parameters.data, RSNNSpec(**parameters.network.model_dump()), parameters.seed, arrays)


# --- what is chosen ------------------------------------------------------------------------------------


def test_window_clock_seeds_and_baseline_are_those_of_own_recordings(tmp_path):
    path = saved(tmp_path, lengths=(300, 400) * 12)
    ours = loading.resolve("ways-to-save", data=path)
    theirs = loading.resolve("own-recordings", data=path)
    chosen = ours.parameters["data"]["sets"]["recordings"]
    assert chosen["window"] == theirs.window.model_dump(mode="json", exclude_none=True)
    assert chosen["conditioning"]["resample_Hz"] == theirs.encoder.conditioning.resample_Hz
    assert chosen["choose_baseline"]
    assert chosen["choose_ema"]
    assert theirs.choose_ema
    assert chosen["unit"] == "count"
    assert ours.sweep["seed"] == [0, 1, 2]  # each has a split of its own; own-recordings divides few trials into folds
    of_splits = [[note for note in what.notes if note.startswith(("Seeds", "Split"))] for what in (ours, theirs)]
    assert [len(notes) for notes in of_splits] == [1, 1]
    of_periods = {note for note in theirs.notes if note.startswith("Refractory periods")}  # here each way has its own
    assert {*ours.notes} - {*of_splits[0]} == {*theirs.notes} - {*of_splits[1]} - of_periods
    assert not ours.as_shipped
    assert ours.title != loading.resolve("ways-to-save").title


@pytest.mark.parametrize(
    ("rate_Hz", "changes", "integration"),
    [(93.0, {}, "exact"), (93.0, {"encoder.integration": "clock"}, "clock"), (2000.0, {}, "clock"),
     (2000.0, {"encoder.integration": "exact"}, "exact"), (93.0, {"conditioning.resample_Hz": 50.0}, "clock")],
)  # fmt: skip
def test_afferents_are_computed_as_own_recordings_computes_them(tmp_path, rate_Hz, changes, integration):
    path = saved(tmp_path, lengths=(round(0.4 * rate_Hz),) * 24, rate_Hz=rate_Hz)
    given = {key.replace("conditioning", "encoder.conditioning"): value for key, value in changes.items()}
    assert loading.resolve("own-recordings", given, data=path).encoder.integration == integration
    encoder = bench_of(path, **changes).encoder
    assert encoder is not None
    assert encoder.integration == integration
    said = [note for note in resolved(path, **changes).notes if note.startswith("Clock of the spikes")]
    assert len(said) == (integration == "exact")


def test_a_moving_average_that_is_given_is_not_chosen(tmp_path):
    path = saved(tmp_path, lengths=(300, 400) * 12)
    ours = loading.resolve("ways-to-save", {"conditioning.ema_cutoff_Hz": 50.0}, data=path).parameters["data"]["sets"][
        "recordings"
    ]
    assert ours["choose_baseline"]
    assert not ours["choose_ema"]
    assert ours["conditioning"]["ema_cutoff_Hz"] == 50.0


@pytest.mark.thorough
@examples(6)
@given(st.sampled_from([35.6, 93.0, 500.0, 2000.0]), st.integers(0, 40), st.sampled_from([None, 100.0, 250.0]))
def test_what_lies_beyond_the_windows_is_not_missed(tmp_path, rate_Hz, more, window_ms):
    n_samples = max(12, round(0.4 * rate_Hz))
    path = saved(tmp_path, lengths=(n_samples, n_samples + more) * 12, rate_Hz=rate_Hz)
    changes = {} if window_ms is None else {"window.length_ms": window_ms, "window.per_trial": 2}
    bench = bench_of(path, **changes)
    whole = encode_recordings(hdf5.load_recordings(path), bench.encoder)
    seen = cut(bench, Setting()).trains
    theirs, ours = whole.cut(bench.window), seen.cut(bench.window)
    assert (theirs.trial.tolist(), theirs.start.tolist()) == (ours.trial.tolist(), ours.start.tolist())
    np.testing.assert_array_equal(whole.raster(theirs), seen.raster(ours))


def test_windows_at_contact_see_the_whole_trial(tmp_path):
    path = saved(tmp_path, lengths=(300,) * 24)
    bench = bench_of(path, **{"window.align": "onset", "window.length_ms": 100.0})
    assert [len(signal) for signal in bench.touches.signals] == [300] * 24


def test_events_come_as_they_are(tmp_path):
    path = sent(tmp_path)
    bench, whole = bench_of(path), hdf5.load_spikes(path)
    assert bench.encoder is None
    assert bench.touches.trial_steps.tolist() == whole.trial_steps.tolist()
    for ours, theirs in zip((*bench.touches.steps, *bench.touches.units), (*whole.steps, *whole.units), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert bench.window.length_ms == 300.0


def test_events_have_no_afferents(tmp_path):
    with pytest.raises(InputError, match=r"encoder\.integration: .* holds events, which no afferents encode"):
        resolved(sent(tmp_path), **{"encoder.integration": "exact"})


def test_people_stand_on_one_side(tmp_path):
    path = saved(tmp_path)
    split = bench_of(path, **{"split.group": ["subject"]}).split
    people = [set(touches().conditions["subject"].to_numpy()[side]) for side in split]
    assert sum(map(len, people)) == len(set.union(*people)) == 6
    assert set(bench_of(path).split.test.tolist()) != set(split.test.tolist())


def test_calibration_keeps_people_together_as_the_split_does(tmp_path, monkeypatch):
    path, asked, chosen = saved(tmp_path), [], sets.calibrate_causally
    monkeypatch.setattr(sets, "calibrate_causally", lambda *a, **how: asked.append(chosen(*a, **how)) or asked[-1])
    bench_of(path, **{"split.group": ["subject"]})
    bench_of(path)
    assert [found.folds is not None for found in asked] == [True, False]


def test_repeats_are_seeds_of_their_own_split(tmp_path):
    path = saved(tmp_path)
    for quick in (False, True):
        what = loading.resolve("ways-to-save", {"sweep.split.seed": [0, 1, 2, 3]}, data=path, quick=quick)
        assert what.sweep["seed"] == [0, 1, 2, 3]
        assert not [note for note in what.notes if note.startswith("Seeds")]
    assert loading.resolve("ways-to-save", {"seed": 7}, data=path).sweep["seed"] == [7]


def test_gains_see_training_trials_alone(tmp_path):
    path = saved(tmp_path)
    window = {"window.length_ms": 300.0, "window.start_ms": 0.0}  # which follows the timing of all trials
    before = bench_of(path, **window)
    with h5py.File(path, "r+") as file:
        for trial in (*before.split.validation, *before.split.test):
            file["signals/values"][40 * trial : 40 * trial + 40] *= 3.0
    assert bench_of(path, **window).encoder == before.encoder


# --- what decides --------------------------------------------------------------------------------------


def names(path: Path):
    return [(cell.digest(), cell.given) for cell in cells_of(resolved(path))]


def test_the_content_decides_wherever_it_lies(tmp_path):
    path = saved(tmp_path)
    before, settings_before = names(path), runner._made_from(resolved(path))
    moved = tmp_path / "elsewhere.h5"
    shutil.copy(path, moved)
    with h5py.File(moved, "r+") as file:
        file.attrs["note"] = "kept elsewhere"
    assert names(moved) == before
    assert runner._made_from(resolved(moved)) == settings_before
    with h5py.File(path, "r+") as file:
        file["signals/values"][3, 1] += 1.0
    assert not set(names(path)) & set(before)
    assert runner._made_from(resolved(path)) != settings_before


def test_the_studies_that_ship_hold_no_key_of_a_file():
    for name in ("ways-to-save", "real-sets", "recipe-ablation"):
        for cell in cells_of(loading.resolve(name)):
            sets = cell.parameters["data"]["sets"].values()
            held = {key for each in sets for key, value in {**each, **each["dataset"]}.items() if value}
            assert not {"content", "choose_baseline", "choose_ema"} & held


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A file, and the folder of its study, run by this process."""
    place = tmp_path_factory.mktemp("own")
    path = saved(place)
    with studies_here(), warnings.catch_warnings(action="ignore"):  # of silent neurons, in so few trials
        nt.run_study("ways-to-save", place / "run", SMALL, data=path)
    return path, place / "run"


def content(folder: Path) -> dict[str, bytes]:
    changing = ("timings.csv", "timing.json", "report.html")
    paths = [path for path in folder.rglob("*") if path.is_file() and path.name not in changing]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@pytest.mark.slow
def test_the_bytes_are_the_same_for_any_number_of_workers(run, tmp_path):
    path, folder = run
    nt.run_study("ways-to-save", tmp_path / "run", SMALL, data=path, workers=2)
    assert content(tmp_path / "run") == content(folder)


@pytest.mark.thorough
def test_a_run_goes_on_from_its_folder_alone(run, tmp_path):
    path, folder = run
    shutil.copytree(folder, tmp_path / "run")
    shutil.rmtree(next((tmp_path / "run" / "cells").iterdir()))
    kept = path.rename(path.with_suffix(".away"))
    try:
        runner.run(runner.load(tmp_path / "run"), tmp_path / "run", workers=1)
    finally:
        kept.rename(path)
    assert (tmp_path / "run" / "results.csv").read_bytes() == (folder / "results.csv").read_bytes()


def test_a_file_that_was_replaced_is_refused(run, tmp_path):
    _, folder = run
    shutil.copytree(folder, tmp_path / "run")
    path = saved(tmp_path, unit="mV")
    with pytest.raises(InputError, match=r"already holds another study \(parameters.data.sets.recordings"):
        runner.run(resolved(path), tmp_path / "run", workers=1)
    fresh = tmp_path / "fresh"
    study = resolved(path)
    runner._claim(fresh, study)
    saved(tmp_path, unit="V")
    with pytest.raises(InputError, match=r"touches\.h5: its trials changed since this study began"):
        runner.run(runner.load(fresh), fresh, workers=1)


def test_the_answer_lists_the_front_and_says_what_it_is_worth(run):
    _, folder = run
    answer = files.read_json(folder / "answer.json")
    (said,) = answer["answers"]  # too few trials to learn: nothing is said of energy
    results = pd.read_csv(folder / "results.csv")
    assert set(results["chance"]) == {0.5}
    alone = results[~results["way"].str.startswith(TOGETHER)]
    assert alone["way"].drop_duplicates().tolist() == [NOTHING, *WAYS]
    # Two taxels: three quarters of them are both, and a quarter of them is one, as a half is.
    assert results.loc[results["way"] == "fewer taxels", "setting"].unique().tolist() == ["50 % taxels"]
    halves, by_list, table, *_ = answer["tables"]
    assert table["setting"] == halves["setting"] == by_list["setting"] == "recordings"
    assert halves["columns"][0] == by_list["columns"][0] == "way"
    assert by_list["columns"][1:] == prices.names()
    assert set(results["afferents"]) == {"at each sample (93 Hz)"}
    assert table["rows"][0][0] == NOTHING
    assert any("2 seeds" in line for line in answer["cautions"])
    assert any("one trial is" in line for line in answer["cautions"])
    page = (folder / "report.html").read_text()
    assert said["headline"].replace(" %", "\u00a0%").replace("&", "&amp;") in page
    assert "Chosen for these recordings:" in page
    for cost in ("sops_total", "energy_estimate_nJ", "signal_ms"):
        assert f'<option value="{cost}">' in page


@pytest.mark.slow
def test_in_a_browser_any_cost_stands_on_the_axis(run, tmp_path):
    _, folder = run
    page = folder / "report.html"
    means = pd.read_csv(folder / "means.csv")
    plot = "document.getElementById('plot')"
    drawn = f"{plot}.querySelector('.main-svg')"
    with browser(tmp_path / "profile") as chromium:
        chromium.open(page, 1400)
        chromium.wait_for(drawn)
        assert {url for url in chromium.requests if not url.startswith(("data:", "blob:"))} == {page.as_uri()}
        for cost, head in (("signal_ms", "signal (ms)"), ("energy_estimate_nJ", "energy estimate (nJ)")):
            choose = f"(one => {{ one.value = '{cost}'; one.dispatchEvent(new Event('change')); }})"
            chromium.evaluate(f"{choose}(document.getElementById('cost'))")
            chromium.wait_for(f"{plot}._fullLayout.xaxis.title.text === '{head}'")
            shown = f"{plot}.data.filter((t) => t.customdata).flatMap((t) => t.x.map((x, i) => [t.customdata[i], x]))"
            found = dict(chromium.evaluate(shown))
            assert found == {index: pytest.approx(value) for index, value in means[cost].items()}
            front = chromium.evaluate(f"{plot}.data.find((t) => t.name === 'Pareto front').y")
            assert front == sorted(front)
        assert "cost=energy_estimate_nJ" in chromium.evaluate("window.location.hash")
        assert chromium.complaints == []


def test_a_first_look_says_so(tmp_path):
    what = loading.resolve("ways-to-save", quick=True, data=saved(tmp_path))
    assert what.first_look
    assert what.sweep["seed"] == [0, 1]
    assert what.parameters["data"]["sets"]["recordings"]["window"]["per_trial"] == 1
    assert sum(map(len, what.parameters["ways"].values())) < 15
    assert runner._made_from(what) == runner._made_from(what.model_copy(update={"first_look": False}))


def test_taxels_whose_names_end_alike_are_taxels_of_their_own(tmp_path):
    path = saved(tmp_path, channels=("left thumb", "right thumb"))
    bench = bench_of(path)
    assert [len(cut(bench, Setting(taxels=share)).trains.afferents) for share in (1.0, 0.5)] == [4, 2]


# --- what is refused -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"split.folds": 3}, "split.folds: this study draws its test trials at random, 15 % for each seed"),
        ({"split.order": "trial"}, "`order`, `folds`, `test_where` and `leave_out_each` do not apply"),
        ({"sweep.split.test_where.day & split.test_where.speed": [[1, 2]]}, "`leave_out_each`: this study draws"),
        ({"split.test_where": {"subject": "s1"}}, "split.test_where: this study draws"),
        ({"sweep.split.fold": [0, 1]}, "sweep.split.fold: this study draws"),
        ({"split.group": ["person"]}, "`group`: there is no condition 'person'; known: label, subject"),
        ({"sweep.split.seed": [0], "seed": 1}, "`repeats`: each seed has its own split, and seed is also given"),
        ({"window.length_ms": 5000.0}, "lasts 0.430 s, less than the 5.000 s of start_ms + length_ms"),
        ({"window.length": 100.0}, "window.length: unknown key; did you mean"),
        ({"conditioning.baseline": "mean"}, "'mean' uses the whole trial; name one of none, start, high-pass"),
        ({"conditioning.resample_Hz": -1.0}, "resample_Hz: must be > 0"),
        ({"encoder.integration": "exactly"}, "integration: must be "),
        ({"data.set": "gratings"}, "set: 'gratings' is not one of the sets; did you mean 'recordings'?"),
        ({"network.hiden": 5}, "network.hiden: unknown key; did you mean 'hidden'?"),
    ],
)
def test_what_does_not_fit_a_file_is_refused_before_anything_runs(tmp_path, changes, words):
    with pytest.raises(InputError) as error:
        resolved(saved(tmp_path), **changes)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_files_that_cannot_be_used_are_refused(tmp_path):
    path = saved(tmp_path)
    nt.save(nt.encode(nt.load(path), nt.calibrate(nt.load(path))), tmp_path / "spikes.h5")
    with pytest.raises(InputError, match=r"spikes\.h5: holds spikes that an encoder made"):
        resolved(tmp_path / "spikes.h5")
    one = touches()
    hdf5.save_recordings(Recordings(one.signals, 93.0, "V", ["felt"] * 24), tmp_path / "one.h5")
    with pytest.raises(InputError, match=r"one\.h5: holds one class, 'felt'; give trials of at least two"):
        resolved(tmp_path / "one.h5")
    hdf5.save_recordings(touches((40,) * 4), tmp_path / "few.h5")
    with pytest.raises(InputError, match="too few to train, validate and test on"):
        resolved(tmp_path / "few.h5")
    with pytest.raises(InputError, match="holds events, which are not conditioned"):
        resolved(sent(tmp_path), **{"conditioning.ema_cutoff_Hz": 10.0})


def test_many_trials_have_one_seed(tmp_path, monkeypatch):
    monkeypatch.setattr(automatic, "SMALL", 10)
    what = loading.resolve("ways-to-save", data=saved(tmp_path))
    assert what.sweep["seed"] == [0]
    assert any("more than 10 trials" in note for note in what.notes)
