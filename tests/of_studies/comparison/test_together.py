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


@pytest.mark.parametrize("loses", [False, True])
def test_ways_are_dropped_until_the_accuracy_is_kept_and_each_is_taken_away(loses):
    asked = []

    def measure(setting):
        asked.append(setting)
        return row(0.5 if loses and setting.adaptation else 0.9, 10)

    tried = [*TRIED[:1], *TRIED[5:6], TRIED[3], ("adaptive thresholds", Setting(adaptation=0.3))]
    found = [*rows_of(tried, [ROWS[0], row(0.9, 50), row(0.9, 70), row(0.9, 90)], measure, lambda setting: "named")]
    names = [one["way"] for one in found]
    assert names[0] == TOGETHER
    assert all(name.startswith(WITHOUT) for name in names[1:])
    assert (f"{WITHOUT}adaptive thresholds" in names) == (not loses)
    without = {one["way"]: setting for one, setting in zip(found, asked[-len(found) :], strict=True)}
    assert without[f"{WITHOUT}fewer hidden neurons"].hidden == 1
    assert without[TOGETHER].hidden == 0.5
    assert not [*rows_of(TRIED[:2], ROWS[:2], measure, lambda setting: "")]  # one way has nothing to be joined with


def test_single_ways_are_answered_as_without_what_joins_them_and_together_has_a_sentence():
    table = pd.DataFrame([
        {"set": "cubes", "way": way, "setting": "-", "seed": seed, **row(0.9 - lost, energy, energy)}
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
    answers = ways_to_save.answers(table.assign(skipped=""))
    assert answers[-1] == said[0]
    assert answers[:-1] == ways_to_save.answers(together.alone(table).assign(skipped=""))


def test_a_way_may_not_be_called_as_what_joins_all():
    with pytest.raises(InputError, match="another name"):
        build(ways_to_save.Parameters, {"data": {"set": "a", "sets": {"a": {"dataset": {"simulate": "gratings"}}}},
                                        "ways": {TOGETHER: [{"hidden": 0.5}]}}, source="test")  # fmt: skip
