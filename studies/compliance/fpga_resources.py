"""Figure of merit of feature extractors on an FPGA, over the resource counts that the compliance paper publishes.

Two tables come with this module as the paper prints them: `compliance_resources.csv` (Tables 4 and 6) and
`compliance_accuracy.csv` (Tables 3 and 5). The column `remark` marks apparent misprints and rows without an accuracy.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.studies.compliance.curve_features import COMBINATIONS

from neurotact.errors import InputError
from neurotact.files import existing

ZYNQ_XC7Z020 = {
    "lutram": 17_400,
    "bram36": 140,
    "flip_flops": 106_400,
    "lut": 53_200,
    "dsp": 220,
    "f_mux": 26_600 + 13_300,
}
"""The resources of the Zynq XC7Z020: the maxima of Eq. 3 (F7 and F8 multiplexers together)."""

REMARKS = {
    "misprint: one module": "prints the counts of one d5 module of 12 bits (14 FF, 19 LUT) for four",
    "misprint: 12 bits": "prints six d5 modules of 12 bits (84 FF, 114 LUT) for six of 16",
    "no accuracy": "Table 5 prints another combination for this cell, so its accuracy is an upper bound",
}
"""The text of each remark."""

CLASSIFIER_DELAYS_us = {8: 82.0 - 0.03, 3: 65.7 - 2.75}
"""By inputs: the published delays of features and classifier (82 and 65.7 us, Sec. 6) minus that of the features."""


class Merit(NamedTuple):
    """The figure of merit and the mean share of resources that it divides by."""

    figure: float
    resources: float


def resource_share(used: Mapping[str, float]) -> float:
    """r: the mean over six kinds of resource of the used share of the device (compliance paper, Eq. 3).

    used: counts by the names of ZYNQ_XC7Z020; all six. Raises InputError for one that is missing.

    >>> round(1e6 * resource_share({"lutram": 0, "bram36": 0, "flip_flops": 28, "lut": 38, "dsp": 0, "f_mux": 0}), 1)
    162.9
    """
    missing = [name for name in ZYNQ_XC7Z020 if name not in used]
    if missing:
        raise InputError(f"resources: '{missing[0]}' is not given; give {', '.join(ZYNQ_XC7Z020)}")
    return sum(used[name] / most for name, most in ZYNQ_XC7Z020.items()) / len(ZYNQ_XC7Z020)


def figure_of_merit(accuracy: float, inputs: int, bits: int, used: Mapping[str, float]) -> Merit:
    """The figure of merit, accuracy / (inputs x bits x r) (compliance paper, Eq. 2).

    inputs: of the classifier, over all sensors and moments; the number of components with PCA.
    Raises InputError when nothing is used or inputs or bits are below 1.
    """
    if inputs < 1 or bits < 1:
        raise InputError(f"figure of merit: inputs and bits must be at least 1; got {inputs} and {bits}")
    share = resource_share(used)
    if share <= 0:
        raise InputError("figure of merit: no resource is used, so it is undefined; give the counts")
    return Merit(accuracy / (inputs * bits * share), share)


def published_accuracy() -> pd.DataFrame:
    """Tables 3 and 5: table, sensor, bits, moments (how many), accuracy, below, combination, components.

    `below`: the paper prints "< accuracy (all cases)". `components`: 0 without PCA. Each cell is the best over the
    combinations of features (and numbers of components), on the test set.

    >>> table = published_accuracy()
    >>> float(table[(table["table"] == 3) & (table["sensor"] == "finger and palm")]["accuracy"].max())
    0.985
    """
    table = pd.read_csv(existing(Path(__file__).with_name("compliance_accuracy.csv")), keep_default_na=False)
    return table.assign(components=table["components"].replace("", 0).astype(int))


def published_resources() -> pd.DataFrame:
    """Tables 4 and 6 with the figure of merit of each row, in the paper's order.

    Columns: table, sensor, moments, combination, bits, components (0 without PCA), the six counts, delay_us (of the
    features), power_mW, remark (a key of REMARKS or empty), inputs, accuracy (of Tables 3 and 5), resources (r),
    merit, merit_share (of the best row of its table that has an accuracy of its own).

    >>> rows = published_resources()
    >>> best = rows.loc[rows[rows["remark"] != "no accuracy"].groupby("table")["merit"].idxmax()]
    >>> [(row.table, row.sensor, row.moments, row.combination, row.bits, row.components) for row in best.itertuples()]
    [(4, 'finger and palm', 1, 'd5', 12, 0), (6, 'finger and palm', 1, 'd5', 12, 3)]
    """
    table = pd.read_csv(existing(Path(__file__).with_name("compliance_resources.csv")), keep_default_na=False)
    table["components"] = table["components"].replace("", 0).astype(int)
    sensors = table["sensor"].str.count("and") + 1
    features = table["combination"].map(COMBINATIONS).str.len() * table["moments"] * sensors
    table["inputs"] = table["components"].where(table["components"] > 0, features)
    cell = published_accuracy()[["table", "sensor", "bits", "moments", "accuracy"]]
    # Table 4 belongs to Table 3, Table 6 to Table 5.
    table = table.merge(cell.assign(table=cell["table"] + 1), on=["table", "sensor", "bits", "moments"], how="left")
    used = table[list(ZYNQ_XC7Z020)].to_dict("records")
    merits = [
        figure_of_merit(row.accuracy, row.inputs, row.bits, counts)
        for row, counts in zip(table.itertuples(), used, strict=True)
    ]
    table["resources"], table["merit"] = [m.resources for m in merits], [m.figure for m in merits]
    own = table["merit"].where(table["remark"] != "no accuracy")
    table["merit_share"] = table["merit"] / own.groupby(table["table"]).transform("max")
    return table


def classifier_delay_us(inputs: np.ndarray | float) -> np.ndarray | float:
    """Delay of the k-means classifier in us, on the line through the two published points (3 and 8 inputs).

    Two points make a line, not a measurement: Fig. 15 draws more of them, the text prints these.

    >>> [round(float(classifier_delay_us(n)), 2) for n in (3, 8)]
    [62.95, 81.97]
    """
    few, many = sorted(CLASSIFIER_DELAYS_us)
    slope = (CLASSIFIER_DELAYS_us[many] - CLASSIFIER_DELAYS_us[few]) / (many - few)
    return CLASSIFIER_DELAYS_us[few] + slope * (np.asarray(inputs) - few)
