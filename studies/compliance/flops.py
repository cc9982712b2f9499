"""The costs of tactile moments and of the features of their curves, for the ledger of `neurotact.metrics.flops`."""

from dataclasses import dataclass

from neurotact.metrics.flops import Cost, Layer, changed, passed, with_weights


@dataclass(frozen=True)
class TactileMoments(Layer):
    """Raw moments of `frames` images of `taxels` taxels (compliance paper, Eq. 1).

    The moment of order 0 only adds; each other takes a multiplication and an addition per taxel. The weights are
    coordinates, which are not stored. `first_is_sum`: the moments begin with M00.
    """

    taxels: int
    frames: int
    moments: int

    def cost(self) -> Cost:
        samples = self.taxels * self.frames
        moved = {**changed(samples * self.moments), **passed(0, self.moments)}
        return with_weights(0, self.moments, macs=samples * (self.moments - 1), acs=samples, **moved)


@dataclass(frozen=True)
class CurveFeatures(Layer):
    """AR, MAX, H1 and H2 of `curves` curves of `frames` samples: an addition per sample for AR, registers for the rest.

    areas: 1 if AR is among the features, else 0 additions. held: number of MAX, H1 and H2 in use; each takes a
    comparison of the sample's number (compliance paper, Fig. 8).
    """

    curves: int
    frames: int
    areas: float
    held: float

    def cost(self) -> Cost:
        samples = self.curves * self.frames
        kept = int(self.curves * (self.areas + self.held))
        moved = {**changed(samples * (self.areas + self.held)), **passed(0, kept)}
        return with_weights(0, kept, acs=samples * self.areas, comparisons=samples * self.held, **moved)


@dataclass(frozen=True)
class Projection(Layer):
    """Projection of centred features on `components` axes (PCA)."""

    features: int
    components: int

    def cost(self) -> Cost:
        parameters = self.features * self.components + self.features
        macs = self.features * self.components
        moved = {"weights_accesses": parameters, **passed(self.features, self.components)}
        return with_weights(parameters, macs=macs, acs=self.features, **moved)
