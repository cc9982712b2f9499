"""Which encoder a study that sweeps encoders answers, from validation trials alone (the referee's rule)."""

from collections.abc import Sequence

from neurotact.metrics.referee import best_of, level_with_best
from neurotact.report.front import Front
from neurotact.studies import sweeps
from neurotact.studies.study import StudySpec


def sentence(study: StudySpec, found: Sequence[Front]) -> str:
    """One sentence: the encoders that validation cannot tell from the best one, and the cheapest of them.

    found: the answer of each encoder (and rate, and refractory period). Empty if the study does not sweep encoders.
    """
    if len(found) < 2 or not sweeps.values(study.sweep, "encoder"):
        return ""
    ways = [one.answer.best.way(one.answer.trials) for one in found]
    level = level_with_best(ways)
    cheapest = found[min(level, key=lambda i: (ways[i].cost, -ways[i].validation))]
    best = found[best_of(ways)]
    low, high = cheapest.answer.interval
    network = cheapest.answer.best
    energy = f"{network.used.sops:.3g} SOPs" if network.used.nJ is None else f"{network.used.nJ:.3g} nJ"
    said = (
        f"{cheapest.setting} is right in {100 * network.used.accuracy:.1f} % of the test windows "
        f"(95 % interval {100 * low:.0f} to {100 * high:.0f} %) for {energy} and "
        f"{network.used.spikes:.3g} spikes"
    )
    if len(level) == 1:
        return f"Validation trials tell {best.setting} from all others as the most accurate: {said}."
    return (
        f"Validation trials cannot tell {len(level)} of {len(found)} encoders apart; the cheapest of them: {said}. The "
        f"most accurate on validation trials: {best.setting}."
    )
