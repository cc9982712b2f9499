"""A study file becomes cells: every combination, each with its own seeds, whatever the file's form."""

from pathlib import Path

import pytest

from neurotact.errors import InputError
from neurotact.studies import study

TINY = Path(__file__).parent / "tiny.toml"


def resolve(**overrides):
    return study.resolve(TINY, {key.replace("__", "."): value for key, value in overrides.items()})


def test_cells_are_every_combination_in_the_order_of_the_sweep():
    points = [
        (c.encoder.ra1.t_ref_ms, c.encoder.sa1.t_ref_ms, c.network.hidden, c.seed) for c in study.cells(resolve())
    ]
    assert points == [(ra, sa, n, seed) for ra, sa in ((1, 1), (5, 10)) for n in (4, 6) for seed in (0, 1)]


def test_a_resolved_study_reads_back_equal(tmp_path):
    whole = resolve()
    (tmp_path / "study.toml").write_text(study.to_toml(whole))
    assert study.resolve(tmp_path / "study.toml") == whole


def test_the_files_own_set_table_changes_its_parts():
    assert resolve().network.training.epochs == 3


def test_an_override_of_a_swept_key_ends_its_sweep():
    assert {c.network.hidden for c in study.cells(resolve(network__hidden=9))} == {9}


@pytest.mark.parametrize("key", ["network.hidden", "network.training.epochs"])
def test_a_sweep_of_the_user_is_not_ended_by_a_value_of_the_file(key):
    """`[quick]` has one number of hidden neurons, `[set]` one of epochs."""
    whole = study.resolve(TINY, {f"sweep.{key}": [5, 8]}, quick=True)
    assert whole.sweep[key] == [5, 8]
    assert {study.value_at(cell, key) for cell in study.cells(whole)} == {5, 8}


def test_choices_of_calibration_that_are_swept_tell_encoders_apart():
    whole = study.resolve(TINY, {"calibrate": True, "sweep.choose_ema": [False, True]})
    assert len({cell.spikes_name for cell in study.cells(whole) if cell.encoder.sa1.t_ref_ms == 1}) == 2
    assert study.encoder_columns(whole) == ["choose_ema"]


@pytest.mark.parametrize(("clock_Hz", "step_ms"), [(2000.0, 2.5), (400.0, 7.5), (1000.0, 5.0)])
@pytest.mark.parametrize("network", ["rsnn", "default"])
def test_a_step_of_the_network_is_whole_on_the_clock_of_its_own_encoder(network, clock_Hz, step_ms):
    keys = {"network": network, "encoder.conditioning.resample_Hz": clock_Hz}
    whole = study.resolve(TINY, {**keys, "network.step_ms": step_ms}, quick=True)
    assert {cell.network.step_ms for cell in study.cells(whole)} == {step_ms}
    with pytest.raises(
        InputError, match=rf"network\.step_ms: 3\.3 ms is not a whole number of steps at {clock_Hz:g} Hz"
    ):
        study.resolve(TINY, {**keys, "network.step_ms": 3.3}, quick=True)


def test_the_seed_of_a_search_is_refused_in_a_study():
    """Each cell draws its own, so that cells of other seeds search apart."""
    space = {"search.space": {"training.batch": {"_type": "choice", "_value": [4, 8]}}}
    assert study.resolve(TINY, space).search is not None
    for key, value in (("search.seed", 3), ("sweep.search.seed", [3, 4])):
        with pytest.raises(InputError, match=r"search\.seed: has no effect in a study"):
            study.resolve(TINY, {**space, key: value})


def test_a_key_that_is_set_and_swept_is_refused():
    with pytest.raises(InputError, match=r"network\.hidden: is set and swept; give its value, or its values as"):
        study.resolve(TINY, {"network.hidden": 5, "sweep.network.hidden & seed": [[5, 0], [8, 1]]})


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("tau_spread", [0.0, 0.5]),
        ("tau_mem_ms", [5.0, 60.0]),
        ("hidden", [(4, 2), (2, 4)]),
        ("learn", [("alpha",), ()]),
    ],
)
def test_a_swept_key_of_a_network_that_is_a_part_has_its_own_value_in_each_cell(key, values):
    swept = study.resolve(TINY, {"network": "layered", "network.recipe": None, f"network.{key}": values[0]})
    swept = swept.model_copy(update={"sweep": {f"network.{key}": values}})
    assert [study.value_at(cell, f"network.{key}") for cell in study.cells(swept)] == values
    (cell, *_) = study.cells(swept.model_copy(update={"sweep": {"network.training.epochs": [7]}}))
    assert study.value_at(cell, "network.training.epochs") == 7


def test_a_part_is_changed_for_another_spec_by_its_name():
    graded = resolve(encoder="sa1-ra1-lif-graded")
    assert len(graded.encoder.sa1.grades) == 4
    both = resolve(encoder="sa1-ra1-lif-graded", encoder__sa1__opposite=True, network="default")
    assert both.encoder.sa1.opposite
    assert both.network.recipe == "default"
    assert resolve(encoder="poisson", network="snn").network.model == "snn"
    with pytest.raises(InputError, match="grades: there is no such spec in encoders"):
        resolve(encoder="grades")


def test_quick_is_a_smaller_sweep_and_gives_way_to_overrides():
    assert {c.network.hidden for c in study.cells(study.resolve(TINY, quick=True))} == {4}
    larger = study.resolve(TINY, {"network.hidden": 7}, quick=True)
    assert {c.network.hidden for c in study.cells(larger)} == {7}


def test_cells_differ_in_folders():
    cells = list(study.cells(resolve()))
    assert len({c.digest() for c in cells}) == len(cells)


def test_a_cell_stays_itself_when_the_sweep_grows():
    """A cell is named by its own content, so that a larger sweep finds the cells of a smaller one done."""
    small = {c.digest() for c in study.cells(resolve(sweep__seed=[0]))}
    assert small < {c.digest() for c in study.cells(resolve(sweep__seed=[0, 1, 2]))}


def test_only_the_encoder_decides_which_spike_trains_a_cell_needs():
    assert len({c.spikes_name for c in study.cells(resolve())}) == 2


def test_an_axis_of_several_keys_replaces_those_of_each():
    joined = study.resolve(TINY, {"sweep.network.hidden & seed": [[4, 0], [5, 1]]})
    assert "network.hidden" not in joined.sweep
    assert {(cell.network.hidden, cell.seed) for cell in study.cells(joined)} == {(4, 0), (5, 1)}
    assert len({cell.digest() for cell in study.cells(joined)}) == len([*study.cells(joined)])


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"network.hiden": 3}, "network.hiden: unknown key; did you mean 'hidden'?"),
        ({"encoder.tau_mem_ms": -1}, "encoder.tau_mem_ms: must be > 0; got -1"),
        ({"sweep.network.hidden": [20, -1]}, "network.hidden: must be >= 0; got -1"),
        ({"sweep.dataset": ["v3"]}, "'v3' is not a subset"),
        ({"sweep.seed": []}, "sweep of 'seed' has no value"),
        ({"sweep.seed": [-1]}, "sweep.seed must be whole numbers >= 0"),
        ({"sweep.encoder.sa1.t_ref_ms & seed": [[5, 0], [1, 1]]}, "'encoder.sa1.t_ref_ms' is on two axes; drop one"),
        ({"sweep.seed": [0, 1, 0]}, "sweep of 'seed' has 0 twice; drop one"),
        ({"sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [1, 1]]}, "has [1, 1] twice"),
        (
            {"sweep.encoder.conditioning.ema_cutoff_Hz": [None, 50]},
            "ema_cutoff_Hz' has None, which the file of a study",
        ),
        ({"sweep.network.hidden & network.readout_tau_ms": [[4, None]]}, "readout_tau_ms' has None, which the file"),
        ({"sweep.encoder.sa1.t_ref_ms": [5]}, "sa1.t_ref_ms is swept as"),
        ({"encoder.sa1.t_ref_ms": 5}, "is swept as 'encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms'"),
        ({"encoder.sa1.t_ref_ms": [1, 5]}, "encoder.sa1.t_ref_ms': [[1, 1], [5, 5]]}`"),
        ({"dataset.simulate": "rocks"}, "dataset.simulate: there is no such simulation; known: compliance"),
        ({"dataset.file": "x.h5"}, "give one of simulate, read, file and arrays"),
    ],
)
def test_a_wrong_value_is_refused_before_anything_runs(overrides, message):
    with pytest.raises(InputError) as refusal:
        study.resolve(TINY, overrides)
    assert message in str(refusal.value)
