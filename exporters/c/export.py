"""Export to C: from a run folder to files, and for integers the formats from the training trials."""

import logging
from pathlib import Path
from typing import Any, Literal, NamedTuple

from neurotact_parts.streams.streamed import StreamedSpec

from neurotact import effects, files
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.networks.use.exporters import Exporter
from neurotact.progress import Tell, untold
from neurotact.spec import takes_specs

with lazily():
    from neurotact_parts.exporters import trials as test_trials
    from neurotact_parts.exporters.c import c_export, fine_tuning, formats, learning, proving
    from neurotact_parts.streams import chain as chains

    from neurotact.networks.definition import executors, rsnn
    from neurotact.networks.training import ranges as state_ranges
    from neurotact.networks.training import run_folder
    from neurotact.networks.use import fitted


WEIGHT_BITS = 8
"""Default of a network that was not fine-tuned for other bits."""

log = logging.getLogger("neurotact")


class Exported(NamedTuple):
    """A chain, and its formats if it computes in integers."""

    chain: "chains.Chain"
    formats: "formats.Formats | None"


@takes_specs
def export_c(
    run: "fitted.Fitted",
    folder: str | Path,
    *,
    variant: Literal["integer", "float"] = "integer",
    weight_bits: int | None = None,
    state_bits: int | None = None,
    lsb: float | None = None,
    recordings: Recordings | str | Path | None = None,
    spikes: str | Path | None = None,
    name: str = "touch",
    streamed: StreamedSpec = StreamedSpec(),
    new_classes: int | None = None,
    prove: int = 0,
    force: bool = False,
    tell: Tell = untold,
) -> Exported:
    """Write the chain in the run folder `run` as C99, from a raw sample to a decision, as `neurotact export` does.

    Of a network that takes the events of a sensor, from an event to a decision.

    run: the folder, or a fitted `SpikingClassifier` or a pipeline that ends in one.
    variant: "integer", whose formats are chosen from the ranges that training saved in the folder, or "float".
    recordings, spikes: that the run was trained on, where they moved since, for `prove` or for a run without ranges;
    of a classifier, recordings (or a file of them) like those that it was fitted on, which give the range of samples.
    weight_bits: 2 to 8; when None those of `fine_tune`, else 8.
    state_bits: 8 to 16, or 24; chosen when None. lsb: of a sample of 16 bits; when None, 1 for whole
    numbers that fit, else from the recorded range.
    name: prefix of every name in C.
    streamed: the rate, the windows and their decisions, as for `Stream`.
    new_classes: how many classes the device can learn from a few touches, as `nt.learn` does; in float32 alone.
    prove: compile the export, run it here and in QEMU, and compare this many test trials spike by spike.
    force: replace files. tell: called with what the command prints.
    Returns the chain and its formats. Raises InputError for files that exist, and for a chain that cannot run in C.

    >>> made = nt.export_c("run", "chain")
    >>> sorted(path.name for path in Path("chain").iterdir())
    ['README.md', 'example.c', 'touch.c', 'touch.h']
    """
    effects.check(
        takes_events=fitted.restore(run).encoder == {}, **streamed.given(),
        variant=variant, weight_bits=weight_bits, state_bits=state_bits, lsb=lsb, new_classes=new_classes,
        ranges=variant == "integer" or prove or new_classes, recordings=recordings, spikes=spikes,
    )  # fmt: skip
    if variant not in ("integer", "float"):
        raise InputError(f"variant: '{variant}' is unknown; choose integer or float")
    for path in c_export.paths(Path(folder), name):
        files.check_new(path, force=force)
    made = prepared(
        run, integer=variant == "integer", recordings=recordings, spikes=spikes, weight_bits=weight_bits,
        state_bits=state_bits, lsb=lsb, streamed=streamed,
    )  # fmt: skip
    taught = None
    if new_classes is not None:
        able = learning.teachable(fitted.restore(run, spikes=spikes), made.chain, new_classes)
        made, taught = Exported(able.chain, None), able.context()
    c_export.write(made.chain, Path(folder), made.formats, name=name, taught=taught)
    tell(f"{folder}: {c_export.title_of(made.chain, made.formats)}")
    if new_classes is not None:
        tell(learning.warn(able))
    if prove:
        tell(proving.prove(run, made.chain, made.formats, prove, recordings, spikes, say=log.warning, taught=taught))
    return made


def prepared(
    run: "fitted.Fitted",
    *,
    integer: bool = True,
    recordings: Recordings | str | Path | None = None,
    spikes: str | Path | None = None,
    weight_bits: int | None = None,
    state_bits: int | None = None,
    lsb: float | None = None,
    streamed: StreamedSpec = StreamedSpec(),
) -> Exported:
    """The chain of a run folder or a fitted classifier, ready to be written as C; streamed: as for `chain_of`.

    integer: computed in integers, whose formats come from the ranges that training saved in the run folder, or from
    `recordings` and `spikes`: those that the run was trained on, or recordings like those of a classifier.
    weight_bits, state_bits, lsb: as for `formats.choose`. By default, the weights of a fine-tuned run have the bits and
    steps of its fine-tuning, others 8 bits.
    """
    restored = fitted.restore(run, spikes=spikes)
    executor = "c-integer" if integer else "c-float"
    subject = executors.Subject(None, rsnn.rsnn_of(executor, restored.network), detects=restored.detector is not None)
    executors.require(executor, subject)  # the rest where it is written
    if not integer:
        return Exported(chains.chain_of(restored, streamed), None)
    is_known = restored.ranges is not None or restored.encoder != {}  # of events, spikes alone give the ranges
    if recordings is None and spikes is None and restored.spikes and is_known:
        chain, ranges = chains.chain_of(restored, streamed), restored.ranges
        if ranges is None:
            raise InputError(
                f"{run}: does not hold the ranges of its samples, since their recordings were not found in training; "
                "name them with `recordings`, or train it again beside them"
            )
    else:
        known = test_trials.recorded(restored, recordings)
        if streamed.sampling_rate_Hz is None and _resamples(restored):
            streamed = streamed.model_copy(update={"sampling_rate_Hz": known.sampling_rate_Hz})
        chain = chains.chain_of(restored, streamed)
        ranges = state_ranges.record(chain.network, known.windows, known.training)
    return Exported(chain, formats.choose(chain, ranges, lsb=lsb, **_bits_and_steps(restored, weight_bits, state_bits)))


def _bits_and_steps(restored: "run_folder.Restored", weight_bits: int | None, state_bits: int | None) -> dict[str, Any]:
    """Bits and steps of the weights and bits of the states, as given or as in the fine-tuning of the run.

    With other weight bits, or with fewer state bits, the weights are rounded again.
    """
    tuned = fine_tuning.tuned_of(restored)
    if tuned is None:
        return {"weight_bits": weight_bits or WEIGHT_BITS, "state_bits": state_bits}
    bits = {"weight_bits": weight_bits or tuned.weight_bits, "state_bits": state_bits or tuned.state_bits}
    same_grid = bits["weight_bits"] == tuned.weight_bits and bits["state_bits"] >= tuned.state_bits
    return {**bits, "steps": formats.Steps(*tuned.steps) if same_grid else None}


def _resamples(restored: "run_folder.Restored") -> bool:
    return ((restored.encoder or {}).get("conditioning") or {}).get("resample_Hz") is not None


EXPORTER = Exporter(
    "a folder of C99 for a microcontroller, from raw samples to decisions",
    export_c,
    {
        "variant": "integer or float arithmetic.",
        "weight_bits": "bits of a weight in the integer variant: 2 to 8; when absent, as in fine-tune, else 8.",
        "state_bits": "bits of a state in the integer variant: 8 to 16, or 24; chosen when absent.",
        "lsb": "signal per digit of a 16-bit sample. When absent: 1 for whole numbers, else from the recorded range.",
        "name": "prefix of all names in C.",
        "new_classes": "how many classes the device can learn from a few touches, in float.",
    },
)
