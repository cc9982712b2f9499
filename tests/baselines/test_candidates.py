"""How the candidates of a family of classifiers are chosen."""

from hypothesis import given
from hypothesis import strategies as st

from neurotact.baselines.families import first_best


@given(st.lists(st.sampled_from([0.0, 0.5, 0.9, 1.0]), min_size=1))
def test_the_first_of_the_best_is_chosen_and_none_is_fitted_after_one_without_an_error(accuracies):
    fitted = []

    def fit(order):
        fitted.append(order)
        return accuracies[order], order

    assert first_best(map(fit, range(len(accuracies)))) == (max(accuracies), accuracies.index(max(accuracies)))
    assert len(fitted) == (accuracies.index(1.0) + 1 if 1.0 in accuracies else len(accuracies))
