"""The cost of a decision of kernel machines: support vector machines, regularised least squares."""

from dataclasses import dataclass

from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, Layer, in_registers, passed, with_weights


@dataclass(frozen=True)
class RBFExpansion(Layer):
    """Sum over `units` kernels `exp(-gamma |x - u|²)`, for each of `outputs` (RLS, SVM).

    An RLS has a unit for every training example, an SVM one for every support vector. `outputs` machines may share
    their units (RLS one against all); otherwise give one expansion a machine. `bias`: one number an output (the SVM of
    two classes). Machines of all pairs of classes are a `SupportVectorMachines`.
    """

    units: int
    features: int
    outputs: int = 1
    bias: bool = False

    def cost(self) -> Cost:
        differences = self.units * self.features
        weighted = self.units * self.outputs
        parameters = differences + weighted + self.outputs * self.bias + 1
        kernels = in_registers(multiplications=1, exponentials=1).times(self.units)  # gamma times the distance; its exp
        moved = {"weights_accesses": parameters, **passed(self.features + self.units, self.units + self.outputs)}
        return with_weights(parameters, macs=differences + weighted, acs=differences, **moved) + kernels


@dataclass(frozen=True)
class SupportVectorMachines(Layer):
    """RBF machines of all pairs of `classes`, one against one, that share `vectors` support vectors (libsvm's form).

    A vector takes part in the machines of its class with every other class, so that it has `classes - 1` coefficients;
    each of the `classes (classes - 1) / 2` machines has a bias. Kernels are computed once. That the machines vote is
    not counted, as the comparison of a network's outputs is not.

    >>> SupportVectorMachines(vectors=10, features=3, classes=4).cost().parameters  # 30 + 30 + 6 + gamma
    67
    """

    vectors: int
    features: int
    classes: int

    def cost(self) -> Cost:
        if self.classes < 2:
            raise InputError(f"SupportVectorMachines.classes: must be at least 2; got {self.classes}")
        expansion = RBFExpansion(self.vectors, self.features, outputs=self.classes - 1).cost()
        biases = self.classes * (self.classes - 1) // 2
        return expansion + with_weights(biases, weights_accesses=biases)
