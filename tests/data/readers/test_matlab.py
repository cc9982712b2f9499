"""MATLAB files of every version: numbers and texts come back as they were saved, and what is damaged is refused."""

import struct
import zlib

import h5py
import numpy as np
import pytest
from as_specs import of_folder
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.io import savemat

import neurotact as nt
from neurotact.data.readers.formats import arrays_in as read_variables
from neurotact.errors import InputError
from neurotact.files import MAX_MB

SIGNALS = np.random.default_rng(2).normal(size=(4, 9, 3)).astype(np.float32)
MATERIALS = ["felt", "silk", "felt", "silk"]
VERSIONS = ["5", "7", "7.3"]
NOT_READ = np.array([[1j]])


def save(path, version, **variables):
    """As `save` of MATLAB; a list of texts is a cell array."""
    if version != "7.3":
        cells = {k: np.array(v, object) if isinstance(v, list) else v for k, v in variables.items()}
        savemat(path, cells, do_compression=version == "7")
        return path
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            if isinstance(value, list):
                made = [_characters(file, f"#refs#/{name}{i}", text) for i, text in enumerate(value)]
                cell = file.create_dataset(name, (1, len(made)), h5py.ref_dtype)
                cell[0] = [one.ref for one in made]
                cell.attrs["MATLAB_class"] = np.bytes_("cell")
            elif isinstance(value, str):
                _characters(file, name, value)
            elif isinstance(value, dict):
                file.create_group(name).attrs["MATLAB_class"] = np.bytes_("struct")
                for field, held in value.items():
                    file[name][field] = np.atleast_2d(held).T
            else:
                file[name] = np.atleast_2d(value).T  # MATLAB writes the last axis first
                file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    return path


def _characters(file, name, text):
    made = file.create_dataset(name, data=np.array([[ord(letter)] for letter in text], np.uint16))
    made.attrs["MATLAB_class"] = np.bytes_("char")
    return made


def refused(message, call, *arguments, **options):
    with pytest.raises(InputError) as refusal:
        call(*arguments, **(of_folder(options) if call is nt.read_folder else options))
    assert message in str(refusal.value), str(refusal.value)
    assert "\n" not in str(refusal.value)


@given(
    values=arrays.arrays(
        st.sampled_from([np.float64, np.float32, np.int16, np.uint8]),
        arrays.array_shapes(min_dims=2, max_dims=3, min_side=2, max_side=5),
        elements=st.integers(0, 100),
    ),
    version=st.sampled_from(VERSIONS),
)
def test_a_matrix_comes_back(tmp_path_factory, values, version):
    path = save(tmp_path_factory.mktemp("mat") / "a.mat", version, data=values)
    np.testing.assert_array_equal(read_variables(path).arrays["data"], values)


@pytest.mark.parametrize("version", VERSIONS)
def test_texts_come_back_and_the_rest_is_named(tmp_path, version):
    path = save(tmp_path / "a.mat", version, data=np.ones((3, 2)), material="felt", each=MATERIALS, rig=NOT_READ)
    found = read_variables(path)
    assert found.arrays["material"].tolist() == ["felt"]
    assert found.arrays["each"].tolist() == MATERIALS
    assert found.others == ["rig"]


def element(kind, *parts):
    content = b"".join(parts)
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def test_tables_functions_and_what_they_need_are_passed_over(tmp_path):
    """An object has no size and a class of its own; what objects and functions need is a matrix without a name."""
    path = save(tmp_path / "a.mat", "5", data=np.ones((3, 2)))
    words = (
        element(6, struct.pack("<II", 13, 0)),
        element(5, struct.pack("<ii", 2, 1)),
        element(1),
        element(6, bytes(8)),
    )
    table = element(1, b"results"), element(1, b"MCOS"), element(1, b"table"), element(14, *words)
    needed = (
        element(6, struct.pack("<II", 9, 0)),
        element(5, struct.pack("<ii", 1, 4)),
        element(1),
        element(2, bytes(4)),
    )
    more = element(14, element(6, struct.pack("<II", 17, 0)), *table) + element(14, *needed)
    path.write_bytes(path.read_bytes() + more)
    found = read_variables(path)
    assert list(found.arrays) == ["data"]
    assert found.others == ["results"]


def test_a_compressed_variable_that_was_cut_off_is_refused(tmp_path):
    path = save(tmp_path / "a.mat", "7", data=np.arange(1000.0).reshape(100, 10))
    content = bytearray(path.read_bytes()[:-4])
    content[132:136] = struct.pack("<I", len(content) - 136)
    path.write_bytes(content)
    refused("cannot be read as a MATLAB file of version 5 or later (it was cut off)", read_variables, path)


def test_version_4_says_how_to_save(tmp_path):
    savemat(tmp_path / "a.mat", {"data": np.ones((3, 2))}, format="4")
    refused(
        "is not a MATLAB file of version 5 or later; save it in MATLAB with -v7", read_variables, tmp_path / "a.mat"
    )


@pytest.mark.parametrize("version", VERSIONS)
def test_one_file_holds_all_trials(tmp_path, version, caplog):
    path = save(
        tmp_path / "a.mat", version, X=SIGNALS, y=MATERIALS, day=np.array([[1], [1], [2], [2]]), fs=100.0, rig=NOT_READ
    )
    found = nt.read_arrays(path, 100, "count")
    np.testing.assert_array_equal(found.signals, SIGNALS)
    assert found.conditions.to_dict("list") == {"label": MATERIALS, "day": [1, 1, 2, 2]}
    assert "neither numbers nor texts, so not read: rig" in caplog.text


@pytest.mark.parametrize("version", VERSIONS)
def test_a_folder_holds_a_file_a_trial(tmp_path, version):
    for material, trial in zip(MATERIALS, SIGNALS, strict=True):
        place = tmp_path / material
        place.mkdir(exist_ok=True)
        path = place / f"{len(list(place.iterdir()))}.mat"
        save(path, version, pressure=trial, fs=100.0, material=material, force=np.ones(9), rig=NOT_READ)
    found = nt.read_folder(tmp_path, 100, "count", layout=nt.Layout(array="pressure"))
    np.testing.assert_array_equal(found.signals, SIGNALS[[0, 2, 1, 3]])
    assert found.conditions["label"].tolist() == ["felt", "felt", "silk", "silk"]
    assert found.conditions["file"][0] == "felt/0.mat:pressure"
    one = nt.read_folder(tmp_path, 100, "count", layout=nt.Layout(array="force"))
    assert one.signals[0].shape == (9, 1)
    refused(
        "'rig' is neither numbers nor text; name the matrix of samples with `array`", nt.read_folder, tmp_path, 100, "V"
    )
    refused("holds no array 'presure'; did you mean 'pressure'", nt.read_folder, tmp_path, 100, "V", array="presure")


def test_arrays_of_different_taxels_are_not_all_trials(tmp_path):
    (tmp_path / "felt").mkdir()
    save(tmp_path / "felt" / "a.mat", "7", pressure=SIGNALS[0].T, force=np.ones(9))
    refused("(pressure (3, 9), force (9, 1)); name one with `array`", nt.read_folder, tmp_path, 100, "V")
    refused("name one with `array`", nt.read_folder, tmp_path, 100, "V", transpose=True)


@pytest.mark.parametrize("option", [{"array": "pressure"}, {"transpose": True}])
def test_options_of_arrays_are_refused_for_text(tmp_path, option):
    (tmp_path / "felt").mkdir()
    (tmp_path / "felt" / "a.csv").write_text("1,2\n3,4\n")
    refused("`array` and `transpose` are for NPZ and MATLAB files", nt.read_folder, tmp_path, 100, "V", **option)


@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_arrays_may_be_the_other_way_round(tmp_path, suffix, caplog):
    (tmp_path / "felt").mkdir()
    write = np.savez if suffix == ".npz" else lambda path, **values: savemat(path, values)
    write(tmp_path / "felt" / f"a{suffix}", data=SIGNALS[0].T)
    found = nt.read_folder(tmp_path, 100, "count")
    assert found.signals[0].shape == (3, 9)
    assert "arrays of 9 taxels, 3 samples each; if it is the other way round, use `transpose=True`" in caplog.text
    caplog.clear()
    np.testing.assert_array_equal(
        nt.read_folder(tmp_path, 100, "count", layout=nt.Layout(transpose=True)).signals[0], SIGNALS[0]
    )
    assert not caplog.messages


@pytest.mark.parametrize("version", VERSIONS)
@given(seed=st.integers(0, 10_000))
def test_a_damaged_file_is_refused_or_read(tmp_path_factory, version, seed):
    draw = np.random.default_rng(seed)
    folder = tmp_path_factory.mktemp("mat")
    path = save(folder / "a.mat", version, data=SIGNALS[0], each=MATERIALS, rig={"a": 1})
    content = bytearray(path.read_bytes())
    for _ in range(draw.integers(1, 9)):
        content[draw.integers(len(content))] = draw.integers(256)
    path.write_bytes(content[: draw.integers(len(content) // 2, len(content) + 1)])
    said = f"{path}: read"
    try:
        read_variables(path)
    except InputError as error:
        said = str(error)
    assert said.startswith(f"{path}: ")
    assert "\n" not in said


def test_what_inflates_beyond_the_limit_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv(MAX_MB, "1")
    path = tmp_path / "a.mat"
    savemat(path, {"a": np.ones((2, 2))}, do_compression=True)
    bomb = zlib.compress(bytes(2_000_000))
    path.write_bytes(path.read_bytes()[:128] + np.array([15, len(bomb)], "<u4").tobytes() + bomb)
    refused("more than the limit of 1 MB", read_variables, path)


@pytest.mark.parametrize("version", VERSIONS)
def test_fields_of_a_structure_are_read(tmp_path, version):
    for material, trial in zip(MATERIALS[:2], SIGNALS, strict=False):
        (tmp_path / material).mkdir()
        save(tmp_path / material / "0.mat", version, touch={"pressure": trial, "t_ms": 10.0 * np.arange(9)[:, None]})
    found = nt.read_folder(tmp_path, unit="count")
    np.testing.assert_array_equal(found.signals, SIGNALS[:2])
    assert (found.sampling_rate_Hz, found.conditions["file"][0]) == (100.0, "felt/0.mat:touch/pressure")


@pytest.mark.parametrize("compress", [False, True])
def test_an_array_of_structures_holds_a_trial_in_each(tmp_path, compress):
    touches = np.zeros((3,), [("pressure", object), ("label", object), ("rig", object)])
    for place, cell in enumerate(RAGGED):
        touches[place] = (cell, MATERIALS[place], {"speed": float(place)})
    savemat(tmp_path / "a.mat", {"touch": touches, "fs": 250.0}, do_compression=compress)
    found = nt.read_arrays(tmp_path / "a.mat", unit="count")
    assert found.conditions.to_dict("list") == {"label": MATERIALS[:3]}
    for mine, its in zip(found.signals, RAGGED, strict=True):
        np.testing.assert_array_equal(mine, its.astype(np.float32))


def test_an_array_of_structures_in_hdf5_holds_a_trial_in_each(tmp_path):
    path = save_cells(tmp_path / "a.mat", "7.3", RAGGED, y=MATERIALS[:3], fs=250.0)
    with h5py.File(path, "r+") as file:
        del file["trials"].attrs["MATLAB_class"]  # a field of an array of structures has none
        file.move("trials", "touch/pressure")
    found = nt.read_arrays(path, unit="count")
    assert ([len(signal) for signal in found.signals], found.classes) == ([9, 7, 8], ("felt", "silk"))
    with h5py.File(path, "r+") as file:
        file["touch"]["touch"] = file["touch/again"] = file["touch"]  # without a bound there were no end
    assert "touch/pressure" in read_variables(path).cells


def test_a_file_without_numbers_and_texts_says_what_to_save(tmp_path):
    refused(
        "holds neither matrices of numbers nor texts (rig)", read_variables, save(tmp_path / "a.mat", "7", rig=NOT_READ)
    )
    (tmp_path / "b.mat").write_text("dear diary")
    refused("is not a MATLAB file of version 5", read_variables, tmp_path / "b.mat")


# --- cell arrays of matrices ------------------------------------------------------------------------

RAGGED = [np.random.default_rng(n).normal(size=(n, 3)) for n in (9, 7, 8)]


def save_cells(path, version, cells, **variables):
    """As `save` of MATLAB, with the cell array `trials` of matrices."""
    if version != "7.3":
        boxed = np.empty((len(cells), 1), object)
        for place, cell in enumerate(cells):
            boxed[place, 0] = cell
        savemat(path, {"trials": boxed, **variables}, do_compression=version == "7")
        return path
    save(path, version, **variables)
    with h5py.File(path, "r+") as file:
        made = [file.create_dataset(f"#refs#/t{n}", data=np.atleast_2d(cell).T) for n, cell in enumerate(cells)]
        for one in made:
            one.attrs["MATLAB_class"] = np.bytes_("double")
        held = file.create_dataset("trials", (1, len(made)), h5py.ref_dtype)
        held[0] = [one.ref for one in made]
        held.attrs["MATLAB_class"] = np.bytes_("cell")
    return path


@pytest.mark.parametrize("version", VERSIONS)
def test_a_cell_array_holds_a_trial_in_each_cell(tmp_path, version, caplog):
    labels = np.array([[1.0], [2.0], [1.0]])
    path = save_cells(tmp_path / "a.mat", version, RAGGED, y=labels, Fs=250.0)
    found = nt.read_arrays(path, unit="count")
    assert [signal.shape for signal in found.signals] == [(9, 3), (7, 3), (8, 3)]
    for mine, its in zip(found.signals, RAGGED, strict=True):
        np.testing.assert_array_equal(mine, its.astype(np.float32))
    assert found.conditions.to_dict("list") == {"label": ["1", "2", "1"]}
    assert found.sampling_rate_Hz == 250.0
    assert "the sampling rate is 250 Hz, as Fs says" in caplog.text
    turned = save_cells(tmp_path / "b.mat", version, [cell.T for cell in RAGGED], y=labels)
    refused("cell 2, has 7 taxels where the first has 9; if its axes are taxel and time, use `axes='trial,taxel,time'`",
            nt.read_arrays, turned, 250, "V")  # fmt: skip
    back = nt.read_arrays(turned, 250, "V", axes="trial,taxel,time")
    assert [signal.shape for signal in back.signals] == [(9, 3), (7, 3), (8, 3)]


@pytest.mark.parametrize("version", VERSIONS)
def test_cells_of_vectors_are_one_taxel_and_cells_of_grids_many(tmp_path, version):
    labels = np.array([[1.0], [2.0], [1.0]])
    path = save_cells(tmp_path / "a.mat", version, [cell[:, 0][None] for cell in RAGGED], y=labels)
    found = nt.read_arrays(path, 100, "V")
    assert [signal.shape for signal in found.signals] == [(9, 1), (7, 1), (8, 1)]
    grids = [np.random.default_rng(n).normal(size=(20 + n, 3, 2)) for n in range(3)]
    found = nt.read_arrays(save_cells(tmp_path / "b.mat", version, grids, y=labels), 100, "V")
    assert found.channels == ("r0c0", "r0c1", "r1c0", "r1c1", "r2c0", "r2c1")
    for mine, its in zip(found.signals, grids, strict=True):
        np.testing.assert_array_equal(mine, its.reshape(len(its), 6).astype(np.float32))


@pytest.mark.parametrize("version", VERSIONS)
def test_a_folder_takes_each_cell_as_a_trial(tmp_path, version, caplog):
    for label, cells in (("felt", RAGGED), ("silk", RAGGED[:2])):
        (tmp_path / label).mkdir()
        save_cells(tmp_path / label / "a.mat", version, cells, fs=250.0)
    found = nt.read_folder(tmp_path, unit="count")
    assert found.conditions["label"].tolist() == ["felt"] * 3 + ["silk"] * 2
    assert found.conditions["file"][1] == "felt/a.mat:trials{2}"
    assert found.lengths.tolist() == [9, 7, 8, 9, 7]
    assert found.sampling_rate_Hz == 250.0
    assert [line for line in caplog.messages if "sampling rate" in line] == [
        f"{tmp_path}: the sampling rate is 250 Hz, as felt/a.mat: fs says"
    ]
    assert len(nt.read_folder(tmp_path, 100, "count", layout=nt.Layout(array="trials"))) == 5
    assert "says felt/a.mat: fs = 250, silk/a.mat: fs = 250, but 100 Hz is given and used" in caplog.text
    save_cells(tmp_path / "silk" / "a.mat", version, RAGGED, fs=100.0)
    refused("says felt/a.mat: fs = 250, silk/a.mat: fs = 100; give the rate", nt.read_folder, tmp_path, unit="count")


def test_cells_of_mixed_kinds_are_not_read(tmp_path):
    mixed = np.empty((2, 1), object)
    mixed[0, 0], mixed[1, 0] = np.ones((3, 2)), "felt"
    savemat(tmp_path / "a.mat", {"mixed": mixed, "X": SIGNALS, "numbers": np.array([1.0, 2.0, 3.0, 4.0], object)})
    found = read_variables(tmp_path / "a.mat")
    assert found.others == ["mixed"]
    assert found.arrays["numbers"].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert not found.cells
