"""A claim is reproduced only if its rule would rarely hold without the effect: laws, over all shipped claims."""

import tomllib
from collections.abc import Iterator
from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import thinned
from neurotact_parts.studies import exchange
from neurotact_parts.studies.exchange import arrangements, blocks_of, n_distinct
from neurotact_parts.studies.verdicts import ALPHA, State, Verdict, judge, tally
from scipy.stats import binom

from neurotact import spec
from neurotact.studies.claims import CONTRASTS, LEVELS, Claim

STUDIES = spec.shipped("studies")
CLAIMS = {path.stem: [Claim(**one) for one in tomllib.loads(path.read_text()).get("claims", [])] for path in STUDIES}
CLAIMS = {name: claims for name, claims in CLAIMS.items() if claims}
KINDS = (*LEVELS, *CONTRASTS, "order")
SEEDS = 6


def claim(kind, **rest):
    return Claim(name="c", source="Fig. 0", published="p", kind=kind, measure="x", **rest)


TOYS = {
    "value": claim("value", where={"pair": "a"}, value=0.5, tolerance=0.4),
    "at_least": claim("at_least", where={"pair": "a"}, value=0.4, each=True),
    "at_most": claim("at_most", where={"pair": "a"}, value=-0.4),
    "change": claim("change", where={"pair": "a"}, against={"pair": "b"}, value=1.0, tolerance=3.0),
    "equal": claim("equal", where={"pair": "a"}, against={"pair": "b"}, tolerance=1.5, exchange=("pair",)),
    "order": claim("order", order=(({"pair": "a"},), ({"pair": "b"},))),
}


def table(values) -> pd.DataFrame:
    """Rows of pairs a, b ... for each seed; `values`: `(seed, pair)`."""
    values = np.asarray(values, float)
    rows = [(seed, "abcdefgh"[pair], x) for (seed, pair), x in np.ndenumerate(values)]
    return pd.DataFrame(rows, columns=["seed", "pair", "x"])


def verdict(one, values, **more):
    return judge(one, {"results": table(values), **more})


# --- without an effect ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("spread", [0.3, 1.0])
def test_among_all_arrangements_of_a_table_at_most_one_of_twenty_reproduces_a_claim(kind, spread):
    """So in any table whose values do not depend on the conditions: exact, by the definition of exchangeable."""
    values = np.random.default_rng(5).normal(0, spread, 12)
    reproduced = [
        verdict(TOYS[kind], values[order].reshape(6, 2)).reproduced for order in arrangements(np.repeat(range(6), 2))
    ]
    assert len(reproduced) == 64
    assert sum(reproduced) <= ALPHA * 64


@pytest.mark.parametrize("kind", KINDS)
def test_random_tables_of_shipped_claims_reproduce_at_most_one_of_twenty(kind, request):
    """With the conditions of the claims themselves, each value drawn from the same distribution."""
    n_tables = 200 if "thorough" in request.config.getoption("-m", "") else 30
    generator = np.random.default_rng(7)
    shipped = [(study, one) for study, claims in CLAIMS.items() for one in claims if one.kind == kind]
    drawn = [shipped[n % len(shipped)] for n in generator.permutation(n_tables)]
    reproduced = 0
    for study, one in drawn:
        rows = made(study, one)
        middle = one.value if one.kind in LEVELS else 1.0
        spread = max(one.tolerance or 0.0, 0.05 * abs(middle), 0.01)
        rows[one.measure] = generator.normal(middle, spread, len(rows))
        reproduced += judge(one, {one.table: rows}).reproduced is True
    assert reproduced <= binom.ppf(0.999, n_tables, ALPHA)


@given(st.floats(-1e6, 1e6), st.integers(2, 5), st.integers(2, 5))
def test_ties_never_satisfy_an_order(value, n_seeds, n_pairs):
    """Nor do sums of the same numbers in another sequence, which differ in their last bits."""
    order = tuple(({"pair": "abcdefgh"[pair]},) for pair in range(n_pairs))
    one = claim("order", order=order)
    assert verdict(one, np.full((n_seeds, n_pairs), value)).state is State.FAILS
    numbers = value * np.random.default_rng(n_seeds).normal(size=n_seeds)
    shuffled = np.stack([np.roll(numbers, pair) for pair in range(n_pairs)], axis=1)
    assert verdict(one, shuffled).state is State.FAILS


@pytest.mark.parametrize("order", ["ab", "ba"])
def test_sums_that_differ_in_their_last_bits_are_ties(order):
    numbers = np.array([0.1, 0.2, 0.3, 0.7, 1.1])
    one = claim("order", order=tuple(({"pair": pair},) for pair in order))
    for seed in range(20):
        assert (
            verdict(one, np.stack([numbers, np.random.default_rng(seed).permutation(numbers)], axis=1)).state
            is State.FAILS
        )


def test_a_change_against_its_direction_fails_within_a_tolerance_that_includes_none():
    assert verdict(TOYS["change"], [[0.5, 0.0]] * 6).state is State.REPRODUCED
    assert verdict(TOYS["change"], [[0.0, 0.5]] * 6).state is State.FAILS
    assert verdict(TOYS["change"], [[0.5, 0.5]] * 6).state is State.FAILS


def test_a_tolerance_that_all_conditions_meet_is_no_claim():
    assert verdict(TOYS["value"], [[0.5, 0.6, 0.4]] * 6).state is State.CHANCE
    assert verdict(TOYS["value"], [[0.5, 9.0, 20.0]] * 6).state is State.REPRODUCED


def test_few_rows_cannot_tell():
    """Two seeds of two pairs have four arrangements, five of two have 32."""
    for kind in ("order", "change", "at_least"):
        assert verdict(TOYS[kind], [[1.0, 0.0]] * 4).state is State.FEW
        assert verdict(TOYS[kind], [[1.0, 0.0]] * 5).state is State.REPRODUCED


def test_rows_of_one_place_or_level_are_alike():
    """Of five rows three are selected: ten arrangements differ."""
    rows = pd.DataFrame({"pair": [*"aaabb"], "x": [1.0, 1.1, 1.2, 0.0, 0.1]})
    assert judge(TOYS["at_least"], {"results": rows}).state is State.FEW
    places = tuple(tuple({"pair": pair} for pair in place) for place in ("abc", "de"))
    assert verdict(claim("order", order=places), [[9.0, 8.0, 7.0, 2.0, 1.0]]).state is State.FEW


def test_a_relative_change_is_no_less_exact_for_large_numbers():
    one = claim("change", where={"pair": "a"}, against={"pair": "b"}, value=-0.25, tolerance=1e-6, relative=True)
    assert verdict(one, [[0.75e6, 1e6]] * 6).state is State.REPRODUCED
    assert verdict(one, [[0.7501e6, 1e6]] * 6).state is State.FAILS
    assert verdict(one, [[0.0, 0.0]] * 6).state is State.MISSING


def test_an_order_whose_steps_differ_by_orders_of_magnitude_is_seen():
    rows = [[1000.0 + seed, 10.0 + seed % 3, 1.0 + 0.1 * seed] for seed in range(4)]
    one = claim("order", order=(({"pair": "a"},), ({"pair": "b"},), ({"pair": "c"},)))
    found = verdict(one, rows)
    assert found.state is State.REPRODUCED
    assert found.p == pytest.approx(6.0**-4)


# --- equality ---------------------------------------------------------------------------------------------------------


@given(st.floats(0.2, 5.0))
def test_an_equality_is_not_satisfied_by_a_wide_interval(spread):
    """The mean change is 0; its interval of three differences s, 0 and -s is 2.48 s to both sides."""
    rows = [[spread, 0.0, 50.0], [0.0, 0.0, -50.0], [-spread, 0.0, 90.0]]
    half = 4.303 * spread / np.sqrt(3)
    for tolerance, holds in ((1.01 * half, True), (0.99 * half, False)):
        assert verdict(TOYS["equal"].model_copy(update={"tolerance": tolerance}), rows).holds is holds


def test_an_equality_of_one_pair_cannot_be_told():
    assert verdict(TOYS["equal"], [[1.0, 1.0, 5.0, 9.0, 13.0, 17.0]]).state is State.FEW
    assert verdict(TOYS["equal"], [[1.0, 3.0, 5.0]]).state is State.FAILS


def test_a_margin_that_holds_all_values_is_no_claim():
    generator = np.random.default_rng(2)
    shared = generator.normal(0, 9, (6, 1)) + generator.normal(0, 0.1, (6, 2))
    apart = np.hstack([shared, generator.normal(0, 9, (6, 2))])
    assert verdict(TOYS["equal"], apart).state is State.REPRODUCED
    wide = TOYS["equal"].model_copy(update={"tolerance": 40.0})
    assert verdict(wide, apart).state is State.CHANCE


def test_a_change_by_nothing_holds_without_the_effect():
    """As in the files of earlier runs."""
    one = claim("change", where={"pair": "a"}, against={"pair": "b"}, value=0.0, tolerance=0.5)
    assert verdict(one, [[1.0, 1.1], [1.2, 1.0]] * 3).state is State.CHANCE
    assert verdict(one, [[2.0, 1.0]] * 6).state is State.FAILS


# --- fits and baselines -----------------------------------------------------------------------------------------------


def test_a_fit_is_no_reproduction():
    fitted = TOYS["order"].model_copy(update={"fitted": "the pair"})
    assert verdict(fitted, [[1.0, 0.0]] * 6).told == "holds by a fit of the pair"
    assert verdict(fitted, [[0.0, 1.0]] * 6).state is State.FAILS


@pytest.mark.parametrize(
    ("kind", "columns", "values", "state"),
    [
        ("at_least", {"dataset": ["d"]}, [1.0], State.BASELINE),  # a baseline has no pair: it is at this level anyway
        ("at_least", {"pair": [None]}, [1.0], State.BASELINE),
        ("at_least", {"dataset": ["d"]}, [0.1], State.REPRODUCED),
        ("order", {"pair": ["a", "b"]}, [0.7, 0.6], State.BASELINE),
        ("order", {"pair": ["a", "b"]}, [0.6, 0.7], State.REPRODUCED),
        ("order", {"dataset": ["d"]}, [0.6], State.REPRODUCED),  # it cannot differ between pairs
        ("order", {"pair": ["a", None]}, [0.7, 0.6], State.REPRODUCED),
        ("order", {"pair": ["a", "c"]}, [0.7, 0.6], State.REPRODUCED),
    ],
)
def test_what_holds_for_a_baseline_is_not_the_networks(kind, columns, values, state):
    baselines = pd.DataFrame({**columns, "x": values})
    assert verdict(TOYS[kind], [[1.0, 0.0]] * 6, baselines=baselines).state is state


def test_a_baseline_need_not_have_the_conditions_that_are_alike():
    one = TOYS["order"].model_copy(update={"where": {"seed": [0, 1, 2, 3, 4]}})
    baselines = pd.DataFrame({"pair": ["a", "b"], "x": [0.7, 0.6]})
    assert verdict(one, [[1.0, 0.0]] * 6, baselines=baselines).state is State.BASELINE


def test_only_results_are_compared_with_baselines():
    other = TOYS["order"].model_copy(update={"table": "encoding"})
    baselines = pd.DataFrame({"pair": ["a", "b"], "x": [0.7, 0.6]})
    assert judge(other, {"encoding": table([[1.0, 0.0]] * 6), "baselines": baselines}).reproduced


def test_the_tally_names_every_state():
    one = TOYS["order"]
    states = [State.REPRODUCED, State.CHANCE, State.CHANCE, State.FIT, State.BASELINE, State.FEW, State.FAILS]
    assert tally([Verdict(one, "", state) for state in (*states, State.MISSING)]) == (
        "1 of 7 claims reproduced; 2 hold without the effect too; 1 holds for a baseline too; 1 holds by a fit; "
        "1 holds, in too few rows to tell; 1 need cells that this run does not hold"
    )


# --- what is exchanged ------------------------------------------------------------------------------------------------


def test_levels_are_compared_with_all_conditions_and_contrasts_with_their_own():
    rows = [[1.0, 0.0, 1.0, 1.0, 1.0]] * 5
    assert verdict(TOYS["at_least"], rows).state is State.CHANCE
    assert verdict(TOYS["order"], rows).p == pytest.approx(2.0**-5)
    everywhere = TOYS["order"].model_copy(update={"exchange": ("pair",)})
    assert verdict(everywhere, rows).p < 2.0**-5  # any pair may have the one low value


def test_values_stay_in_their_block():
    """The order of seeds is not that of pairs: within seeds the pairs differ by 1 in all, among all rows hardly."""
    rows = [[100.0 * seed + 1, 100.0 * seed] for seed in range(6)]
    assert verdict(TOYS["change"], rows).p == pytest.approx(2.0**-6)


@given(st.data())
def test_blocks_are_what_is_crossed_with_the_conditions(data):
    n_seeds, n_sizes = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 3))
    rows = pd.DataFrame([*product("ab", range(n_seeds), range(n_sizes))], columns=["pair", "seed", "hidden"])
    rows["x"] = np.random.default_rng(0).normal(size=len(rows))
    rows["y"] = rows["x"] ** 2
    rows = rows.sample(frac=1, random_state=data.draw(st.integers(0, 9)))
    condition = (rows["pair"] == "a").to_numpy().astype(int)
    blocks = blocks_of(rows, condition, ["pair", "x"])
    assert (rows.groupby(blocks)[["seed", "hidden"]].nunique() == 1).all(axis=None)
    assert len(set(blocks)) == n_seeds * n_sizes
    assert len(set(blocks_of(rows[1:], condition[1:], ["pair", "x"]))) < max(2, n_seeds * n_sizes)


@given(st.lists(st.integers(0, 2), min_size=1, max_size=12))
def test_arrangements_move_every_value_within_its_block(blocks):
    blocks = np.array(blocks)
    tried = arrangements(blocks)
    assert tried[0].tolist() == [*range(len(blocks))]
    assert (np.sort(tried, axis=1) == np.arange(len(blocks))).all()
    assert (blocks[tried] == blocks).all()


def test_random_arrangements_are_always_the_same():
    blocks = (0,) * 9
    assert (arrangements(np.array(blocks)) == exchange._arranged.__wrapped__(blocks)).all()


def test_random_arrangements_take_each_value_to_each_place_of_its_block():
    tried = arrangements(np.array([0] * 9 + [1] * 3))
    for row in range(9):
        assert (np.bincount(tried[1:, row], minlength=9) > 60).all()


def test_what_a_rule_cannot_tell_apart_is_counted_once():
    assert n_distinct(np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])) == 4
    assert n_distinct(np.array([0, 0, 1, 1]), np.array([0, 0, 1, 1])) == 1


# --- every shipped claim ----------------------------------------------------------------------------------------------


def values_of(study: str, column: str) -> list:
    """What the study's claims select in a column, and one more value if that is one alone."""
    wanted = [where[column] for one in CLAIMS[study] for where in one.selections if column in where]
    flat = [*dict.fromkeys(v for value in wanted for v in (value if isinstance(value, list) else [value]))]
    if len(flat) > 1:
        return flat
    return [*flat, *{bool: [False, True], str: ["other"]}.get(type(flat[0]), [-1.0])] if flat else [0, 1, 2, 3]


def made(study: str, one: Claim) -> pd.DataFrame:
    """The conditions of a claim, each in `SEEDS` rows: of every column what the claim selects, and a little more."""
    named: dict[str, list] = {}
    for column in dict.fromkeys([*(c for where in one.selections for c in where), *one.exchange, *one.best_over]):
        own = [where[column] for where in one.selections if column in where]
        own = [v for value in own for v in (value if isinstance(value, list) else [value])]
        others = [value for value in values_of(study, column) if value not in own]
        named[column] = [*dict.fromkeys(own), *others[: 1 if own else 3]]
    named["seed"] = [*range(SEEDS)]
    return pd.DataFrame([*product(*({}.fromkeys(values) for values in named.values()))], columns=[*named])


def matching(rows: pd.DataFrame, where: dict) -> np.ndarray:
    columns = [rows[c].isin(v if isinstance(v, list) else [v]) for c, v in where.items()]
    return np.all(columns, axis=0) if columns else np.ones(len(rows), bool)


def with_effect(study: str, one: Claim, generator: np.random.Generator) -> dict[str, pd.DataFrame]:
    """A table in which the claim is true: its rows where the paper has them, all others far away."""
    rows = made(study, one)
    far = 10 * (abs(one.value or 0.0) + (one.tolerance or 0.0) + 1)
    x = generator.choice([-far, far], len(rows)) + generator.normal(0, 0.1 * far, len(rows))
    noise = generator.normal(0, 1, len(rows))
    if one.kind in LEVELS:
        inside = one.value + {"value": 0.0, "at_least": 1e-6, "at_most": -1e-6}[one.kind]
        aside = {"value": abs(x), "at_least": one.value - abs(x), "at_most": one.value + abs(x)}[one.kind]
        x = np.where(matching(rows, one.where), inside, aside)
    elif one.kind == "order":
        for depth, place in enumerate(one.order):
            for where in place:
                x = np.where(matching(rows, {**one.where, **where}), noise - 100 * depth, x)
    else:
        differ = [c for c in one.where if one.where[c] != one.against.get(c)]
        alike = rows.groupby([c for c in rows if c not in differ]).ngroup().to_numpy()
        base = generator.normal(1000, 300, alike.max() + 1)[alike] if one.kind == "equal" else 1000 + 0 * noise
        grown = base * (1 + one.value) if one.relative and one.value else base + (one.value or 0.0)
        small = 0.01 * (abs(one.value or 0.0) or one.tolerance) * (1000 if one.relative else 1)
        x = np.where(matching(rows, one.against), base + small * noise, x)
        x = np.where(matching(rows, one.where), grown + small * noise, x)
    return {one.table: rows.assign(**{one.measure: x})}


def shipped(name: str) -> Iterator[tuple[Claim, Verdict]]:
    generator = np.random.default_rng(3)
    for one in CLAIMS[name]:
        yield one, judge(one, with_effect(name, one, generator))


@thinned("name", sorted(CLAIMS, key=lambda name: (name != "sensing-conditions", len(CLAIMS[name]))), every=4)
def test_every_shipped_claim_can_be_reproduced_and_can_fail(name):
    """Where it is true, its rule holds, and fails in 19 of 20 arrangements of the same values."""
    for one, found in shipped(name):
        assert found.p <= ALPHA, one.name
        assert found.state is (State.FIT if one.fitted else State.REPRODUCED), one.name
