"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

MOST_SEEDS = 2**63 - 2
"""Of a training, which draws its order from the next seed."""
MOST_SPLITS = 2**32 - 2
"""Of a split, in the same way; scikit-learn takes 32 bits."""
MOST_WORKERS = 1024

SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the spec; may be repeated.")
]
OutFile = Annotated[Path, typer.Option("-o", "--out", dir_okay=False, help="The file to write.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the output if it already exists.")]
OutFolder = Annotated[Path, typer.Option("-o", "--out", help="The folder to write.")]
EncoderOption = Annotated[str, typer.Option(help="Name or path of an encoder spec.")]
DeviceOption = Annotated[str, typer.Option(help="A torch device: cpu, cuda, cuda:1, mps.")]
WorkersOption = Annotated[
    int | None,
    typer.Option(
        "--workers",
        min=1,
        max=MOST_WORKERS,
        show_default="2",
        help="Processes; the results are the same for any number.",
    ),
]
SchedulerOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler, tcp://host:8786: its workers do the work.")
]
Seed = Annotated[
    int, typer.Option(min=0, max=MOST_SEEDS, help="Random seed of the weights and of the order of windows.")
]
WindowMs = Annotated[float, typer.Option("--window-ms", help="Length of the window that is classified.")]
StartMs = Annotated[float, typer.Option("--start-ms", help="Skipped at the beginning of each trial.")]
HopMs = Annotated[float | None, typer.Option("--hop-ms", help="Between windows; their length when absent.")]
PerTrial = Annotated[int | None, typer.Option("--per-trial", help="At most so many windows per trial.")]
Stratify = Annotated[list[str] | None, typer.Option(help="A condition to balance in the split.")]
SplitSeed = Annotated[
    int, typer.Option(min=0, max=MOST_SPLITS, help="Random seed of the split into training, validation and test.")
]
Tolerance = Annotated[float, typer.Option(help="Validation accuracy that early exit may lose.")]
OtherEncoder = Annotated[
    bool, typer.Option("--allow-other-encoder", help="Take spikes that are encoded otherwise than in training.")
]
Json = Annotated[bool, typer.Option("--json", help="Print the table as JSON.")]
Recordings = Annotated[Path, typer.Argument(help="An HDF5 file of recordings.")]
Spikes = Annotated[Path, typer.Argument(help="An HDF5 file of spikes, as encode writes it.")]
RunFolder = Annotated[Path, typer.Argument(help="The folder of a trained network.")]
StudyFolder = Annotated[Path, typer.Argument(help="The folder of a study.")]
Source = Annotated[Path, typer.Argument(help="The folder or file to read.")]
