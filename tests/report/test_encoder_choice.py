"""Which encoder: validation chooses, and of those that it cannot tell apart the cheapest is named."""

from types import SimpleNamespace

import pytest

from neurotact.report.answer import Decision, Network, Trials
from neurotact.report.encoder_choice import sentence


def front(name, validation, nJ, n_validation=200):
    whole = Decision(validation, 100.0, 300.0, 20.0, nJ)
    network = Network("1&1", 20, 1, validation, whole, None)
    answer = SimpleNamespace(best=network, interval=(0.7, 0.9), trials=Trials(n_validation, 50))
    return SimpleNamespace(setting=name, answer=answer)


def said(*fronts, sweep=("lif", "burst")):
    return sentence(SimpleNamespace(sweep={"encoder": [*sweep]}), fronts)  # type: ignore[arg-type]


def test_the_cheapest_of_those_that_validation_cannot_tell_apart_is_named():
    words = said(front("lif", 0.9, 50.0), front("burst", 0.89, 30.0), front("latency", 0.5, 1.0))
    assert words.startswith(
        "Validation trials cannot tell 2 of 3 encoders apart; the cheapest of them: burst is right in"
    )
    assert "89.0 % of the test windows (95 % interval 70 to 90 %) for 30 nJ and 20 spikes" in words
    assert words.endswith("The most accurate on validation trials: lif.")


def test_an_encoder_that_validation_tells_from_all_others_is_the_answer():
    words = said(front("lif", 0.95, 50.0), front("burst", 0.6, 1.0))
    assert words.startswith("Validation trials tell lif from all others as the most accurate: lif is right in 95.0 %")


@pytest.mark.parametrize("sweep", [{}, {"seed": [0]}])
def test_other_studies_say_nothing_of_encoders(sweep):
    fronts = [front("lif", 0.9, 1.0), front("burst", 0.9, 1.0)]
    assert sentence(SimpleNamespace(sweep=sweep), fronts) == ""  # type: ignore[arg-type]
