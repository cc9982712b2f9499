"""The published resource counts, Eqs. 2 and 3 by hand, and the two published best cases."""

import pytest
from neurotact_parts.studies.compliance.fpga_resources import (
    REMARKS,
    ZYNQ_XC7Z020,
    classifier_delay_us,
    figure_of_merit,
    published_accuracy,
    published_resources,
    resource_share,
)

from neurotact.errors import InputError

NONE = dict.fromkeys(ZYNQ_XC7Z020, 0)


def test_figure_of_merit_by_hand():
    used = NONE | {"flip_flops": 28, "lut": 38}
    merit = figure_of_merit(0.945, inputs=4, bits=12, used=used)
    assert merit.resources == pytest.approx((28 / 106400 + 38 / 53200) / 6)
    assert merit.figure == pytest.approx(0.945 / (4 * 12 * (28 / 106400 + 38 / 53200) / 6))
    assert round(merit.figure, 1) == 120.9


def test_every_kind_of_resource_weighs_the_same():
    shares = [resource_share(NONE | {name: most}) for name, most in ZYNQ_XC7Z020.items()]
    assert shares == pytest.approx([1 / 6] * 6)


def test_refuses_what_has_no_value():
    with pytest.raises(InputError, match="'lut' is not given"):
        resource_share({name: 1 for name in ZYNQ_XC7Z020 if name != "lut"})
    with pytest.raises(InputError, match="no resource is used"):
        figure_of_merit(0.9, 4, 12, NONE)
    with pytest.raises(InputError, match="at least 1"):
        figure_of_merit(0.9, 0, 12, NONE | {"lut": 1})


def test_the_two_published_best_cases_come_out():
    rows = published_resources()
    for table, components in ((4, 0), (6, 3)):
        own = rows[(rows["table"] == table) & (rows["remark"] != "no accuracy")]
        best = own.loc[own["merit"].idxmax()]
        assert (best.sensor, best.moments, best.combination, best.bits) == ("finger and palm", 1, "d5", 12)
        assert best.components == components
        assert best.merit_share == 1.0


def test_bounds_do_not_overtake_the_best_case():
    rows = published_resources()
    assert (rows["merit_share"] <= 1.0).all()


def test_rows_are_those_of_the_paper():
    rows, cells = published_resources(), published_accuracy()
    assert rows["table"].value_counts().to_dict() == {4: 9, 6: 9}
    assert cells["table"].value_counts().to_dict() == {3: 54, 5: 54}
    assert not rows["accuracy"].isna().any()
    assert set(rows["remark"]) == {"", *REMARKS}
    inputs = rows[rows["table"] == 4]["inputs"].tolist()
    assert inputs == [8, 4, 8, 12, 24, 16, 30, 36, 12]
    assert (rows[rows["table"] == 6]["inputs"] == rows[rows["table"] == 6]["components"]).all()


def test_misprints_are_where_modules_do_not_add_up():
    """Without PCA a row is as many equal modules as it has moments and sensors: 14 FF and 19 LUT for d5 at 12 bits."""
    rows = published_resources()
    d5 = rows[(rows["table"] == 4) & (rows["combination"] == "d5") & (rows["bits"] == 12)]
    for row in d5.itertuples():
        modules = row.moments * (2 if "and" in row.sensor else 1)
        expected = (modules * 14, modules * 19)
        assert ((row.flip_flops, row.lut) == expected) == (row.remark == "")
    by_bits = rows[(rows["table"] == 4) & (rows["combination"] == "d5") & (rows["bits"] == 16)].set_index("sensor")
    assert by_bits.loc["finger and palm", "flip_flops"] / 6 == 18  # a module of 16 bits
    assert by_bits.loc["palm", "flip_flops"] / 6 == 14  # six modules too, but of 12 bits
    assert by_bits.loc["palm", "remark"] == "misprint: 12 bits"


def test_rows_without_accuracy_are_those_whose_cell_names_another_case():
    rows = published_resources()
    cells = published_accuracy().set_index(["table", "sensor", "bits", "moments"])
    for row in rows.itertuples():
        cell = cells.loc[(row.table - 1, row.sensor, row.bits, row.moments)]
        same = (cell.combination, cell.components) == (row.combination, row.components)
        assert same == (row.remark != "no accuracy")


def test_published_delays_are_met():
    rows = published_resources().set_index(["table", "sensor"])
    for table, total_us in ((4, 82.0), (6, 65.7)):
        row = rows.loc[(table, "finger")]
        assert classifier_delay_us(row.inputs) + row.delay_us == pytest.approx(total_us)
