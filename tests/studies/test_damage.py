"""Nothing in a run folder is believed that was edited or damaged: it is written again, or refused in one sentence."""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process import studies_here
from neurotact_parts.networks.search import journal
from toy import bring

from neurotact import files
from neurotact.data import hdf5
from neurotact.data.dataset import load_recordings
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError
from neurotact.spec import shipped
from neurotact.studies import loading, runner, store, study, way

HERE = Path(__file__).parent
TINY = HERE / "tiny.toml"
COINS = HERE / "coins.toml"
SPACE = {"forward_weight_scale": {"_type": "loguniform", "_value": [0.3, 3.0]}}
ONE_SIZE = {"network.hidden": 4, "sweep.seed": [0]}
KINDS = {
    "networks": (TINY, ONE_SIZE | {"baselines": "linear", "signals": True, "same_drive": {"spikes": 3, "trials": 1}}),
    "searches": (
        TINY,
        ONE_SIZE | {"search.space": SPACE, "search.trials": 2, "search.batch": 2},
    ),
    "protocol": (COINS, {}),
}
"""Studies of each kind, with two cells or a few."""


@contextmanager
def one_process() -> Iterator[pytest.MonkeyPatch]:
    """Studies run in this process, which knows the toy protocol."""
    with studies_here() as patch:
        bring(patch)
        yield patch


@pytest.fixture(autouse=True)
def patched() -> Iterator[pytest.MonkeyPatch]:
    with one_process() as patch:
        yield patch


@pytest.fixture(scope="module", params=KINDS)
def whole(request, tmp_path_factory) -> Path:
    """A run of each kind that nothing happened to."""
    folder = tmp_path_factory.mktemp(request.param) / "run"
    with one_process():
        runner.run(loading.resolve(*KINDS[request.param]), folder)
    return folder


@pytest.fixture
def run(whole, tmp_path) -> Path:
    """A copy of it that a test may damage."""
    return Path(shutil.copytree(whole, tmp_path / "run"))


def of_kind(*names: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("whole", names, indirect=True)


def content(folder: Path) -> dict[str, bytes]:
    """All that a run leaves, but for times and drawings."""
    times = {"timing.json", "timings.csv", "report.html"}
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in times and "figures" not in path.parts
    }


def a_cell(folder: Path) -> Path:
    return min(path.parent for path in folder.glob("cells/*/result.json"))


def resume(folder: Path) -> None:
    runner.run(runner.load(folder), folder)


def times_of_results(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.glob("cells/*/result.json")}


def with_accuracy(text: str) -> str:
    """The result of a cell, better than it can be."""
    result = json.loads(text)
    (result["row"] if "row" in result else result["rows"][0])["accuracy_test"] = 7.5
    return json.dumps(result)


# --- cells ------------------------------------------------------------------------------------------------


def test_a_number_edited_in_a_result_is_computed_again(whole, run, capsys):
    path = a_cell(run) / "result.json"
    path.write_text(with_accuracy(path.read_text()))
    resume(run)
    assert f"cells/{path.parent.name}: result.json was changed; computed again\n" in capsys.readouterr().err
    assert content(run) == content(whole)


JUNK = (b"", b"\xff\xfe\x00", b"[]", b"null", b'{"row": 3}', b"a,b\n1\n", b"\n\n")


@pytest.mark.parametrize("junk", JUNK)
def test_junk_in_any_file_of_a_cell_is_computed_again(whole, run, junk, capsys):
    """One file after the other in turn, so that what one damage leaves does not hide the next."""
    names = [path.relative_to(a_cell(run)) for path in a_cell(run).rglob("*") if path.is_file()]
    for name in names[JUNK.index(junk) :: len(JUNK)]:  # all names, spread over the kinds of junk
        (a_cell(run) / name).write_bytes(junk)
        resume(run)
        said = capsys.readouterr().err
        assert (f"cells/{a_cell(run).name}: " in said) == (name.name != "timing.json")
        assert content(run) == content(whole)


@given(st.data())
def test_a_changed_byte_anywhere_is_noticed(whole, tmp_path_factory, data):
    cell = a_cell(whole)
    names = files.read_json(cell / store.FILES)["files"]
    name = data.draw(st.sampled_from(sorted(names)))
    folder = tmp_path_factory.mktemp("copy")
    shutil.copytree(cell, folder, dirs_exist_ok=True)
    before = (folder / name).read_bytes()
    at = data.draw(st.integers(0, len(before) - 1))
    flipped = before[at] ^ data.draw(st.integers(1, 255))
    (folder / name).write_bytes(before[:at] + bytes([flipped]) + before[at + 1 :])
    assert store.flaws(folder, names) == {name: "was changed"}


def test_a_cell_of_other_settings_or_other_spikes_is_computed_again(whole, run, capsys):
    first, *_, last = sorted(path.parent for path in run.glob("cells/*/result.json"))
    table = files.read_json(first / store.FILES)
    key = next(key for key in table["made_from"] if key != "settings")
    files.write_json(first / store.FILES, table | {"made_from": table["made_from"] | {key: "0" * 64}})
    resume(run)
    assert f"cells/{first.name}: result.json was made from other {key}; computed again" in capsys.readouterr().err
    assert content(run) == content(whole)
    shutil.rmtree(first)
    shutil.copytree(last, first)
    resume(run)
    assert f"cells/{first.name}: result.json was made from other " in capsys.readouterr().err
    assert content(run) == content(whole)


def test_times_that_were_damaged_cost_nothing_but_themselves(run, capsys):
    before = times_of_results(run)
    for path in run.glob("cells/*/timing.json"):
        path.write_text('{"seconds": "x", "epochs": [2]}')
    resume(run)
    assert "again" not in capsys.readouterr().err
    assert times_of_results(run) == before
    assert pd.read_csv(run / "timings.csv").dropna(subset="cell")["seconds"].isna().all()


def test_a_whole_run_is_left_as_it_is_and_its_inputs_are_hashed_once(run, monkeypatch, capsys):
    before, hashed = times_of_results(run), []
    sha256 = files.sha256
    monkeypatch.setattr(files, "sha256", lambda path: hashed.append(Path(path)) or sha256(path))
    resume(run)
    assert times_of_results(run) == before
    assert "again" not in capsys.readouterr().err
    given = [path for path in hashed if path.suffix in (".h5", ".npz")]
    assert len(given) == len(set(given)) >= 1


# --- what cells share ---------------------------------------------------------------------------------


SHARED_JUNK = (b"", b"[]", b"a,b\n1\n")


@pytest.mark.parametrize("junk", SHARED_JUNK)
def test_junk_in_what_cells_share_is_written_again(whole, run, junk, capsys):
    before = times_of_results(run)
    shared = (
        "data.json",
        "versions.json",
        "baselines.csv",
        "baselines_trials.csv",
        "signals.csv",
        "same_drive.csv",
        "spikes/*.*",
        "data/*.*",
    )
    paths = sorted(path for name in shared for path in run.glob(name) if path.name != store.FILES)
    for path in paths[SHARED_JUNK.index(junk) :: len(SHARED_JUNK)]:  # all paths, spread over the kinds of junk
        path.write_bytes(junk)
        resume(run)
        assert f"{path.relative_to(run).as_posix()}: was changed; " in capsys.readouterr().err
        assert content(run) == content(whole)
    assert times_of_results(run) == before


@of_kind("networks")
def test_other_spikes_are_encoded_again(whole, run, capsys):
    path = min(run.glob("spikes/*.h5"))
    trains = hdf5.load_spikes(path)
    halved = [[trial[::2] for trial in events] for events in (trains.steps, trains.units)]
    hdf5.save_spikes(replace(trains, steps=halved[0], units=halved[1]), path)
    with pytest.raises(InputError, match=rf"spikes/{path.name}: was changed; neurotact study resume .* writes it agai"):
        runner.write_tables(run)
    resume(run)
    assert f"spikes/{path.name}: was changed; encoded again" in capsys.readouterr().err
    assert content(run) == content(whole)


def test_manifests_of_what_cells_share_are_made_again(whole, run):
    before = times_of_results(run)
    for place in ("spikes", "data"):
        for path in run.glob(f"{place}/{store.FILES}"):
            path.write_text("{")
    resume(run)
    assert content(run) == content(whole)
    assert times_of_results(run) == before


# --- the study -----------------------------------------------------------------------------------------


@of_kind("networks")
def test_an_edited_study_is_refused_and_mended_by_running_it_again(whole, run):
    path = run / "study.toml"
    path.write_text(path.read_text().replace("length_ms = 50.0", "length_ms = 40.0"))
    for go_on in (resume, runner.write_tables):
        with pytest.raises(
            InputError, match=r"study\.toml: was changed since the study began, or another version .* restore it with"
        ):
            go_on(run)
    changed = loading.resolve(path)
    with pytest.raises(InputError, match="already holds another study"):
        runner.run(changed, run)
    runner.run(loading.resolve(*KINDS["networks"]), run)
    assert content(run) == content(whole)


@of_kind("networks")
def test_words_and_claims_of_a_study_may_be_mended(run):
    before, path = times_of_results(run), run / "study.toml"
    path.write_text(path.read_text().replace('title = "Tiny"', 'title = "Small"').replace("Longer", "Long"))
    resume(run)
    runner.write_tables(run)
    assert times_of_results(run) == before
    assert runner.load(run).title == "Small"


@pytest.mark.parametrize("junk", [b"", b"\xff", b"title = ", b"[]"])
def test_junk_in_a_study_is_one_sentence(run, junk):
    (run / "study.toml").write_bytes(junk)
    for go_on in (resume, runner.write_tables):
        with pytest.raises(InputError, match=r"study\.toml"):
            go_on(run)


def test_a_lost_manifest_of_the_run_is_refused_and_made_again_by_running_it(whole, run):
    before = times_of_results(run)
    (run / store.FILES).unlink()
    for go_on in (resume, runner.write_tables):
        with pytest.raises(InputError, match=r"files\.json is damaged or missing"):
            go_on(run)
    runner.run(loading.read_back(run / "study.toml"), run)
    assert content(run) == content(whole)
    assert times_of_results(run) == before


def test_cells_that_no_manifest_lists_are_computed_again(whole, run, capsys):
    for path in run.rglob(store.FILES):
        path.unlink()
    runner.run(loading.read_back(run / "study.toml"), run)
    said = capsys.readouterr().err
    for path in run.glob("cells/*"):
        assert f"cells/{path.name}: result.json is not listed in files.json; computed again" in said
    assert content(run) == content(whole)


def test_a_folder_of_an_earlier_form_is_refused_in_one_sentence(run):
    """Before the form had a number: other keys were written, so that names of cells and of the study were others."""
    path, before = run / "study.toml", content(run)
    text = path.read_text()
    assert text.startswith("schema = 2\n")
    older = text.removeprefix("schema = 2\n")
    what = runner.load(run)
    for manifests in (True, False):
        path.write_text(older)
        files.write_json(run / store.FILES, {"made_from": {"settings": "0" * 12}, "files": {}})
        if not manifests:
            (run / store.FILES).unlink()
        for go_on in (lambda: runner.run(what, run), lambda: resume(run), lambda: runner.write_tables(run)):
            with pytest.raises(InputError) as refusal:
                go_on()
            assert str(refusal.value) == (
                f"{run}: its study.toml is a study of another neurotact (schema none, here 2); remove the folder, or "
                "run the study in another one"
            )
    path.write_text(text)
    runner.run(what, run)
    assert content(run) == before


def test_a_saved_study_of_another_form_is_run_by_its_name(run):
    path = run / "study.toml"
    path.write_text(path.read_text().replace("schema = 2", "schema = 99"))
    with pytest.raises(
        InputError, match=r"study\.toml: is a study of another neurotact \(schema 99, here 2\); run the"
    ):
        loading.resolve(path)


def test_other_versions_are_told_and_not_written_over(run, monkeypatch, capsys):
    before = (run / "versions.json").read_bytes()
    here = runner.versions() | {"torch": "0.1"}
    monkeypatch.setattr(runner, "in_a_process", lambda function, *given: here if function is runner.versions else None)
    resume(run)
    assert "resumes with other versions than at its start, numbers may differ: torch 0.1 (was" in (
        capsys.readouterr().err
    )
    assert (run / "versions.json").read_bytes() == before


@pytest.mark.parametrize("path", shipped("studies"), ids=lambda path: path.stem)
def test_a_study_is_known_again_from_its_file(path, tmp_path, patched):
    patched.undo()
    data = tmp_path / "touches.h5" if path.stem in ("own-recordings", "which-encoder") else None
    if data:
        touches = [np.zeros((500, 2), np.float32)] * 4
        hdf5.save_recordings(Recordings(touches, 500.0, "mV", pd.DataFrame({"label": ["felt", "silk"] * 2})), data)
    what = loading.resolve(path, data=data)
    files.write_text(tmp_path / "study.toml", study.to_toml(what))
    assert runner._made_from(loading.read_back(tmp_path / "study.toml")) == runner._made_from(what)


def test_a_study_of_no_subset_is_refused():
    with pytest.raises(InputError, match=r"dataset\.subsets: must name at least one part"):
        loading.resolve(TINY, {"dataset.subsets": {}})


# --- recordings ----------------------------------------------------------------------------------------


@pytest.fixture
def recorded(tmp_path) -> tuple[Path, Path]:
    """A run of recordings in a file: the file, the run's folder."""
    path, folder = tmp_path / "touches.h5", tmp_path / "run"
    hdf5.save_recordings(load_recordings(study.resolve(TINY).dataset), path)
    table = TINY.read_text().replace('simulate = "gratings"', f'file = "{path}"')
    (tmp_path / "study.toml").write_text("\n".join(line for line in table.splitlines() if "parameters =" not in line))
    runner.run(loading.resolve(tmp_path / "study.toml", ONE_SIZE), folder)
    return path, folder


def test_recordings_that_changed_after_encoding_are_refused(recorded):
    path, folder = recorded
    before = content(folder)
    with h5py.File(path, "r+") as file:
        file["signals/values"][3, 1] += 1.0
    with pytest.raises(InputError, match="the recordings changed since this study began"):
        resume(folder)
    assert content(folder) == before


def test_the_same_recordings_in_another_file_are_the_same(recorded):
    path, folder = recorded
    before = times_of_results(folder)
    with h5py.File(path, "r+") as file:
        file.attrs["note"] = "kept elsewhere"
    resume(folder)
    assert times_of_results(folder) == before
    assert files.read_json(folder / "data.json")["source"] == files.sha256(path)


@pytest.mark.parametrize("name", ["sampling_rate_Hz", "unit"])
def test_the_same_samples_at_another_rate_or_in_another_unit_are_other_recordings(recorded, name):
    """A rate that was wrong is mended by importing again: the spikes and results of before are of other touches."""
    path, folder = recorded
    with h5py.File(path, "r+") as file:
        file.attrs[name] = {"sampling_rate_Hz": 1000.0, "unit": "V"}[name]
    before = content(folder)
    with pytest.raises(InputError, match="the recordings changed since this study began"):
        resume(folder)
    assert content(folder) == before


def test_recordings_that_are_gone_are_not_needed_again(recorded):
    path, folder = recorded
    path.unlink()
    resume(folder)
    next(folder.glob("spikes/*.h5")).unlink()
    with pytest.raises(InputError, match=r"touches\.h5: there is no such file"):
        resume(folder)


def test_recordings_of_a_protocol_that_changed_are_refused(tmp_path, monkeypatch):
    (tmp_path / "coins.csv").write_text("0")
    coins = way.module_of("coins")
    monkeypatch.setattr(coins, "load", lambda data: {"fell": pd.read_csv(data.path, header=None).to_numpy()[:, 0] > 0})
    what = loading.resolve(COINS, {"data.path": str(tmp_path / "coins.csv")}, quick=True)
    folder = tmp_path / "run"
    runner.run(what, folder)
    (tmp_path / "coins.csv").write_text("1")
    with pytest.raises(InputError, match="the recordings changed since this study began"):
        resume(folder)


# --- reports --------------------------------------------------------------------------------------------


def test_a_report_leaves_out_what_is_damaged(run, capsys):
    path = a_cell(run) / "result.json"
    path.write_text(with_accuracy(path.read_text()))
    runner.write_tables(run)
    assert 7.5 not in pd.read_csv(run / "results.csv")["accuracy_test"].tolist()
    assert f"cells/{path.parent.name}: result.json was changed; left out, neurotact study resume" in (
        capsys.readouterr().err
    )


@of_kind("networks")
@pytest.mark.parametrize("name", store.BASELINES)
def test_a_report_says_that_the_classifiers_are_not_done(run, capsys, name):
    """As after an interruption: cells may be done before the last of the classifiers."""
    runner.write_tables(run)
    assert "not done" not in capsys.readouterr().err
    (run / name).unlink()
    runner.write_tables(run)
    assert f"neurotact: {run}: classifiers are not done; left out, neurotact study resume {run} computes them\n" in (
        capsys.readouterr().err
    )


@pytest.mark.slow
def test_no_junk_anywhere_breaks_a_report(run, patched, monkeypatch):
    patched.undo()
    bring(monkeypatch)
    paths = [path for path in sorted(run.rglob("*")) if path.is_file() and "figures" not in path.parts]
    for path, junk in zip(paths, cycle(JUNK), strict=False):
        kept = path.read_bytes()
        path.write_bytes(junk)
        with suppress(InputError):
            runner.write_tables(run)
        path.write_bytes(kept)


# --- journals ------------------------------------------------------------------------------------------

LINE = {"id": 0, "parameters": {"hidden": 4}, "epochs": [0.5], "outcome": "finished", "accuracy": 0.5, "sops": 9.0}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from([*LINE, "x"]), inner, max_size=4),
    max_leaves=6,
)


@given(st.binary(max_size=40) | JSON.map(lambda value: json.dumps(value).encode()))
def test_junk_inside_a_journal_is_one_sentence(tmp_path_factory, junk):
    path = tmp_path_factory.mktemp("journal") / "journal.jsonl"
    path.write_bytes(junk.replace(b"\n", b"") + b"\n" + json.dumps(LINE).encode() + b"\n")
    with pytest.raises(InputError, match="line 1 is damaged"):
        journal.read_journal(path)


@given(st.sampled_from([name for name in LINE if name != "sops"]), JSON)
def test_a_journal_holds_what_a_search_leaves(tmp_path_factory, key, value):
    path = tmp_path_factory.mktemp("journal") / "journal.jsonl"
    line = LINE | {"value": 0.5}
    path.write_text(json.dumps(line | {key: value}) + "\n" + json.dumps(line | {"id": 1}) + "\n")
    with suppress(InputError):
        first, _ = journal.read_journal(path)
        assert 0 <= (first.accuracy or 0) <= 1
        assert all(0 <= epoch <= 1 for epoch in first.epochs)


Damage = Callable[[dict], dict]
DAMAGES: dict[str, Damage] = {
    "accuracy": lambda line: line | {"accuracy": 7.5},
    "value": lambda line: line | {"value": line["value"] + 0.01},
}


@of_kind("searches")
@pytest.mark.parametrize("what", DAMAGES)
def test_a_number_edited_in_the_journal_of_a_search_under_way_is_refused(run, what):
    cell = a_cell(run)
    for name in ("result.json", store.FILES):
        (cell / name).unlink()
    path = cell / "search" / journal.JOURNAL
    first, *others = path.read_text().splitlines()
    path.write_text("\n".join([json.dumps(DAMAGES[what](json.loads(first))), *others, ""]))
    with pytest.raises(InputError, match=r"journal\.jsonl: line 1 is damaged"):
        resume(run)


def test_a_file_that_grew_beyond_all_limits_was_changed(tmp_path):
    (tmp_path / "result.json").write_text("{}")
    store.seal(tmp_path, ["result.json"])
    with open(tmp_path / "result.json", "ab") as file:
        file.truncate(2**40)  # sparse: reading it would take hours
    assert store.flaws(tmp_path, ["result.json"]) == {"result.json": "was changed"}
