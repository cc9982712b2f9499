"""The deployed chain: an encoder with causal conditioning, a network and its exit rule.

The network of a sensor that sends events has no encoder: events are its spikes, and a step of its clock is a sample of
0 and 1 for each afferent. `PASSING` stands where an encoder would, so that all that runs a chain runs it.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import numpy as np
from neurotact_parts.streams.streamed import StreamedSpec
from neurotact_parts.streams.windows import WindowPlan

from neurotact import plugins
from neurotact.data.conditioning import conditioned_length
from neurotact.data.recordings import check_sampling_rate
from neurotact.data.windows import LONGEST_STEPS, WindowSpec
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.model import EncoderSpec, name_in, of_name
from neurotact.encoders.specs import (
    conditioning_of,
    known_taxels,
    n_afferents,
    of_used,
    populations,
    taxel_names,
    taxels_of,
)
from neurotact.errors import InputError, number_of
from neurotact.networks.definition.executors import LIF_INSTEAD, Subject, require
from neurotact.networks.definition.rsnn import RSNN, rsnn_of
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training.events import DetectorSpec
from neurotact.networks.training.run_folder import Restored
from neurotact.networks.use import fitted
from neurotact.networks.use.fitted import Fitted
from neurotact.spec import build, takes_specs

LARGEST = 1e20
"""A sample beyond it counts as missing, as an infinite one does: what a chain computes from others stays finite."""
LARGEST_FACTOR = 1e6
"""Between two units of samples."""
MOST_SAMPLES_A_STEP = 1_000_000
"""Samples for each step of the encoder's clock; more are a wrong rate, of which a counter would overflow."""

OF_ONSETS = (
    "{}: was trained on windows from the onset of contact, which is not looked for here; give `streamed=nt.Streamed("
    "contact=True)` for windows from the first spike, `streamed=nt.Streamed(hop_ms=20)` for windows at all times, or "
    "train it without `align`"
)
WITHOUT_END = WindowPlan(LONGEST_STEPS, 0, LONGEST_STEPS)
"""Of a detector."""
PASSING = AfferentSpec.model_validate({
    "v_rest_mV": 0, "v_reset_mV": 0, "v_threshold_mV": 0.5, "tau_mem_ms": 1e-9,
    "sa1": {"gain": 1, "t_ref_ms": 0}, "ra1": {"gain": 1, "t_ref_ms": 0, "taxels": []},
})  # fmt: skip
"""In place of an encoder: neurons without memory that give each spike as it is."""


class Chain(NamedTuple):
    """Conditioning and encoder, network, exit rule and windows.

    sampling_rate_Hz: of the input samples; equals the network's clock unless the encoder resamples.
    taxels: their names in the order of the network's training; None if unknown. Of events, the names of the afferents.
    takes_events: whether the network takes the events of a sensor; the encoder is then `PASSING`, and no part of it.
    detector: when an event begins, of a network that runs on without windows; None for windows.
    """

    encoder: EncoderSpec
    network: RSNN
    rule: ExitRule
    classes: tuple[str, ...]
    windows: WindowPlan
    sampling_rate_Hz: float
    taxels: tuple[str, ...] | None = None
    takes_events: bool = False
    tells_numbers: bool = False
    detector: DetectorSpec | None = None

    @property
    def clock_Hz(self) -> float:  # noqa: N802
        """Steps of the encoder and the network per second."""
        return self.network.sampling_rate_Hz

    @property
    def signal_Hz(self) -> float:  # noqa: N802
        """Conditioned samples per second, as the encoder takes them: those of its clock, or of the sensor."""
        return conditioning_of(self.encoder, self.sampling_rate_Hz).clock_Hz(self.sampling_rate_Hz)

    @property
    def n_taxels(self) -> int:
        """Values of a sample, also of taxels that no afferent uses."""
        return taxels_of(self.network.n_inputs, self.encoder.model_dump())

    def of_used(self) -> tuple[list[int], "Chain"]:
        """The taxels that an afferent uses, and the chain for samples of these alone, which decides the same."""
        columns, encoder = of_used(self.encoder, self.n_taxels)
        taxels = self.taxels and tuple(self.taxels[column] for column in columns)
        return columns, self._replace(encoder=encoder, taxels=taxels)

    @property
    def lif(self) -> AfferentSpec:
        """The encoder, for programs that have LIF afferents alone; InputError for another model."""
        if not isinstance(self.encoder, AfferentSpec):
            raise InputError(
                f"encoder: must have LIF afferents here; its model is '{self.encoder.model}'; {LIF_INSTEAD}"
            )
        return self.encoder

    @property
    def subject(self) -> Subject:
        """What the table of executors judges."""
        return Subject(None if self.takes_events else self.encoder, self.network, self.rule, self.detector is not None)


@takes_specs
def chain_of(source: Fitted | Restored | tuple[EncoderSpec, RSNN], streamed: StreamedSpec = StreamedSpec()) -> Chain:
    """The chain of a run folder that `train` wrote, of a fitted one, of one read back, or of an encoder and a network.

    streamed: what is not given is as in training. If the encoder resamples, the sampling rate is then that of the
    recordings that the network was trained on, where it is known; otherwise it is equal to the clock.
    Raises InputError, which names the fix, for what cannot run sample by sample.
    """
    rule, classes, trained, tells_numbers = FULL_WINDOW, None, WindowSpec(), False
    sampling_rate_Hz, recorded_Hz = streamed.sampling_rate_Hz, None
    taxels: tuple[str, ...] | None = None
    detector = None
    if isinstance(source, Restored) or not isinstance(source, tuple):
        restored = cast(Restored, source) if isinstance(source, Restored) else fitted.restore(source)
        encoder, classes, tells_numbers = front_of(restored), restored.classes, bool(restored.task.numbers)
        network = rsnn_of("stream", restored.network)
        rule = restored.exits(not streamed.full_window)
        recorded_Hz, trained, detector = restored.recorded_Hz, restored.task.window, restored.detector
        if trained.align == "onset" and not (streamed.contact or streamed.hop_ms):
            raise InputError(OF_ONSETS.format(restored.source))
        if encoder is None:
            taxels = restored.afferents
        elif restored.afferents is not None:
            taxels = taxel_names(restored.afferents, restored.encoder or {})
    else:
        encoder, given = source
        network = rsnn_of("stream", given)
    require("stream", Subject(encoder, network, rule))
    takes_events, encoder = encoder is None, encoder or PASSING
    _check_taxels(encoder, network)
    clock_Hz = network.sampling_rate_Hz
    if detector is not None and (given := streamed.given().keys() - {"sampling_rate_Hz"}):
        raise InputError(f"`{min(given)}`: a detector runs on without windows; leave it out")
    windows = WindowPlan.of(clock_Hz, streamed, trained) if detector is None else WITHOUT_END
    if sampling_rate_Hz is None and encoder.conditioning.resample_Hz is not None:
        sampling_rate_Hz = recorded_Hz
    rate_Hz = _input_rate(encoder, clock_Hz, sampling_rate_Hz)
    _check_range(encoder, conditioning_of(encoder, rate_Hz).clock_Hz(rate_Hz))
    classes = classes or tuple(str(index) for index in range(network.n_classes))
    return Chain(encoder, network.cpu(), rule, classes, windows, rate_Hz, taxels, takes_events, tells_numbers, detector)


def front_of(restored: Restored) -> EncoderSpec | None:
    """The encoder that a network was trained with; None if it was trained on the events of a sensor.

    InputError where it is not known which.
    """
    return None if restored.encoder == {} else build_encoder(restored)


def build_encoder(restored: Restored) -> EncoderSpec:
    """The encoder that a network was trained with; InputError where it is not known."""
    if restored.encoder is None:
        raise InputError(
            f"{restored.source}: was fitted on an array that does not say its encoder; fit it on `nt.windows(...).X` "
            "or, in a pipeline, behind nt.SpikeEncoder"
        )
    return encoder_of(restored.encoder, restored.source)


def encoder_of(table: Mapping[str, Any], source: object) -> EncoderSpec:
    """The encoder of a saved table; InputError for an unknown model."""
    model = name_in(table)
    if not plugins.has("encoders", model):
        raise InputError(f"{source}: its encoder model '{model}' is unknown; train the network again")
    return build(of_name(model).spec, dict(table), source=f"{source}, encoder")


def _check_taxels(encoder: EncoderSpec, network: RSNN) -> None:
    """InputError if the network does not receive the encoder's afferents, or other taxels than it was fitted to."""
    table = encoder.model_dump()
    n_taxels = taxels_of(network.n_inputs, table)
    names = [population.name for population in populations(encoder)]
    some = [f"{part}.taxels" for part in ("sa1", "ra1") if (table.get(part) or {}).get("taxels") is not None]
    if len(some) == len(names) and known_taxels(table) is None:
        raise InputError(
            f"encoder: {' and '.join(some)} do not say how many taxels a sample has; give their names as "
            "recorded_taxels, or the encoder that spikes or a run hold"
        )
    n_each = n_afferents(encoder, n_taxels)
    if n_each != network.n_inputs and some:
        raise InputError(
            f"network: receives {network.n_inputs} afferents where {' and '.join(some)} give {n_each}; train it on "
            "spikes of this encoder"
        )
    if n_each != network.n_inputs:
        n_each = n_afferents(encoder, 1)
        under = f"{n_each}" if n_each > len(names) else " and ".join(f"one {name}" for name in names)
        raise InputError(
            f"network: receives {network.n_inputs} afferents, not {under} under each taxel; train it on spikes of this "
            "encoder"
        )
    for key in ("offset", "scale"):
        values = getattr(encoder.conditioning, key)
        if values is not None and len(values) != n_taxels:
            raise InputError(
                f"encoder: conditioning.{key} has {number_of(len(values), 'value')} but the network receives "
                f"{number_of(n_taxels, 'taxel')}; give the encoder that the network was trained with"
            )


def _check_range(encoder: EncoderSpec, signal_Hz: float) -> None:
    """InputError if the drive of the largest sample, in any unit, is not finite."""
    scales = np.abs(encoder.conditioning.scale or (1.0,))
    offsets = np.abs(encoder.conditioning.offset or (0.0,))
    gains = [1.0]
    if isinstance(encoder, AfferentSpec):
        gains = [*encoder.sa1.gains, *(1e-3 * signal_Hz * gain for gain in encoder.ra1.gains)]
    with np.errstate(over="ignore"):
        drive = (4 * LARGEST * LARGEST_FACTOR + offsets.max()) / scales.min() * np.abs(gains).max()
    if not drive < np.finfo(np.float32).max:
        raise InputError(
            f"encoder: a gain of {np.abs(gains).max():g} over a scale of {scales.min():g} exceeds float32 with large "
            "samples; use a smaller unit or smaller gains"
        )


def _input_rate(encoder: EncoderSpec, clock_Hz: float, given_Hz: float | None) -> float:
    resampled_Hz = encoder.conditioning.resample_Hz
    if given_Hz is not None:
        check_sampling_rate(given_Hz, "samples")
    if resampled_Hz is None:
        if given_Hz is not None and given_Hz != clock_Hz:
            raise InputError(
                f"sampling_rate_Hz: samples come at {given_Hz:g} Hz but the chain was trained at {clock_Hz:g} Hz; "
                "train with conditioning.resample_Hz to use other rates"
            )
        return clock_Hz
    if resampled_Hz != clock_Hz:
        raise InputError(
            f"encoder: resamples to {resampled_Hz:g} Hz but the network was trained at {clock_Hz:g} Hz; give the "
            "encoder that it was trained with"
        )
    if given_Hz is None:
        raise InputError(
            "`sampling_rate_Hz`: the encoder resamples and the rate of its recordings is not known, so the rate of the "
            "samples must be given"
        )
    conditioned_length(1, given_Hz, resampled_Hz)  # refuses a rate that is too low for the clock
    if given_Hz > MOST_SAMPLES_A_STEP * resampled_Hz:
        raise InputError(
            f"sampling_rate_Hz: {given_Hz:g} Hz is over {MOST_SAMPLES_A_STEP:,} times the encoder's clock of "
            f"{resampled_Hz:g} Hz; give the rate of the samples"
        )
    return given_Hz
