"""The cheapest way that keeps the accuracy: validation chooses, test trials may speak against it, costs only order."""

from hypothesis import given
from hypothesis import strategies as st

from neurotact.metrics.referee import Way, best_of, level_with_best, within_error
from neurotact.metrics.savings import savings

NUMBERS = st.sampled_from([0.1, 0.2, 0.3, 0.4, 0.5])
TABLES = st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), min_size=1, max_size=6)


@given(TABLES, st.sets(st.integers(0, 5)), st.none() | st.sets(st.integers(0, 5)))
def test_the_cheapest_is_kept_and_what_speaks_against_it_is_named(rows, worse, among):
    ways, tested = [Way(validation, 0.1, cost) for validation, _, cost in rows], [row[1] for row in rows]
    among = among if among is None else {at for at in among if at < len(rows)}
    found = savings(ways, tested, worse, among)
    asked = range(len(rows)) if among is None else among
    assert (found.best, found.level) == (best_of(ways), level_with_best(ways))
    assert {*found.kept} == ({*within_error(ways)} & {*asked}) - worse
    assert (found.cheapest is None) == (not found.kept)
    if found.cheapest is None:
        assert not found.contrary
        return
    cheapest = ways[found.cheapest]
    assert all((cheapest.cost, -cheapest.validation) <= (ways[at].cost, -ways[at].validation) for at in found.kept)
    dominating = {
        at
        for at in asked
        if ways[at].cost <= cheapest.cost
        and tested[at] >= tested[found.cheapest]
        and (ways[at].cost < cheapest.cost or tested[at] > tested[found.cheapest])
    }
    assert {*found.contrary} == dominating
    assert [tested[at] for at in found.contrary] == sorted((tested[at] for at in found.contrary), reverse=True)


def test_of_equal_costs_the_more_accurate_on_validation_and_no_way_as_accurate_speaks_against_it_for_the_same():
    equal = [Way(0.88, 0.1, 1.0), Way(0.9, 0.1, 1.0), Way(0.5, 0.1, 1.0)]
    assert savings(equal, [0.9, 0.9, 0.9])[3:] == (1, [])
    cheaper = [Way(0.9, 0.1, 2.0), Way(0.5, 0.1, 1.0)]
    assert savings(cheaper, [0.9, 0.9]).contrary == [1]
    assert savings(cheaper, [0.9, 0.8]).is_clear


@given(TABLES)
def test_a_cost_orders_and_decides_nothing_else(rows):
    """Costs on any other scale with the same order, and of the same validation, choose the same."""
    ways, tested = [Way(validation, 0.1, cost) for validation, _, cost in rows], [row[1] for row in rows]
    other = [way._replace(cost=way.cost**3 + 7) for way in ways]
    assert savings(ways, tested) == savings(other, tested)
