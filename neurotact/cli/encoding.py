"""The commands from recordings to spikes: calibrate, encode, raster."""

from pathlib import Path
from typing import Any

from neurotact.api import encoding as api
from neurotact.cli.options import calling, flag, option
from neurotact.cli.output import show


@calling(
    api.calibrate,
    split="split_seed stratify test_where group order folds fold",
    compare=flag("--compare", "Compare baselines and polarities first and use the best causal one."),
    rest_ms=option(
        float, "Length of the rest at the start of each trial, in which afferents should be silent.", min=1
    ),
    figure=option(Path | None, "Also draw how the gains were chosen (.png, .svg, .pdf)."),
    survives=option(Path | None, "Also measure and draw what of the signals survives the encoder (.png, .svg, .pdf)."),
)  # fmt: skip
def calibrate(given: dict[str, Any]) -> None:
    """Find an encoder's gains for a sensor, from its training trials.

    A baseline that uses the whole trial is replaced by a causal one, and the
    cut-off of the moving average is chosen, unless they are given with --set.
    Afferents of a sensor slower than the clock are computed once per sample, in
    closed form, unless the spec or --set gives integration.
    Membranes keep the spec's time constant, 10 ms by default; own-recordings
    takes a twentieth of the window, 10 to 50 ms: give it as --set tau_mem_ms=50.
    Afferents that fire at rest are listed, with a remedy.
    """
    api.calibrate(**given, tell=show)


@calling(
    api.encode_file,
    augmentation=option(
        str | None,
        "Also encode varied copies of each trial, for training alone: time (played faster or slower), gain "
        "(scaled), start (begun later), taxels (a quarter of them at rest), or time+gain.",
        metavar="KIND",
    ),
    copies=option(int | None, "Varied copies of each trial.", min=1, max=20, show_default="3"),
)
def encode(given: dict[str, Any]) -> None:
    """Turn whole trials into the spikes of SA-I and RA-I afferents."""
    api.encode_file(**given, tell=show)


@calling(
    api.save_raster,
    trial=option(int | None, "Which trial to draw.", min=0, show_default="0"),
    start_s=option(float | None, "Start of the part that is drawn.", min=0, show_default="0"),
    stop_s=option(float | None, "End of the part that is drawn; the trial's end when absent."),
    recordings=option(Path | None, "The file of recordings, if it was moved after encoding."),
)
def raster(given: dict[str, Any]) -> None:
    """Draw a trial's spikes (.png, .svg, .pdf), or write those of all trials (.csv, .nwb).

    The signal is drawn above the spikes.
    """
    api.save_raster(**given, tell=show)
