"""What a row holds gives its energy by every price list; a sentence says under which lists the order turns."""

import math
from dataclasses import fields

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.comparison import by_list, fronts, real_sets, rivals
from neurotact_parts.studies.comparison.fronts import NOTHING, energies_of_ways

from neurotact.metrics.flops import Cost
from neurotact.metrics.prices import PRICED, PriceList, names, price_list

costs = st.builds(Cost, **{field.name: st.floats(0, 1e6) for field in fields(Cost)})
EVENTS, MEMORY, ARITHMETIC = (price_list(name) for name in ("memory-45nm-events", "memory-45nm", "arithmetic-45nm"))


@given(costs, costs)
def test_energies_of_rows_are_those_of_their_costs(clocked, event_driven):
    found = by_list.energies(
        pd.DataFrame([by_list.counted(clocked, event_driven), by_list.the_same(clocked.columns())])
    )
    assert [*found] == names()
    for name, energies in found.items():
        prices = price_list(str(name))
        own = event_driven if prices.event_driven else clocked
        assert energies.tolist() == pytest.approx([own.energy_nJ(prices), clocked.energy_nJ(prices)])


def test_what_a_row_does_not_hold_has_no_energy():
    found = by_list.energies(pd.DataFrame([{"accuracy_test": 0.9}, {"accuracy_test": 0.8}], index=[3, 1]))
    assert found.index.tolist() == [3, 1]
    assert found.isna().all(axis=None)


def test_a_classifier_without_a_column_of_synaptic_operations_has_none():
    columns = {name: value for name, value in Cost(macs=10, weights_accesses=10).columns().items() if name != "sops"}
    found = by_list.energies(pd.DataFrame([by_list.the_same(columns)]))
    assert found["loihi"].item() == pytest.approx(Cost(macs=10).energy_nJ(price_list("loihi")))


def row(cost, events=None, **more):
    return {"seed": 0, "n_train": 70, "n_test": 15, **by_list.counted(cost, events or cost), **more}


def of_set(*classifiers):
    """Rows of three seeds; a classifier: its name, input, accuracy, what it computes, and what it reads from memory."""
    return pd.DataFrame([
        row(Cost(macs=macs, weights_accesses=read, bytes=2048), classifier=name, input=words, seed=seed, set="made",
            split="trials", accuracy_test=accuracy, accuracy_validation=accuracy, energy_estimate_nJ=4.6e-3 * macs)
        for name, words, accuracy, macs, read in classifiers for seed in range(3)
    ])  # fmt: skip


NETWORK = ("RSNN", "spikes: every step", 0.9, 5000, 1000)


def test_each_list_has_its_cheapest_rival_among_the_most_accurate():
    results = of_set(NETWORK, ("extra trees", "signals: a", 0.88, 1000, 100_000), ("SVM", "signals: a", 0.9, 9000, 100),
                     ("SVM", "signals: b", 0.879, 1, 1), ("SVM", "spikes: counts", 0.9, 2, 2))  # fmt: skip
    found = rivals.ratios(results, real_sets.VIEW).set_index(["rival", "prices"])
    assert set(found["network"]) == {"RSNN, spikes: every step"}
    cheapest = found.loc[rivals.CHEAPEST]
    assert cheapest.loc["arithmetic-45nm", "name"] == "extra trees, signals: a"
    assert cheapest.loc["memory-45nm", "name"] == "SVM, signals: a"
    assert cheapest.loc["arithmetic-45nm", "ratio"] == pytest.approx(5)
    spent = Cost(macs=9000, weights_accesses=100, bytes=2048)
    assert cheapest.loc["memory-45nm", "nJ"] == pytest.approx(spent.energy_nJ(MEMORY))
    assert cheapest["kB"].tolist() == pytest.approx([2.0] * len(names()))
    assert set(found.loc[rivals.MOST_ACCURATE, "name"]) == {"SVM, spikes: counts"}
    *_, said = real_sets.named(results)["made, trials"].details
    assert (
        "By arithmetic-45nm the network takes 5 times the energy of extra trees, signals: a; it takes less by" in said
    )
    assert "memory-45nm (0.64 times the energy of SVM, signals: a)" in said


def test_what_is_not_counted_is_never_the_cheapest():
    results = of_set(NETWORK, ("own", "signals: a", 0.9, 1, 1), ("SVM", "signals: a", 0.9, 9000, 100))
    results.loc[results["classifier"] == "own", [*PRICED, "energy_estimate_nJ"]] = math.nan
    found = rivals.ratios(results, real_sets.VIEW)
    at_work = found[found["prices"] == "arithmetic-45nm"]
    assert at_work.loc[at_work["rival"] == rivals.CHEAPEST, "name"].tolist() == ["SVM, signals: a"]


def test_a_table_of_each_answer_stands_beside_the_best_of_each_kind():
    results = of_set(NETWORK, ("SVM", "signals: a", 0.9, 9000, 100))
    ((name, (best, listed)),) = real_sets.tables(results).items()
    assert name == "made, trials"
    assert best.caption.startswith("The best of each kind")
    assert listed.rows["prices"].tolist() == names()
    at = names().index("arithmetic-45nm")
    assert listed.rows.iloc[at].tolist() == ["arithmetic-45nm", "23 nJ", *["SVM, signals: a: 41.4 nJ, 0.56 times"] * 2]
    without = results.drop(columns=[name for name in results if name in PRICED or name.startswith("events_")])
    assert [len(own) for own in real_sets.tables(without).values()] == [1]
    assert not any("By " in said for said in real_sets.named(without)["made, trials"].details)
    assert real_sets.tables(results.assign(accuracy_test=math.nan)) == {}


def ratio_rows(**ratios):
    rows = [("s", name, "net", 1.0, rivals.CHEAPEST, "SVM", 1.0, 1.0, ratio) for name, ratio in ratios.items()]
    return pd.DataFrame(rows, columns=rivals.COLUMNS)


@pytest.mark.parametrize(
    ("ratios", "said"),
    [
        ({"own": 2.0, "b": 0.99}, "it takes less by b (0.99 times)."),
        ({"own": 0.5, "b": 1.0}, "it takes more by b (1 times)."),
        ({"own": 2.0, "b": 6.1, "c": 6.0}, "the ratio is over 3 times another by b (6.1 times)."),
        ({"own": 6.1, "b": 2.0, "c": 2.1}, "the ratio is over 3 times another by b (2 times)."),
        ({"own": 2.0, "b": 7.0, "c": 0.1, "d": 8.0, "e": 9.0},
         "it takes less by c (0.1 times); the ratio is over 3 times another by b (7 times), d (8 times) and e (9 "
         "times)."),
        ({"own": 2.0, "b": 3.0}, "none of 1 other lists turns this or changes it by more than 3 times."),
    ],
)  # fmt: skip
def test_a_sentence_says_where_the_order_turns(ratios, said):
    found = rivals.turns(ratio_rows(**ratios), "own")
    assert found == f"By own the network takes {rivals.times(ratios['own'])} times the energy of SVM; {said}"
    assert rivals.turns(ratio_rows(**ratios), "another") == ""


def ways(**of):
    """A set with a network that saves nothing; a way: its accuracy, MACs, and states read and written."""
    table = {NOTHING: (0.9, 1000, 1000), **of}
    return pd.DataFrame([
        row(Cost(macs=macs, states_accesses=states), Cost(macs=macs, states_accesses=states / 10), way=way, setting="-",
            seed=seed, set="made", accuracy_test=accuracy, accuracy_validation=accuracy, sops_total=1.0, signal_ms=1.0,
            energy_estimate_nJ=macs)
        for way, (accuracy, macs, states) in table.items() for seed in range(3)
    ])  # fmt: skip


def test_what_a_way_leaves_is_by_list():
    found = energies_of_ways(ways(slower=(0.9, 900, 100), dear=(0.9, 2000, 2000), wrong=(0.1, 1, 1)))
    assert set(found["way"]) == {"slower"}
    left = found.set_index("prices")["left"]
    assert left["arithmetic-45nm"] == pytest.approx(0.9)
    for name, states in (("memory-45nm", 1000), ("memory-45nm-events", 100)):
        own = [Cost(macs=m, states_accesses=s).energy_nJ(MEMORY) for m, s in ((900, states / 10), (1000, states))]
        assert left[name] == pytest.approx(own[0] / own[1])
    assert found["clear"].all()
    assert not found["lost"].any()


def test_a_list_by_which_a_row_has_no_energy_says_nothing_of_ways():
    results = ways(slower=(0.9, 900, 100))
    results.loc[results.index[-1], "events_states_accesses"] = math.nan
    found = {*energies_of_ways(results)["prices"]}
    assert {name for name in names() if name not in found} == {"memory-45nm-events"}


def test_it_is_said_which_way_leaves_least_by_which_lists():
    results = ways(**{"refractory period": (0.9, 900, 100), "fewer taxels": (0.9, 600, 900)})
    said = fronts.answers(results)[-1]
    assert said.startswith(
        "Prices decide which way leaves the least energy. Of those that keep the accuracy it is a refractory"
    )
    assert said.endswith(
        "; fewer taxels by arithmetic-45nm, loihi, memory-45nm-events, xylo (60 to 62 %, a refractory period 85 to "
        "90 %)."
    )
    alone = fronts.answers(ways(**{"refractory period": (0.9, 900, 100)}))[-1]
    assert alone.startswith(
        "By all prices one way leaves the least energy. Of those that keep the accuracy it is a ref"
    )
    assert alone.endswith("the next way saves nothing).")
    without = fronts.answers(ways(**{"fewer taxels": (0.9, 600, 900)}))[-1]
    assert without.endswith("a refractory period saves nothing).")
    assert len(fronts.answers(ways())) == 2


def test_a_list_of_ones_own_prices_rows():
    mine = PriceList(source="mine", multiplication_pJ=1, addition_pJ=1, event_driven=True)
    found = by_list.energies(pd.DataFrame([row(Cost(macs=10), Cost(macs=3))]), [mine, ARITHMETIC])
    assert found.iloc[0].tolist() == pytest.approx([0.006, 0.046])
