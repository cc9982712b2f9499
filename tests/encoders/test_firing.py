"""What is said of afferents that do not suit what they encode."""

import numpy as np

from neurotact.encoders.firing import complaints
from neurotact.encoders.specs import load


def said(counts, encoder, n_steps=100, clock_Hz=1000.0):
    return list(complaints(np.array(counts), n_steps, clock_Hz, encoder))


def test_silence_and_saturation_are_said_of_each_population():
    lif = load("sa1-ra1-lif", {"sa1.t_ref_ms": 1, "ra1.t_ref_ms": 1})
    assert said([10, 10], lif) == []
    assert [line.split(";")[0] for line in said([0, 10], lif)] == ["no SA-I afferent fires in any trial"]
    (line,) = said([10, 50], lif)  # a spike every second step is all that one silent step allows
    assert line.startswith("every RA-I afferent that fires does so at over 90% of the 500 Hz")
    assert "lower ra1.gain" in line
