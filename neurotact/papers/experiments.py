"""Every experiment that can be simulated, by the name that a study and the command line give it."""

from collections.abc import Callable
from typing import Any, NamedTuple

from neurotact.data.recordings import Recordings
from neurotact.papers.compliance import simulator as compliance
from neurotact.papers.materials import simulator as contact_materials
from neurotact.papers.stiffness import simulator as stiffness
from neurotact.papers.texture import simulator as gratings
from neurotact.papers.touch_modality import simulator as touch_modality
from neurotact.spec import Spec


class Experiment(NamedTuple):
    """A simulator.

    about: what it simulates, in a line.
    model: its spec, which has the property `n_trials`.
    simulate: called as `simulate(spec, progress)`; `progress(done, total)` counts trials.
    """

    about: str
    model: type[Spec]
    simulate: Callable[[Any, Callable[[int, int], None] | None], Recordings]


EXPERIMENTS = {
    "gratings": Experiment(
        "A PVDF finger sliding over eight gratings (texture paper).", gratings.GratingsSpec, gratings.simulate
    ),
    "stiffness": Experiment(
        "A gripper with four PVDF channels on objects of three stiffnesses (stiffness paper).",
        stiffness.StiffnessSpec,
        stiffness.simulate,
    ),
    "touch-modality": Experiment(
        "People who slide, brush and roll on a 4 x 4 array (touch-modality paper).",
        touch_modality.TouchModalitySpec,
        touch_modality.simulate,
    ),
    "contact-materials": Experiment(
        "Probes of four materials shaken on one piezoelectric element (materials paper).",
        contact_materials.ContactMaterialsSpec,
        contact_materials.simulate,
    ),
    "compliance": Experiment(
        "42 objects squeezed between two tactile arrays: the moments of their images (compliance paper).",
        compliance.ComplianceSpec,
        compliance.simulate,
    ),
}
