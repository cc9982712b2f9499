"""All ways together: which ones are joined, and what each of them leaves when it is taken away."""

import pandas as pd
import pytest
from neurotact_parts.studies.comparison import together, ways_to_save
from neurotact_parts.studies.comparison.fronts import NOTHING
from neurotact_parts.studies.comparison.saving import Setting
from neurotact_parts.studies.comparison.together import TOGETHER, WITHOUT, parts_of, rows_of

from neurotact.errors import InputError
from neurotact.spec import build

TRIED = [
    (NOTHING, Setting()),
    ("slower clock", Setting(step_ms=5)),
    ("slower clock", Setting(step_ms=10)),
    ("refractory period, longest steps", Setting(t_ref_ms=(5, 5), longest_steps=True)),
    ("refractory period", Setting(t_ref_ms=(5, 5))),
    ("fewer hidden neurons", Setting(hidden=0.5)),
    ("pruning", Setting(prune=0.5)),
]


def row(accuracy, energy, sops=100.0):
    return {"accuracy_validation": accuracy, "accuracy_test": accuracy, "energy_estimate_nJ": energy,
            "sops_total": sops, "signal_ms": 50.0, "n_train": 10, "n_test": 10}  # fmt: skip


ROWS = [row(0.9, 100), row(0.9, 80), row(0.8, 60), row(0.9, 70), row(0.9, 90), row(0.95, 50), row(0.9, 100)]


def test_the_cheapest_setting_of_each_way_that_keeps_the_accuracy_is_joined_unless_another_has_its_keys():
    ways = [part.way for part in parts_of(TRIED, ROWS)]
    assert ways == ["fewer hidden neurons", "refractory period, longest steps"]  # one clock, one period, no saving


@pytest.mark.parametrize("loses", ["none", "t_ref_ms", "adaptation", "taxels"])
def test_a_way_stays_if_it_keeps_the_accuracy_with_those_before_it_and_each_is_taken_away(loses):
    def measure(setting):
        keys = setting.model_dump(exclude_defaults=True)
        return row(0.89 if loses not in keys else 0.88, 10) | {"keys": {*keys}}  # 1 point is kept, 2 are not

    ways = {"hidden": {"hidden": 0.5}, "t_ref_ms": {"t_ref_ms": (5, 5)}, "adaptation": {"adaptation": 0.3},
            "taxels": {"taxels": 0.5}}  # fmt: skip
    tried = [(NOTHING, Setting()), *((way, Setting(**keys)) for way, keys in ways.items())]
    rows = [row(0.9, energy) for energy in (100, 50, 60, 70, 80)]
    whole, *others = rows_of(tried, rows, measure, lambda setting: "named")
    kept = {*ways} - {loses}
    assert (whole["way"], whole["keys"]) == (TOGETHER, kept)
    assert {one["way"]: one["keys"] for one in others} == {f"{WITHOUT}{way}": kept - {way} for way in kept}


def test_nothing_is_together_where_one_way_saves_or_no_two_keep_the_accuracy():
    assert not [*rows_of(TRIED[:2], ROWS[:2], lambda setting: row(0.9, 10), lambda setting: "")]
    assert not [*rows_of(TRIED, ROWS, lambda setting: row(0.8, 10), lambda setting: "")]
    assert [*rows_of(TRIED, ROWS, lambda setting: row(0.9, 10), lambda setting: "")]


def test_single_ways_are_answered_as_without_what_joins_them_and_together_has_a_sentence():
    table = pd.DataFrame([
        {"set": "cubes", "way": way, "seed": seed,
         "setting": together.KEEPING if way.startswith(TOGETHER) else "-", **row(0.9 - lost, energy, energy)}
        for seed in range(3)
        for way, lost, energy in ((NOTHING, 0, 100.0), ("slower clock", 0, 80.0), (TOGETHER, 0.02, 20.0),
                                  (f"{WITHOUT}slower clock", 0.0, 30.0))
    ])  # fmt: skip
    assert [*together.alone(table)["way"].unique()] == [NOTHING, "slower clock"]
    said = together.answers(table)
    assert said == [
        "All ways together lose 2.0 points (-36.8 to 40.8) and leave 20 % of the SOPs and 20 % of the energy."
    ]
    (listed,) = together.listed(table)
    assert listed.rows["ways"].tolist() == [TOGETHER, f"{WITHOUT}slower clock"]
    assert listed.rows["nJ left"].tolist() == ["20 %", "30 %"]
    (whole,), (alone,) = (
        ways_to_save.named(rows.assign(skipped="")).values() for rows in (table, together.alone(table))
    )
    assert (whole.details[-1], whole.headline) == (said[0], alone.headline)
    assert [*whole.details[:-1]] == [*alone.details]
    for cost, names in whole.labels.items():
        assert {way for way, _ in names} == {NOTHING, "slower clock", TOGETHER}
        assert names.keys() - alone.labels[cost].keys() == {(TOGETHER, together.KEEPING)}


def test_all_together_is_compared_with_single_ways_where_each_seed_has_it():
    table = pd.DataFrame([
        {"set": name, "way": way, "seed": seed}
        for name, way, seeds in (("cubes", NOTHING, 3), ("cubes", TOGETHER, 3), ("cubes", f"{WITHOUT}a", 3),
                                 ("fabrics", NOTHING, 3), ("fabrics", TOGETHER, 2))
        for seed in range(seeds)
    ])  # fmt: skip
    assert [*together.shown(table).groupby(["set", "way"]).size().items()] == [
        (("cubes", NOTHING), 3), (("cubes", TOGETHER), 3), (("fabrics", NOTHING), 3)
    ]  # fmt: skip


def test_a_way_may_not_be_called_as_what_joins_all():
    with pytest.raises(InputError, match="another name"):
        build(ways_to_save.Parameters, {"data": {"set": "a", "sets": {"a": {"dataset": {"simulate": "gratings"}}}},
                                        "ways": {TOGETHER: [{"hidden": 0.5}]}}, source="test")  # fmt: skip
