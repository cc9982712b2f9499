"""What a network spec says (`networks/*.toml`)."""

from typing import Any, ClassVar, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from neurotact.neurons import Membrane, Reset
from neurotact.spec import Spec


class TrainingSpec(Spec):
    """How a network is trained (texture paper, Sec. III-B; loss and regularisers from the Braille study)."""

    learning_rate: float = Field(default=1e-3, gt=0)
    batch: int = Field(default=128, ge=1)
    epochs: int = Field(default=100, ge=1)
    patience: int = Field(default=7, ge=1)
    """Epochs without a better validation loss after which training stops."""
    rate_penalty: float = Field(default=0.0015, ge=0)
    """lambda1, on the mean over trials and hidden neurons of the spikes in a window."""
    population_penalty: float = Field(default=0.0, ge=0)
    """lambda2, on the mean over hidden neurons of the squared spike count of a batch."""


class RSNNSpec(Spec):
    """A spiking network with a spiking readout: recurrent (texture paper, Fig. 1c and Eqs. 4 to 7) or feed-forward."""

    folder: ClassVar[str] = "networks"

    model: Literal["rsnn", "snn"] = "rsnn"
    """rsnn: the hidden layer is recurrent; snn: it is not, and the two `recurrent_...` keys are not looked at."""
    hidden: int = Field(default=30, ge=1, le=1024)
    """Neurons in the hidden layer."""
    membrane: Membrane = "eq4"
    reset: Reset = "zero"
    recurrent_delay_steps: int = Field(default=0, ge=0, le=1, strict=True)
    """d of `I[t+1] = alpha I[t] + W x[t] + V s[t-d]`: by how many steps a hidden spike comes back later."""
    tau_mem_ms: float = Field(default=20.0, gt=0)
    tau_syn_ms: float = Field(default=10.0, gt=0)
    surrogate_scale: float = Field(default=10.0, gt=0)
    """lambda of the fast sigmoid."""
    forward_weight_scale: float = Field(default=1.0, gt=0)
    """g: w ~ N(0, (g / sqrt(fan-in))^2)."""
    recurrent_weight_scale: float = Field(default=0.1, ge=0)
    """r: v ~ N(0, (g r / sqrt(hidden))^2)."""
    learn: tuple[Literal["alpha", "beta", "threshold"], ...] = ()
    """Which dynamics are learned with the weights: one value for the hidden layer, one for the readout."""
    training: TrainingSpec = TrainingSpec()

    @property
    def recurrent(self) -> bool:
        """Whether hidden neurons hear one another."""
        return self.model == "rsnn"

    @model_serializer(mode="wrap")
    def _without_no_delay(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A spec without a delay is written as before there were delays: seeds are drawn from what is written."""
        table = dump(self)
        if self.recurrent_delay_steps == 0:
            table.pop("recurrent_delay_steps", None)
        return table
