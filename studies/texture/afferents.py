"""The way `afferents`: a study without networks, whose cells measure the spikes of their afferents.

The texture paper (Sec. III-A) compares scaling coefficients of the afferents' currents: by rates, intervals, overlap of
the intervals of different gratings, silent share, and latency of the first spike.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
from neurotact_parts.studies.texture import firing, gain_figures

from neurotact.data.recordings import select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.sensitivity import sensitivities_of, value_of
from neurotact.encoders.specs import EncoderSpec, populations, t_ref_pair_ms
from neurotact.errors import InputError
from neurotact.figures.encoding import Classes
from neurotact.figures.style import Drawn
from neurotact.files import existing, scratch, write_json
from neurotact.metrics.firing import touch_spikes
from neurotact.report import page, ways
from neurotact.report.encoding_drawings import name_classes
from neurotact.report.tables import first_spikes, with_pair
from neurotact.spec import to_toml
from neurotact.studies import networks
from neurotact.studies.encoding_tables import periods, read_encoding
from neurotact.studies.engine import Files, Results
from neurotact.studies.store import cell_folder, is_done
from neurotact.studies.study import Cell, StudySpec, cells, swept_columns
from neurotact.studies.way import View
from neurotact.tables import read_table, write_table

DOWNLOADS = {
    "results.csv": "one row per encoding, both populations",
    "results.json": "the same",
    "isi.csv": "distributions of inter-spike intervals: one row per population, gain, t_ref, class and bin",
    "encoding.csv": "firing of both populations for each class and condition, from window.start_ms to the trial's end",
    "timings.csv": "time that each part of the study and each cell took",
    "study.toml": "the study as run, with all its specs",
    "versions.json": "versions of the software",
    "data.json": "the recordings' hash",
}
ISI = "isi.csv"
POPULATIONS = (("SA-I", "sa", "sa1"), ("RA-I", "ra", "ra1"))
"""Each population: its name, its name in columns, and its name in the encoder's spec."""
VIEW = View(
    by=("population", "dataset", "gain", "t_ref_ms"),
    measures={
        "spikes_per_s": "spikes per second",
        "isi_ms": "mean interval (ms)",
        "isi_sd_ms": "SD of the intervals (ms)",
        "isi_least_ms": "shortest interval (ms)",
        "isi_overlap": "overlap of two classes' intervals (%)",
        "silent_share": "silent trials (%)",
        "latency_ms": "first spike after (ms)",
    },
    cost="spikes_per_s",
    score="isi_overlap",
    note="Each population is measured separately, with all its afferents.",
)


def cells_of(study: StudySpec) -> Iterator[Cell]:
    """The cells of a study; InputError if it names a network, which this way does not train."""
    if study.network is not None:
        raise InputError("network: the way 'afferents' trains none; give way = 'networks' with it, or leave it out")
    return cells(study)


def run(cell: Cell, trains: SpikeTrains, kept: Path | None = None, tells: bool = False) -> Files:
    """The files of a cell without a network: `result.json` with its row, `isi.csv`, `timing.json`."""
    began = perf_counter()
    chosen = trains.select(select_conditions(trains.conditions, cell.subset))
    touches = touch_spikes(chosen, cell.window.start_ms)
    row: dict[str, Any] = {
        "dataset": cell.dataset,
        **periods(cell),
        "seed": cell.seed,
    }
    parts = []
    names = [population.name for population in populations(cell.encoder)]
    pairs = zip((names[0], " and ".join(names[1:])), _pair_of(cell.encoder), t_ref_pair_ms(cell.encoder), strict=True)
    for (_, kind, _), (name, gain, t_ref_ms) in zip(POPULATIONS, pairs, strict=True):
        is_kind = chosen.is_sa if kind == "sa" else ~chosen.is_sa
        row |= {
            f"{what}_{kind}{unit}": value for (what, unit), value in firing.measures(touches, is_kind, chosen).items()
        }
        counts, edges_ms = firing.isi_histograms(touches, is_kind, chosen)
        common = firing.overlap(counts)
        row[f"isi_overlap_{kind}"] = None if np.isnan(common) else common
        table = firing.as_table(counts, edges_ms, chosen.classes)
        table.insert(0, "population", name)
        table.insert(1, "gain", gain)
        table.insert(2, "t_ref_ms", t_ref_ms)
        parts.append(table)
    with scratch() as target:
        write_table(pd.concat(parts, ignore_index=True), target / ISI)
        write_json(target / "result.json", {"row": row})
        write_json(target / "timing.json", {"seconds": perf_counter() - began})
        return {path.name: path.read_bytes() for path in target.iterdir()}


def _isi_table(folders: Sequence[Path], rows: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """The distributions of all cells; before their columns, the data set and the swept keys of `results.csv`.

    folders: those of the cells, one for each row. Their tables already contain gains and refractory periods.
    """
    own = [key for key in keys if not key.endswith((".gain", ".t_ref_ms"))]
    parts = []
    for cell_path, (_, row) in zip(folders, rows.iterrows(), strict=True):
        table = _read_isi(cell_path / ISI)
        for key in reversed(["dataset", *own]):
            table.insert(0, key, row[key])
        parts.append(table)
    return pd.concat(parts, ignore_index=True).drop_duplicates(ignore_index=True)


def _read_isi(path: Path) -> pd.DataFrame:
    """An `isi.csv`; a class may be called "None"."""
    return read_table(path, dtype={"label": str}, keep_default_na=False)


def tables(folder: Path, study: StudySpec, results: Results) -> Mapping[str, pd.DataFrame]:
    """Those of networks, and the intervals between spikes."""
    written, places = networks.tables(folder, study, results), [cell_folder(folder, cell) for cell, _ in results]
    return {**written, ISI: _isi_table(places, written["results.csv"], swept_columns(study))}


def write(study: StudySpec, folder: Path) -> Path:
    """Write `report.html`, its figures and `results.json` from the files of a run; returns the page's path.

    Raises InputError when a table is missing or a claim names a missing column.
    """
    every = list(cells(study))
    done = [cell for cell in every if is_done(folder, cell)]
    results = with_pair(read_table(folder / "results.csv"), study)
    results = results.assign(
        gain_sa=[_pair_of(cell.encoder)[0] for cell in done], gain_ra=[_pair_of(cell.encoder)[1] for cell in done]
    )
    encoding = with_pair(read_encoding(folder / "encoding.csv"), study)
    isi = _read_isi(existing(folder / ISI))
    trains = first_spikes(folder, done)
    classes = name_classes(encoding, trains.conditions if trains else None)
    write_table(results.drop(columns=["pair", "gain_sa", "gain_ra"]), folder / "results.json")
    return page.write(
        "protocol.html.jinja",
        study,
        folder,
        n_done=len(done),
        n_cells=len(every),
        tables={"results": results, "encoding": encoding},
        figures=_drawings(results, isi, classes),
        downloads=DOWNLOADS,
        specs={"Encoder": to_toml(study.encoder.model_dump(mode="json", exclude_none=True))},
        seeds=study.sweep.get("seed", [0]),
        data={"recordings": page.if_there(folder / "data.json")},
        **ways.seen(ways.over_rows(_by_population(results), VIEW), VIEW),
    )


def _by_population(results: pd.DataFrame) -> pd.DataFrame:
    """One row per population of each encoding, its measures without the population in their names.

    >>> wide = pd.DataFrame({"dataset": ["all"], **{f"gain_{k}": [3.0] for k in ("sa", "ra")},
    ...     **{f"t_ref_{k}_ms": [1.0] for k in ("sa", "ra")}, "isi_sa_ms": [31.0], "isi_ra_ms": [57.0]})
    >>> _by_population(wide)[["population", "isi_ms"]].values.tolist()
    [['SA-I', 31.0], ['RA-I', 57.0]]
    """
    parts = []
    for name, kind, _ in POPULATIONS:
        own = {c: c.replace(f"_{kind}", "", 1) for c in results if c.endswith((f"_{kind}", f"_{kind}_ms"))}
        own |= {f"spikes_{kind}_per_s": "spikes_per_s"} if f"spikes_{kind}_per_s" in results else {}
        parts.append(results[["dataset", *own]].rename(columns=own).assign(population=name))
    return pd.concat(parts, ignore_index=True)


def _drawings(results: pd.DataFrame, isi: pd.DataFrame, classes: Classes) -> Iterator[Drawn]:
    """For each data set: ISI distributions over gains, rates and intervals over gain and t_ref, the trade-off."""
    for number, (dataset, rows) in enumerate(results.groupby("dataset", sort=False)):
        suffix = f"-{number + 1}" if number else ""
        yield _distributions(str(dataset), isi[isi["dataset"] == dataset], classes, suffix)
        figure = gain_figures.draw_gain_and_t_ref(rows)
        caption = (
            f"Spikes per second of each whole population, and its mean inter-spike interval, over gain and refractory "
            f"period ({dataset}); colours by their logarithm."
        )
        yield Drawn(f"gain-and-t-ref{suffix}", f"Gain and refractory period: {dataset}", figure, caption, caption)
        caption = (
            f"Trade-off of the gain ({dataset}). A higher gain makes the intervals of different classes similar "
            "(overlap of their distributions, mean over pairs of classes); a lower gain leaves trials without a spike "
            "and delays the first spike. The texture paper's Sec. III-A describes it in words."
        )
        figure = gain_figures.draw_compromise(rows)
        yield Drawn(f"compromise{suffix}", f"Trade-off of the gain: {dataset}", figure, caption, _ends(rows))


def _distributions(dataset: str, isi: pd.DataFrame, classes: Classes, suffix: str) -> Drawn:
    t_ref_ms = float(isi["t_ref_ms"].min())
    figure = gain_figures.draw_isi_distributions(isi, t_ref_ms, classes)
    caption = (
        f"Inter-spike intervals of each {classes.word} at each gain, t_ref {t_ref_ms:g} ms ({dataset}): shares of all "
        "intervals of the class, in bins each 1.3 times as wide as the previous one."
    )
    return Drawn(f"isi-distributions{suffix}", f"Intervals over the gains: {dataset}", figure, caption, caption)


def _ends(rows: pd.DataFrame) -> str:
    """The overlap at the lowest and the highest gain, in words."""
    words = []
    for name, kind, _ in POPULATIONS:
        overlap = rows.groupby(f"gain_{kind}")[f"isi_overlap_{kind}"].mean()
        words.append(
            f"{name}: overlap {overlap.iloc[0]:.2f} at gain {overlap.index[0]:g}, {overlap.iloc[-1]:.2f} at "
            f"{overlap.index[-1]:g}"
        )
    return "; ".join(words) + "."


ENGINE = networks.ENGINE._replace(cells=cells_of, run=run, tables=tables, report=write)
"""The entry point `afferents` of the group `neurotact.ways`."""


def _pair_of(encoder: EncoderSpec) -> tuple[float, float]:
    """The gains or thresholds of the first two populations; both are the same where they share one.

    >>> from neurotact.encoders.specs import load
    >>> _pair_of(load("sa1-ra1-lif"))
    (3.2, 16.0)
    """
    values = [value_of(encoder, sensitivity) for sensitivity in sensitivities_of(encoder)]
    return values[0], values[min(1, len(values) - 1)]
