"""The tables of a run of afferents or networks, for its report."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from neurotact.data.dataset import ALL
from neurotact.data.hdf5 import encoded_by, load_spikes
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.model import EncoderSpec
from neurotact.errors import InputError
from neurotact.figures.columns import in_unit, quantity
from neurotact.figures.encoding import Classes
from neurotact.files import read_json
from neurotact.networks.definition import recipe
from neurotact.networks.definition.specs import TrainingSpec
from neurotact.networks.training import run_folder
from neurotact.networks.training.cautions import MEMBER
from neurotact.networks.training.epochs import Epoch, best_in
from neurotact.networks.training.run_folder import LOG
from neurotact.networks.use.ledger import Afferents
from neurotact.networks.use.measuring import OWN_KEYS
from neurotact.report import periods
from neurotact.spec import build
from neurotact.studies import measures
from neurotact.studies.automatic import TESTED
from neurotact.studies.store import BASELINES, cell_folder
from neurotact.studies.study import SPLIT, Cell, StudySpec, encoder_names, setting_columns
from neurotact.tables import LAYERS, UNCOUNTED, read_table

EXTRA_TABLES = {"conditions": "test_every_condition", "remedies": "augmentation"}
"""Tables that only some studies have, and the key of a study that requests each; measures bring further ones."""
LOGGED = [name for name in Epoch._fields if name != MEMBER]
"""Columns that every training log has."""


def with_pair(table: pd.DataFrame, study: StudySpec) -> pd.DataFrame:
    """The table with the refractory periods of each row in words (`periods.in_words`), in the column `pair`.

    Hidden neurons that a network of another package does not count are said to be so, too.

    >>> from neurotact.studies.study import resolve
    >>> rows = pd.DataFrame({"t_ref_ra_ms": [1.0], "t_ref_sa_ms": [10.0]})
    >>> with_pair(rows, resolve("refractory-period"))["pair"].tolist()
    ['1&10']
    """
    layers = {LAYERS: table[LAYERS].fillna("")} if LAYERS in table else {}  # beside networks of one layer
    if OWN_KEYS in table:
        known = layers.get(LAYERS, pd.Series("", table.index))
        layers = {LAYERS: known.mask(table[OWN_KEYS].notna() & (table["hidden"] == 0), UNCOUNTED)}
    return table.assign(pair=[*periods.of_rows(table, study)], **layers)


def with_setting(results: pd.DataFrame, study: StudySpec) -> pd.DataFrame:
    """The table with the column `setting`: the data set and all other swept keys, in words."""
    return results.assign(setting=[*_settings(results, setting_columns(study), encoder_names(study))])


def _settings(results: pd.DataFrame, swept: Sequence[str], encoders: Mapping[str, str]) -> Iterator[str]:
    """The setting of each row; all trials have no name beside swept keys. encoders: the names of the encoders by model.

    >>> rows = pd.DataFrame({"dataset": ["mixed"], "window.length_ms": [50.0], "network.training.patience": [7]})
    >>> [*_settings(rows, ["window.length_ms", "network.training.patience"], {})]
    ['mixed, window length 50 ms, patience 7']
    >>> [*_settings(pd.DataFrame({"dataset": ["all"], "encoder": ["lif"]}), ["encoder"], {"lif": "sa1-ra1-lif"})]
    ['encoder sa1-ra1-lif']
    """
    swept = [key for key in swept if key in results and not key.startswith(SPLIT)]  # splits are averaged
    has_name = not swept or {*results["dataset"]} != {ALL}
    for row in results.to_dict("records"):
        values = (encoders.get(row[key], row[key]) if key == "encoder" else row[key] for key in swept)
        words = map(key_in_words, swept, values)
        yield ", ".join([str(row["dataset"]), *words] if has_name else words)


def in_words_of_split(key: str) -> str:
    """A swept key of the split in words.

    >>> in_words_of_split("split.test_where.speed"), in_words_of_split("split.fold"), in_words_of_split("split.seed")
    ('tested speed', 'fold', 'split seed')
    """
    if key.startswith(TESTED):
        return f"tested {quantity(key.removeprefix(TESTED))[0]}"
    name = key.removeprefix(SPLIT)
    return "split seed" if name == "seed" else quantity(name)[0]


def key_in_words(key: str, value: Any) -> str:
    """A swept key and its value, without the tables that all such keys share."""
    name = key
    for table in ("network.training.", "network.", "encoder.", "dataset.parameters."):
        name = name.removeprefix(table)
    return f"{quantity(name)[0].replace('.', ' ')} {in_unit(key, value)}"


def in_the_paper(study: StudySpec, figure: str) -> str:
    """The corresponding figure of the texture paper; empty in a study without claims, which follows no paper."""
    return f" As the texture paper's {figure}." if study.claims else ""


def kept_epoch(folder: Path, cell: Cell) -> int:
    """The epoch of the weights of a done cell's network, or of the first of those joined, from its training log."""
    table = first_member(pd.read_csv(cell_folder(folder, cell) / LOG))
    log = [Epoch(*row) for row in table[LOGGED].to_numpy()]
    training = TrainingSpec() if cell.network is None else recipe.training_of(cell.network)
    if training.sparsity:  # the epoch that has it depends on their number, which a recipe chooses
        saved = read_json(cell_folder(folder, cell) / run_folder.NETWORK)
        training = build(TrainingSpec, saved["spec"]["training"], source=run_folder.NETWORK)
    return int(best_in(log, training).epoch)


LAST_TRAINING = (
    "It is the last training, with validation trials of trained conditions; the validation accuracy in tables is that "
    "of the choice before it, at a condition that was left out."
)


def is_last_training(folder: Path, cell: Cell) -> bool:
    """Whether a training before that of the done cell's network made the choices (`training.model_selection`)."""
    path = cell_folder(folder, cell) / run_folder.NETWORK
    return path.is_file() and not read_json(path)["extra"].get("has_own_rule", True)


def first_member(log: pd.DataFrame) -> pd.DataFrame:
    """The epochs of a training log that are of the first network that is kept, where several were trained.

    >>> first_member(pd.DataFrame({"epoch": [1, 1], "member": [1, 2]}))["epoch"].tolist()
    [1]
    """
    return log[log[MEMBER] == 1] if MEMBER in log else log


def extra_tables(study: StudySpec, folder: Path) -> dict[str, pd.DataFrame]:
    """The tables of `EXTRA_TABLES` and of measures that the study requests, by name."""
    names = [measure.table for measure in measures.requested(study.measures).values()]
    names += [name for name, key in EXTRA_TABLES.items() if getattr(study, key)]
    paths = {name: folder / f"{name}.csv" for name in names}
    known = {name: read_table(path) for name, path in paths.items() if path.is_file()}
    return {name: with_pair(table, study) if "t_ref_ra_ms" in table else table for name, table in known.items()}


def tables_beside(study: StudySpec, folder: Path) -> dict[str, pd.DataFrame]:
    """The tables of baselines that the study requests, by name.

    Raises InputError for baselines of an earlier version, whose other FLOPs are not counted by kind.
    """
    paths = [folder / name for name in BASELINES if study.baselines != "none"]
    beside = {path.stem: read_table(path) for path in paths if path.is_file()}
    if "other_flops" in beside.get("baselines", ()):
        raise InputError(
            f"{folder / BASELINES[0]}: an earlier version wrote it, with one price for most operations, so "
            "that its energies do not compare with those of networks now; run the study in a new folder"
        )
    if "baselines" in beside:
        beside["baselines"] = study.prices.repriced(beside["baselines"])
    return beside


def confusion(result: Mapping[str, Any], classes: Classes) -> np.ndarray | None:
    """A cell's test windows by true and predicted class, in drawing order.

    None if its classes differ from those drawn.
    """
    matrix = np.array(result["confusion"])
    alphabetical = sorted(classes.order)
    order = [alphabetical.index(label) for label in classes.order]
    return matrix[np.ix_(order, order)] if matrix.shape == (len(order), len(order)) else None


def afferents_of(folder: Path, done: Sequence[Cell]) -> list[Afferents | None]:
    """What made the spikes of each done cell; where its file is missing, its encoder as if conditioned as the first.

    None for all where no file is left. Encoders that are calibrated for each split may differ.
    """
    given = [name for name in dict.fromkeys(cell.given for cell in done) if (folder / name).is_file()]
    known = {name: _afferents(folder / name) for name in given}
    first = known[given[0]] if given else None
    return [known.get(cell.given, None if first is None else _like(first, cell.encoder)) for cell in done]


def _afferents(path: Path) -> Afferents:
    names, encoder, rate_Hz, recorded_Hz = encoded_by(path)
    return Afferents(len(names), encoder, rate_Hz, recorded_Hz)


def _like(first: Afferents, encoder: EncoderSpec) -> Afferents:
    if first.encoder.get("model") == encoder.model:
        return first
    table = encoder.model_dump(mode="json", exclude_none=True)
    return first._replace(encoder={**table, "conditioning": first.encoder.get("conditioning", {})})


def first_spikes(folder: Path, done: list[Cell]) -> SpikeTrains | None:
    """The first available spike trains of a done cell."""
    held = next(((folder / cell.given) for cell in done if (folder / cell.given).is_file()), None)
    return load_spikes(held) if held else None
