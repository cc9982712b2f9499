"""Compiled kernels of neurotact (native/module.cpp). Addresses point at dense tensors on the CPU; 0 is none."""

from typing import TypedDict, Unpack

from numpy import ndarray
from torch import Tensor

Decided = tuple[int, int, int, int, int, int, int, bool] | tuple[int, int, int, int, int, int, int, bool, int]

class Tally(TypedDict):
    """What spikes are tallied into (`encoders.native.Tally.at`)."""

    bin_of: int
    bins: int
    floor: int
    ends: int
    pitch: int
    last_spike: int
    intervals: int
    at_floor: int

class Shape:
    """Sizes, neuron and layout of a network, made once and used for every call."""

class Stream:
    """A chain that takes samples; it copies weights, offsets and scales from their addresses."""

    def __init__(self, shape: Shape, **plan: float | list[float]) -> None: ...
    def push(self, *, samples: ndarray, held: bool) -> list[Decided] | None: ...
    def take(self, samples: object, /) -> list[Decided] | None: ...
    def counted(self) -> tuple[int, bytes]: ...
    def watch(self, room: int, /) -> None: ...
    def watched(self) -> tuple[int, bytes, bytes, bytes]: ...
    def state(self) -> bytes: ...
    def restore(self, state: bytes, /) -> None: ...

def make_shape(
    *,
    inputs: int,
    hidden: int,
    classes: int,
    membrane: int,
    reset: int,
    recurrent_delay: int,
    adaptation: float,
    adaptation_decay: float,
    scale: float,
    readout_scale: float,
    is_double: bool,
    recurrent: bool,
    per_neuron: bool,
    keep_currents: bool,
    with_inputs: bool,
    with_raster: bool,
    leaks: bool,
    peak: bool,
    decay: float,
    stretches: int = 1,
    stretch_steps: int = 1,
    direct: bool = False,
) -> Shape: ...
def tape_bytes(shape: Shape, *, trials: int, steps: int) -> int: ...
def new_tape(shape: Shape, *, trials: int, steps: int) -> Tensor: ...
def forward(
    shape: Shape,
    *,
    trials: int,
    steps: int,
    spikes: int,
    spike_kind: int,
    trial_stride: int,
    time_stride: int,
    w_in: int,
    w_rec: int,
    w_out: int,
    alpha: int,
    beta: int,
    threshold: int,
    tape: int,
    readout: int,
    hidden: int,
    raster: int,
    threads: int,
) -> bool: ...
def backward(
    shape: Shape,
    *,
    trials: int,
    steps: int,
    tape: int,
    w_in: int,
    w_rec: int,
    w_out: int,
    alpha: int,
    beta: int,
    threshold: int,
    g_readout: int,
    g_hidden: int,
    g_raster: int,
    g_w_in: int,
    g_w_rec: int,
    g_w_out: int,
    g_spikes: int,
    g_dynamics: int,
    threads: int,
) -> None: ...
def infer(
    shape: Shape,
    *,
    trials: int,
    steps: int,
    spikes: int,
    spike_kind: int,
    trial_stride: int,
    time_stride: int,
    w_in: int,
    w_rec: int,
    w_out: int,
    alpha: int,
    beta: int,
    threshold: int,
    bias: int,
    patience: int,
    from_first_spike: bool,
    labels: int,
    steps_run: int,
    input_spikes: int,
    hidden_spikes: int,
    counts: int,
    sums: int,
    threads: int,
) -> bool: ...
def encode(
    *,
    is_double: bool,
    trials: int,
    steps: int,
    taxels: int,
    signal: int,
    trial_stride: int,
    time_stride: int,
    sa_gain: float,
    ra_gain: float,
    decay: float,
    v_rest: float,
    v_reset: float,
    v_threshold: float,
    sa_silent: int,
    ra_silent: int,
    sa_membrane: int,
    ra_membrane: int,
    last: int,
    sa_silent_left: int,
    ra_silent_left: int,
    has_last: bool,
    spikes: int,
    threads: int,
) -> None: ...
def encode_exact(
    *,
    is_double: bool,
    trials: int,
    samples: int,
    steps: int,
    afferents: int,
    drive: int,
    t_ref_ms: int,
    tau_ms: float,
    v_rest: float,
    v_reset: float,
    v_threshold: float,
    sample_ms: float,
    steps_per_ms: float,
    steps_per_sample: float,
    samples_before: int,
    first_step: int,
    membrane: int,
    refractory_ms: int,
    spikes: int,
    threads: int,
) -> None: ...

# Called with a dictionary of arguments, each by name (encoders/compiled.py).
def izhikevich(**given: float) -> float: ...
def bens_spiker(**given: float) -> None: ...
def mechanoreceptors(**given: float) -> None: ...
def free_spare_blocks() -> None: ...
def isa() -> str: ...
def widest_isa() -> str: ...
def set_isa(name: str, /) -> None: ...
def tally_raster(
    *,
    spikes: int,
    trials: int,
    trial_stride: int,
    time_stride: int,
    afferents: int,
    **tally: Unpack[Tally],
) -> None: ...
def tally_population(
    *,
    trials: int,
    steps: int,
    taxels: int,
    felt: int,
    gain: float,
    decay: float,
    v_rest: float,
    v_reset: float,
    v_threshold: float,
    silent: int,
    threads: int,
    **tally: Unpack[Tally],
) -> None: ...
def tally_exact(
    *,
    trials: int,
    samples: int,
    afferents: int,
    drive: int,
    t_ref_ms: int,
    tau_ms: float,
    v_rest: float,
    v_reset: float,
    v_threshold: float,
    sample_ms: float,
    steps_per_ms: float,
    steps_per_sample: float,
    membrane: int,
    refractory_ms: int,
    threads: int,
    **tally: Unpack[Tally],
) -> None: ...
def moving_average(
    *, signal: int, before: int, newest: float, kept: float, trials: int, steps: int, taxels: int, smooth: int
) -> None: ...
def class_sums(*, rows: int, labels: int, labellings: int, trials: int, classes: int, n: int, sums: int) -> None: ...
