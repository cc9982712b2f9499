"""Further measurements, which a study requests by a key of their name: where they stand, and what is refused."""

import pytest

from neurotact import plugins
from neurotact.errors import InputError
from neurotact.studies import measures
from neurotact.studies.study import cells, resolve, to_toml

STUDY = "sensing-conditions"  # has `signals` and `same_drive`
ASKED = {"same_drive": {"spikes": 5}, "cut_short_ms": [10.0], "exit_patiences": [3], "signals": True}


@pytest.mark.parametrize("name", ASKED)
def test_a_measure_is_a_key_of_the_study_or_of_its_table(name):
    plain, tabled = (resolve("unknown-start", {f"{where}{name}": ASKED[name]}) for where in ("", "measures."))
    assert plain.digest() == tabled.digest()
    assert [*plain.measures] == [name]


@pytest.mark.parametrize("nothing", [False, []])
def test_what_asks_for_nothing_is_left_out(nothing):
    for where in ("", "measures."):
        assert [*resolve(STUDY, {f"{where}signals": nothing}).measures] == ["same_drive"]


def test_a_key_in_a_table_changes_that_key_alone(tmp_path):
    saved = tmp_path / "study.toml"
    saved.write_text(to_toml(resolve(STUDY, {"same_drive.trials": 3})))
    given = resolve(saved, {"same_drive.spikes": 7}).measures["same_drive"]
    assert (given["spikes"], given["trials"]) == (7, 3)


def test_cells_name_the_measures_of_networks_alone():
    study = resolve("early-exit", ASKED)
    assert {frozenset(cell.measures) for cell in cells(study)} == {frozenset({"exit_patiences", "cut_short_ms"})}
    assert {*study.measures} == {*ASKED}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"signls": True}, r"^signls: unknown key; did you mean 'signals'\?"),
        ({"measures.signls": True}, r"^measures: there is none called 'signls'; did you mean 'signals'\?"),
        ({"same_drive.spikes": 0}, r"^measures\.same_drive\.spikes: must be >= 1; got 0 \(\S+\.toml\)$"),
        ({"same_drive.spikes": "5"}, r"^measures\.same_drive\.spikes: must be a number"),
        ({"signals": 3}, r"^measures\.signals: must be true or false"),
        ({"cut_short_ms": [0]}, r"^measures\.cut_short_ms\.0: must be > 0"),
        ({"measures": 3}, r"^measures: must be a table"),
        ({"sweep.dataset.parameters.start_mm": [0.0, 1.0], "baselines": "none"}, "signals describes one set of rec"),
        ({"encoder.integration": "exact"}, r"same_drive steps its afferents on a clock"),
    ],
    ids=str,
)
def test_a_wrong_measure_is_refused_by_name(given, said):
    with pytest.raises(InputError, match=said):
        resolve(STUDY, given)


def test_a_measure_of_networks_needs_one():
    with pytest.raises(InputError, match="cut_short_ms needs a network"):
        resolve("scaling-coefficients", {"cut_short_ms": [10.0]})


def test_a_claim_may_name_the_tables_of_measures_and_no_unknown_one():
    claim = {"name": "x", "source": "y", "published": "z", "kind": "at_least", "measure": "m", "value": 1.0}
    for table in ["results", *sorted(measures.tables())]:
        assert resolve(STUDY, {"claims": [claim | {"table": table}]}).claims[0].table == table
    with pytest.raises(InputError, match=r"claims\.0\.table: is no table; did you mean 'same_drive'"):
        resolve(STUDY, {"claims": [claim | {"table": "same_drv"}]})


def test_the_tables_of_measures_have_names_of_their_own():
    assert len(measures.tables()) == len(plugins.names("measures"))
