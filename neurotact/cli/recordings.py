"""The commands that read recordings in the forms that they are published in."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from neurotact import files
from neurotact.cli.lazy import add_plugins, new_app
from neurotact.cli.options import Force, OutFile, Source
from neurotact.cli.output import save_recordings
from neurotact.data import hdf5
from neurotact.data.readers import braille_letters, folder
from neurotact.data.sources import Reader

IMPORTED = (".csv", ".npz", ".lvm")
"""Files of recordings as they were published."""

app = new_app("Read recordings as they were published into one HDF5 file.")


@app.command("folder")
def import_folder(
    source: Source,
    out: OutFile,
    sampling_rate_hz: Annotated[float, typer.Option("--sampling-rate-Hz", help="Samples per second.")],
    unit: Annotated[str, typer.Option(help="Unit of the signals, such as mV, V or count.")],
    force: Force = False,
) -> None:
    """Any recordings: one sub-folder per class with CSV or NPZ files, one row per sample and one column per taxel."""
    _check_import(source, out, force)
    save_recordings(folder.read(source, sampling_rate_hz, unit), out)


@app.command("braille-letters")
def import_braille_letters(
    source: Source,
    out: OutFile,
    step_ms: Annotated[float, typer.Option("--step-ms", help="The clock on which events become spikes.")] = 5.0,
    force: Force = False,
) -> None:
    """27 Braille letters under an event-based fingertip (Zenodo 6556273): the published file, to spikes."""
    files.check_new(out, force=force, inputs=[source])
    trains = braille_letters.read(source, step_ms)
    hdf5.save_spikes(trains, out)
    print(
        f"{out}: {len(trains)} trials of {len(trains.classes)} classes, {sum(map(len, trains.steps))} spikes of "
        f"{len(trains.afferents)} afferents, {trains.trial_steps[0]} steps at {trains.sampling_rate_Hz:g} Hz"
    )


def _command(name: str, form: Reader) -> Callable[..., None]:
    def run(source: Source, out: OutFile, force: Force = False) -> None:
        _check_import(source, out, force)
        save_recordings(form.read(source), out)

    return run


add_plugins(app, "readers", _command)


def _check_import(source: Path, out: Path, force: bool) -> None:
    files.check_new(out, force=force, inputs=[p for p in files.below(source) if p.suffix.lower() in IMPORTED])
