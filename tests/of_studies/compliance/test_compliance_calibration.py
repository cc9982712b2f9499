"""The signal facts of the compliance paper hold on the simulation as shipped."""

import compliance_calibration
import pandas as pd
import pytest
from neurotact_parts.studies.compliance.simulator import ComplianceSpec


def test_every_fact_holds_as_shipped():
    facts = compliance_calibration.facts_of(compliance_calibration.measure(ComplianceSpec()))
    missed = [f"{fact.fact}: {fact.target}; {fact.reached}" for fact in facts if not fact.holds]
    assert not missed
    assert len(facts) == 12


def test_facts_can_fail():
    still = ComplianceSpec(travel_mm=6.0, sampling_rate_Hz=50.0)
    measured = compliance_calibration.measure(still)
    missed = [fact.fact for fact in compliance_calibration.movement_facts(measured) if not fact.holds]
    assert missed == ["time to the turn"]
    alike = ComplianceSpec(sampling_rate_Hz=50.0, palm=ComplianceSpec().palm.model_copy(update={"crosstalk": 0.0}))
    missed = [f.fact for f in compliance_calibration.sensor_facts(measured._replace(spec=alike)) if not f.holds]
    assert missed == ["crosstalk"]


def test_pictures_are_drawn():
    spec = ComplianceSpec(sampling_rate_Hz=50.0)
    shown = compliance_calibration.shown(spec, ("OBJ-17", "OBJ-37"))
    assert [one.label for one in shown] == ["OBJ-17", "OBJ-37"]
    assert (shown[0].finger.shape, shown[0].palm.shape) == ((11, 4), (16, 16))
    *panels, scale = compliance_calibration.draw_squeezes(shown).axes
    assert len(panels) == 6
    assert scale.get_ylabel()


@pytest.mark.slow
def test_facts_read_as_a_table(capsys, tmp_path):
    assert compliance_calibration.main(["-o", str(tmp_path)]) == 0
    assert "12 of 12 facts hold" in capsys.readouterr().out
    assert pd.read_csv(tmp_path / "facts.csv")["holds"].all()
    assert {path.name for path in tmp_path.glob("*.png")} == {
        "compliance-curves.png",
        "compliance-features.png",
        "compliance-squeezes.png",
    }
