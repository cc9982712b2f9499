"""The command that describes the content of a file."""

from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer

from neurotact import effects
from neurotact.cli.output import print_table
from neurotact.data import description, doubtful, hdf5
from neurotact.data.onset import common_onset_s
from neurotact.data.window_choice import timing_of
from neurotact.errors import some


def info(
    file: Annotated[Path, typer.Argument(help="An HDF5 file of recordings or spikes.")],
    all_: Annotated[
        bool, typer.Option("--all", help=f"Print a row for each taxel of more than {description.MOST_TAXELS} too.")
    ] = False,
) -> None:
    """Describe the content of a file of recordings or spikes.

    Prints its classes and conditions, the length and the rate of its trials, when the touch begins, and the range of
    each taxel or the rate of each population. Use it after an import: it shows a wrong unit, a dead taxel, a clock
    column among the taxels, copies of a trial, or a class with two names.
    """
    kind = hdf5.kind_of(file)
    effects.check(all=all_, content=kind)
    if kind == "recordings":
        with hdf5.open_recordings(file) as data:
            print(
                f"{file}: {len(data)} trials of {len(data.classes)} classes, {data.n_channels} taxels, in {data.unit}"
            )
            print(description.lengths_line(data.lengths, data.sampling_rate_Hz))
            _print_onset(common_onset_s(data))
            print_table(description.conditions_table(data.conditions))
            _print_taxels(description.taxels_table(data), every=all_)
            _print_lines(doubtful.lines(data))
        return
    spikes = hdf5.load_spikes(file)
    print(f"{file}: {spikes!r}")
    print(description.lengths_line(np.asarray(spikes.trial_steps), spikes.sampling_rate_Hz))
    _print_onset(timing_of(spikes).touch_s)
    print_table(description.conditions_table(spikes.conditions))
    print_table(description.afferents_table(spikes))
    _print_lines(doubtful.lines(spikes))


def _print_taxels(taxels: pd.DataFrame, *, every: bool) -> None:
    few = every or len(taxels) <= description.MOST_TAXELS
    print_table(taxels if few else description.taxels_summary(taxels))
    if dead := description.constant_taxels(taxels):
        print(f"constant within every trial: {some(dead)}")
    if not few:
        print("--all prints a row for each taxel")


def _print_lines(lines: list[str]) -> None:
    for line in lines:
        print(line)


def _print_onset(onset_s: float) -> None:
    if onset_s:
        print(f"the touch begins about {1e3 * onset_s:.0f} ms after the start of a trial (train --start-ms)")
