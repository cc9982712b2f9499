"""Figures and captions of the tables that only some studies have: of conditions, and those of the study's measures."""

from collections.abc import Iterator, Mapping

import pandas as pd

from neurotact.figures.columns import in_unit
from neurotact.figures.conditions import draw_conditions
from neurotact.figures.encoding import Classes
from neurotact.figures.style import Drawn
from neurotact.studies import measures
from neurotact.studies.study import StudySpec


def extra_drawings(
    study: StudySpec, results: pd.DataFrame, extra: Mapping[str, pd.DataFrame], classes: Classes
) -> Iterator[Drawn]:
    """The figures of each of these tables that exists.

    results: a run's `results.csv` with the columns `pair` and `setting`. extra: the tables by name, with `pair`.
    """
    if "conditions" in extra:
        yield _conditions(study, extra["conditions"])
    for measure in measures.requested(study.measures).values():
        if measure.draw is not None and measure.table in extra:
            yield from measure.draw(study, results, extra[measure.table], classes)


def _conditions(study: StudySpec, table: pd.DataFrame) -> Drawn:
    by = [name for name in study.dataset.stratify if name in table]
    conditions = [", ".join(in_unit(name, row[name]) for name in by) for _, row in table.iterrows()]
    table = table.assign(condition=conditions)
    figure = draw_conditions(table)
    means = table.groupby(["dataset", "known"], sort=False)["accuracy_test"].mean()
    words = [
        f"{dataset}: {100 * mean:.1f} % on {'known' if known else 'unknown'} conditions"
        for (dataset, known), mean in means.items()
    ]
    caption = (
        "Accuracy on the test trials of each condition, by the training set of the networks: means over pairs, sizes "
        "and seeds. Outlined and bold: conditions without a trial in training or validation."
    )
    return Drawn("conditions", "Known and unknown conditions", figure, caption, f"Mean accuracy: {'; '.join(words)}.")
