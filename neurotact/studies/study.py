"""A study: a spec that names an encoder, a network, a data set and a sweep; its cells.

A study file names its parts (`encoder = "sa1-ra1-lif"`); a resolved study contains them completely, so a run folder
describes the whole run. A cell is one combination of the swept values, with everything that decides its numbers.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

from neurotact import effects, files, plugins
from neurotact import spec as specs
from neurotact.baselines.opponent import Opponents
from neurotact.data.augmentation import AUTO, NONE, AugmentationSpec
from neurotact.data.dataset import DatasetSpec, expand, simulator
from neurotact.data.splits import SplitSpec
from neurotact.data.windows import WindowSpec, steps_of
from neurotact.encoders import specs as encoders
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.model import AnyEncoder, usable
from neurotact.encoders.specs import is_exact, pays_exact
from neurotact.errors import InputError, nearest
from neurotact.lazily import lazily
from neurotact.metrics.prices import MEMORY_45NM, PriceList, price_list
from neurotact.networks.definition import clock
from neurotact.networks.definition import space as spaces
from neurotact.networks.definition.learned import Balance
from neurotact.networks.definition.seeds import of_start
from neurotact.networks.definition.space import SearchSpec
from neurotact.networks.definition.specs import BUILT_IN, RSNNSpec, part_of
from neurotact.networks.training import balancing
from neurotact.spec import Spec
from neurotact.studies import automatic, calibration_keys, measures, sweeps
from neurotact.studies.claims import Claim

with lazily():
    from neurotact.networks.definition import recipe

Measures = Annotated[dict[str, Any], BeforeValidator(measures.checked)]
SOURCE = "dataset.parameters."
"""Prefix of swept keys of the simulation; a cell stores them in its `source`."""
NETWORKS = "networks"
"""The way of a study that names none."""
COPIES = "augmentation."
"""Prefix of swept keys of varied copies, which baselines have, too."""
SPLIT = "split."
"""Prefix of swept keys of the split, such as `split.fold`."""

PARTS: dict[str, Callable[[str | Path], Spec]] = {
    "encoder": encoders.load, "network": partial(specs.load, RSNNSpec), "prices": price_list,
}  # fmt: skip
LENGTH = "window.length_ms"
HIDDEN = "network.hidden"
T_REF = "t_ref_ms"
"""Swept with `encoder`, the names of encoders: the refractory period of all its afferents, or "own"."""
OWN = "own"
EVERY, LONGER_MS = "every", 10.0
"""In place of the values of `encoder & t_ref_ms`: every model that is compared, with its own period and with this."""
CHOICES = {
    "choose_ema": f"{calibration_keys.CONDITIONING}.ema_cutoff_Hz",
    "choose_opposite": "encoder.sa1.opposite",
    "choose_grades": "encoder.sa1.grades",
}
"""Keys of a study that let calibration choose a key of the encoder, and this key."""
OF_SPIKES = ("encoder", "spikes_per_s", *CHOICES)
"""Keys of a sweep that decide spikes, besides those that begin with `encoder.`."""
log = logging.getLogger("neurotact")
PAIR = f"encoder.ra1.t_ref_ms{sweeps.JOIN}encoder.sa1.t_ref_ms"


class _EarlyExitSpec(Spec):
    """The choice of a network's patience on validation trials."""

    tolerance: float = Field(default=0.01, ge=0, lt=1)
    """Accuracy that may be lost on the validation trials."""
    choice: Literal["least", "steady"] = "least"
    """As `exit_choice` of a `Task`."""
    gone = {"by": "stability"}


class StudySpec(Spec):
    """A study with its complete encoder and network (`studies/*.toml` after `resolve`)."""

    folder: ClassVar[str] = "studies"
    words: ClassVar[set[str]] = {"title", "about", "claims", "notes", "as_shipped", "as_run", "prices"}
    """Keys that change none of the numbers of cells: a report can be written again with other words and prices."""
    way: str = NETWORKS
    """The entry point of the group `neurotact.ways` that runs the study."""
    parameters: dict[str, Any] = {}
    """Of a way other than `networks`."""
    title: str
    """Heading of the report."""
    about: str = ""
    """The question of the study, in a sentence or two, below the heading."""
    dataset: DatasetSpec
    notes: tuple[str, ...] = ()
    """The choices made for the recordings, in words."""
    as_shipped: bool = False
    """Whether this is a complete shipped study without changes: only then do the reasons of its claims apply."""
    as_run: bool = False
    """Whether a run wrote this file, with what its way adds to a study (`Engine.own`): it is not added again."""
    calibrate: bool = False
    """Fit the encoder's baseline, standardisation and gains on the training trials (as `neurotact calibrate` does)."""
    choose_ema: bool = False
    """Also choose the cut-off of the encoder's moving average there, unless it is set or swept."""
    choose_opposite: bool = False
    """Also choose there whether LIF afferents include SA-I of the falling signal, unless this is set or swept."""
    choose_grades: bool = False
    """Also choose there, where the test is on other conditions and networks learn from varied copies, whether they
    include SA-I of several thresholds."""
    spikes_per_s: float | None = Field(default=None, gt=0)
    """Fit gains and thresholds there to this rate of an afferent, so that encoders spend equally many spikes."""
    window: WindowSpec = WindowSpec()
    split: SplitSpec = SplitSpec()
    early_exit: _EarlyExitSpec = _EarlyExitSpec()
    baselines: Opponents = "none"
    """The opponents to fit on the same windows, in baselines.csv: `linear`, logistic regression (of numbers, ridge) on
    mean and deviation of the signals; `readout`, also on the spike counts of each encoder; `quick`, on more features,
    SVM, ELM and trees, also on spikes, and MiniRocket on the signals; `all`, also spectra and a GRU."""
    encoding_in: Literal["processor", "sensor"] = "processor"
    """Where conditioning and encoding are computed: their energy counts on the processor, and not in the sensor."""
    prices: PriceList = MEMORY_45NM
    """The price list by which energy is estimated: its name, its path, or the whole table."""
    measures: Measures = {}
    """Further tables, by the names of the measures that are installed; each name may stand as a key of the study, too:
    `signals = true`."""
    test_every_condition: bool = False
    """Also test each network on the test trials of every condition in `dataset.stratify`, whether it was trained on
    that condition or not: the table conditions.csv."""
    past_windows: bool = True
    """Encode trials to their end, so that encoding.csv describes the whole touch; false: as far as windows reach."""
    encoder: AnyEncoder
    """An encoder spec: its name, its path, or the whole table."""
    network: RSNNSpec | None = None
    """Of every way that trains one."""
    search: SearchSpec | None = None
    """Each cell searches its network's hyperparameters on its own validation trials; swept ones are not searched."""
    augmentation: AugmentationSpec | None = None
    """Varied copies of the training trials, for tests at conditions that no training trial has."""
    balance: Balance = "none"
    """Whose training windows count the same in sum: those of each class, or of each of the split's conditions within a
    class, too. Opponents are fitted without it."""
    training_windows: int | None = Field(default=None, ge=1)
    """Windows of a trial to train and validate on, `window.hop_ms` apart; the same number as for testing if absent."""
    sweep: dict[str, list[Any]]
    """Values of each axis; an axis is `dataset`, `seed`, a dotted key, or several keys joined by ` & `."""
    claims: tuple[Claim, ...] = ()

    @model_validator(mode="after")
    def _sweeps_known_subsets(self) -> "StudySpec":
        sweeps.check(self.sweep)
        names = {name for name in sweeps.values(self.sweep, "encoder") if isinstance(name, str)}
        if len(encoder_names(self)) < len(names):
            raise ValueError("sweep.encoder: two encoders have the same model, by which results name them; drop one")
        if sweeps.values(self.sweep, T_REF) and not names:
            raise ValueError(f"sweep.{T_REF}: is swept with 'encoder', as in \"encoder & {T_REF}\"")
        known = list(self.dataset.subsets)
        for name in sweeps.values(self.sweep, "dataset"):
            if name not in known:
                raise ValueError(f"sweep.dataset: '{name}' is not a subset; {nearest(str(name), known)}")
        if self.test_every_condition and not self.dataset.stratify:
            raise ValueError("test_every_condition needs dataset.stratify, the conditions to test apart")
        for measure in measures.requested(self.measures).values():
            if measure.check is not None:
                measure.check(self)
        return self

    @model_validator(mode="after")
    def _has_parameters_of_its_way(self) -> "StudySpec":
        if self.parameters and self.way == NETWORKS:
            raise ValueError(f"parameters: the way '{NETWORKS}' takes none; its keys stand beside the dataset's")
        return self

    @model_validator(mode="after")
    def _describes_one_set_of_recordings(self) -> "StudySpec":
        swept = [key for key in sweeps.keys(self.sweep) if key.startswith(SOURCE)]
        if swept and self.dataset.simulate is None:
            raise ValueError(f"sweep: '{swept[0]}' needs dataset.simulate; recordings that are read have no parameters")
        described = ["baselines"] if self.baselines != "none" else []
        described += [name for name, one in measures.requested(self.measures).items() if one.of_study]
        if swept and described:
            raise ValueError(f"{described[0]} describes one set of recordings; remove it, or the sweep of '{swept[0]}'")
        return self

    @model_validator(mode="after")
    def _has_the_network_that_it_requires(self) -> "StudySpec":
        of_network = [axis for axis in self.sweep if "network." in axis] + [
            *(name for name in ("search", "test_every_condition") if getattr(self, name)),
            *(name for name, one in measures.requested(self.measures).items() if one.of_network),
        ]
        if self.network is None and of_network:
            raise ValueError(f"{of_network[0]} needs a network; name one, as in network = 'rsnn'")
        if self.network is None and self.way == NETWORKS:
            raise ValueError(
                "network: is missing; name one, as in network = 'rsnn', or encode alone: way = 'afferents'"
            )
        return self

    def digest(self) -> str:
        """As for every spec, without words, claims and the places of recordings."""
        places: dict[str, Any] = {"file": True, "path": True, "arrays": {"path"}}
        without = {**dict.fromkeys(self.words, True), "dataset": places}
        return specs.digest(self.model_dump(mode="json", exclude=without))


class Cell(Spec):
    """One training, or one encoding alone: everything that decides its numbers, without file paths."""

    source: dict[str, Any]
    dataset: str
    subset: dict[str, Any]
    seed: int
    window: WindowSpec
    split: SplitSpec
    early_exit: _EarlyExitSpec
    encoder: AnyEncoder
    calibrate: AnyEncoder | None = None
    """The encoder whose gains are fitted on the training trials; t_ref varies around it."""
    conditioned_by: AnyEncoder | None = None
    """The encoder for which baseline and moving average are chosen there, if not `calibrate` itself."""
    choose_ema: bool = False
    """Whether the cut-off of its moving average is chosen there, too."""
    choose_opposite: bool = False
    """Whether SA-I of the falling signal are chosen there, too."""
    choose_grades: bool = False
    """Whether SA-I of several thresholds are chosen there, too."""
    spikes_per_s: float | None = None
    """The rate of an afferent to which gains and thresholds are fitted there; None: they separate classes best."""
    encoded_ms: float | None = None
    """Trials are encoded up to here; None: to their end."""
    network: RSNNSpec | None = None
    search: SearchSpec | None = None
    """The search of the network's hyperparameters; its result replaces the values of the keys in the space."""
    measures: Measures = {}
    """Those of the study's that measure its network."""
    test_every_condition: bool = False
    augmentation: AugmentationSpec | None = None
    balance: Balance = "none"
    training_windows: int | None = Field(default=None, ge=1)

    @property
    def seeds(self) -> tuple[int, int]:
        """Random seeds of the initial weights and of the order of trials, as of a training outside a study."""
        return of_start(self.seed, self.split)

    def clock_Hz(self, recorded_Hz: float) -> float:  # noqa: N802
        """The clock of its afferents, for recordings at a rate."""
        own_Hz = (self.calibrate or self.encoder).conditioning.resample_Hz
        return own_Hz or (recorded_Hz if self.calibrate is None else max(recorded_Hz, encoders.CLOCK_HZ))

    @property
    def given(self) -> str:
        """The input file of the cell in a run folder."""
        return f"spikes/{self.spikes_name}.h5"

    @property
    def spikes_name(self) -> str:
        """The digest of everything that decides the cell's spike trains."""
        parts = {"source", "encoder", "calibrate", *CHOICES} | ({"split"} if self.calibrate else set())
        optional = ("spikes_per_s", "augmentation", "conditioned_by", "encoded_ms")
        parts |= {name for name in optional if getattr(self, name) is not None}
        known = self.subset if self.calibrate and self.test_every_condition else None
        return specs.digest([self.model_dump(mode="json", include=parts), known])


def resolve(
    name: str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    quick: bool = False,
    data: str | Path | None = None,
) -> StudySpec:
    """Load a study file with its complete parts; its open values are chosen for its recordings (`automatic`).

    overrides: dotted keys that begin with the part, such as `network.hidden`; a swept key is no longer swept. The part
        alone, `encoder` or `network`, names another spec.
    quick: apply the file's `[quick]` table of overrides first.
    data: the file of recordings of a study that names none.
    """
    path, overridden, keys = specs.find(StudySpec.folder, name), overrides or {}, StudySpec.model_fields
    own_axes = sweeps.keys({key.removeprefix(sweeps.SWEEP): [] for key in overridden if key.startswith(sweeps.SWEEP)})
    for key in (key for key in own_axes if key in overridden):
        raise InputError(f"{key}: is set and swept; give its value, or its values as {sweeps.SWEEP}{key}")
    is_shipped = not (overrides or quick) and path in specs.shipped(StudySpec.folder)
    table = automatic.table_of(path)
    table |= {key: automatic.placed(table[key], path) for key in ("dataset",) if key in table}
    quick_overrides = specs.pop_table(table, "quick", path)
    overrides = {**(quick_overrides if quick else {}), **(overrides or {})}
    # A study's own table `set` contains the changes of its parts.
    overrides = {**specs.pop_table(table, "set", path), **overrides}
    overrides, table = measures.placed(overrides, keys), measures.gathered(table, keys)
    is_open = {key for key in automatic.OPEN if overrides.get(key) == automatic.AUTO}
    overrides = {key: value for key, value in overrides.items() if key not in is_open}
    named = {part: overrides.pop(part) for part in PARTS if isinstance(overrides.get(part), str)}
    for part, load in PARTS.items():
        if part not in named and not isinstance(table.get(part), str):
            continue
        loaded = load(named[part] if part in named else _relative_to(path, table[part]))
        table[part] = _whole(loaded)
        if part == "encoder" and "integration" in loaded.model_fields_set:
            is_open.discard(automatic.INTEGRATION)
    table, left = automatic.closed(table)
    left |= is_open
    axes = {key: value for key, value in overrides.items() if key.startswith(sweeps.SWEEP)}
    sweeps.unswept(table.setdefault("sweep", {}), axes, path)
    _with_own_periods(table)
    overrides = _with_own_width(table, overrides, overridden)
    _with_every_encoder(table["sweep"])
    open_periods = automatic.closed_periods(table["sweep"])
    values = {key: value for key, value in overrides.items() if key not in axes}
    first = {key: values.pop(key) for key in own_axes if key in values}  # what the file sets does not end a sweep
    table = specs.override(table, {**first, **sweeps.unswept(table["sweep"], values, path)})
    table = automatic.with_file(table, data, path)
    table |= {key: automatic.placed(table[key], Path("set")) for key in ("dataset",) if key in table}  # of `overrides`
    search = table.get("search", {})
    if isinstance(search, dict) and isinstance(search.get("space"), str):
        search["space"] = spaces.load_space(str(_relative_to(path, search["space"])))
    if overrides or named or quick:
        table.pop("as_shipped", None)
    table |= {"as_shipped": True} if is_shipped else {}
    study = specs.build(StudySpec, table, source=str(path))
    if left or open_periods:
        table = _with_auto_values(table, study, left, open_periods, overrides, path)
        study = specs.build(StudySpec, table, source=str(path))
    note = automatic.note_of(study.dataset.choice)
    study = study if note in (None, *study.notes) else study.model_copy(update={"notes": (note, *study.notes)})
    decided = {*specs.leaves(overrides), *sweeps.keys(study.sweep)}
    study = study.model_copy(update={choice: False for choice, key in CHOICES.items() if key in decided})
    if study.search is not None and study.network is not None:
        spaces.check(study.search.space, study.network, source=f"search.space of {path}")
    if study.dataset.simulate is not None:
        model = simulator(study.dataset.simulate).model
        specs.build(model, study.dataset.parameters, source=f"dataset.parameters of {path}")
    # A wrong value in a sweep raises an error here, before any cell runs.
    every = list(cells(study))
    given = [*specs.leaves(overridden), *sweeps.keys(study.sweep)]
    effects.check_keys(given, map(_void_keys, every), str(path))
    starts = [cell.calibrate for cell in every]
    calibration_keys.check(overrides, study.sweep, [start for start in starts if start is not None])
    return study


def _with_own_periods(table: dict[str, Any]) -> None:
    """Sweep the refractory periods that the encoder has in place of the pairs of SA-I and RA-I, in `table`."""
    sweep, encoder = table["sweep"], table.get("encoder")
    pairs = sweep.get(PAIR) if isinstance(sweep, dict) else None
    model = encoder.get("model", "lif") if isinstance(encoder, dict) else "lif"
    if pairs is None or not plugins.has("encoders", model):
        return
    keys = [f"{calibration_keys.ENCODER}{key}" for key in encoders.period_keys(model)]
    if set(PAIR.split(sweeps.JOIN)) <= set(keys):
        return
    axes = {key: values for key, values in sweep.items() if key != PAIR}
    if len(keys) == 1:
        is_open = isinstance(pairs, str)
        table["sweep"] = {keys[0]: pairs if is_open else list(dict.fromkeys(max(pair) for pair in pairs)), **axes}
    elif len(keys) > 1:
        table["sweep"] = {sweeps.JOIN.join(reversed(keys)): pairs, **axes}
    else:
        table["sweep"] = axes
        log.warning("sweep: %s afferents have no refractory period; the sweep of pairs is left out", model)


def _of_a_layer(key: str, values: Any) -> Any:
    """Swept numbers of hidden neurons without 0, which stands for no hidden layer; other values as they are."""
    is_width = key.removeprefix(sweeps.SWEEP) == HIDDEN and isinstance(values, list)
    return [value for value in values if value != 0] if is_width else values


def _with_own_width(table: dict[str, Any], overrides: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out the hidden neurons that the study sets or sweeps, in `table`, where its network has no such key.

    Returns the overrides that remain. Where the user has given hidden neurons, nothing is left out.
    """
    network, own = table.get("network"), {HIDDEN, f"{sweeps.SWEEP}{HIDDEN}"}
    named = network.get("model", "rsnn") if isinstance(network, dict) else "rsnn"
    model = overrides.get("network.model", named)
    is_part = isinstance(model, str) and model not in BUILT_IN and plugins.has("networks", model)
    if not is_part or own & {*specs.leaves(given)}:
        return dict(overrides)
    if "hidden" in part_of(model).keys.model_fields:  # each of its layers has a neuron or more
        table["sweep"] = {key: _of_a_layer(key, values) for key, values in table["sweep"].items()}
        return {key: _of_a_layer(key, values) for key, values in overrides.items()}
    if isinstance(network, dict) and model != named:  # the study's network has them
        network.pop("hidden", None)
    if table["sweep"].pop(HIDDEN, None) is not None or own & {*overrides}:
        log.warning("network: '%s' has no key hidden; the study's numbers of hidden neurons are left out", model)
    return {key: value for key, value in overrides.items() if key not in own}


def _with_every_encoder(sweep: Any) -> None:
    """Replace `every` by the encoders and refractory periods that it stands for, in `sweep`."""
    axis = f"encoder{sweeps.JOIN}{T_REF}"
    if isinstance(sweep, dict) and sweep.get(axis) == EVERY:
        sweep[axis] = [
            [encoders.default_of(model), period]
            for model, row in usable().items()
            if row.is_compared
            for period in ([OWN, LONGER_MS] if encoders.period_keys(model) else [OWN])
        ]


def _with_auto_values(
    table: dict[str, Any],
    study: StudySpec,
    left: Set[str],
    open_periods: Mapping[str, str],
    given: Mapping[str, Any],
    path: Path,
) -> dict[str, Any]:
    """The table of a study with its open values, which are `left`, chosen for its recordings, and notes of the rules.

    study: built from the table, with a default in place of each open value. open_periods: of
    `automatic.closed_periods`. given: as of `automatic.suit`.
    """
    if study.dataset.file is None:
        raise InputError(
            f"{path}: '{automatic.AUTO}' is chosen from a file of recordings; name one with `data` or dataset.file"
        )
    clock_Hz = study.encoder.conditioning.resample_Hz
    uses_onsets = "window" in left and bool(automatic.untrained_conditions(table))
    choice, at_most = study.dataset.choice, study.dataset.at_most
    recorded = automatic.look(expand(study.dataset.file), clock_Hz, choice, at_most=at_most, onsets=uses_onsets)
    sample_ms, step_ms = (1e3 / rate_Hz for rate_Hz in (recorded.sampling_rate_Hz, recorded.timing.clock_Hz))
    rates = max(step_ms, sample_ms), step_ms
    chosen = {axis: automatic.periods_of(axis, word, *rates) for axis, word in open_periods.items()}
    table = {**table, "sweep": {**table["sweep"], **chosen}}
    table, notes = automatic.suit(table, recorded, left, given, split=study.split)
    notes = [*automatic.of_fewer(recorded), *notes, *(automatic.of_periods(*rates) if open_periods else ())]
    exact = is_exact(study.encoder)
    periods = filter(calibration_keys.is_period, sweeps.keys(study.sweep))
    swept = [value for key in periods for value in sweeps.values(study.sweep, key)]
    if automatic.INTEGRATION in left and pays_exact(study.encoder, recorded.sampling_rate_Hz, swept):
        exact, table = True, {**table, "encoder": {**table["encoder"], "integration": "exact"}}
    notes += automatic.clock(recorded, clock_Hz, exact=exact)
    is_swept = not {"encoder", automatic.MEMBRANE}.isdisjoint(sweeps.keys(study.sweep))
    is_open = automatic.MEMBRANE in left and not is_swept and not automatic.untrained_conditions(table)
    if is_open and isinstance(study.encoder, AfferentSpec):
        own_ms, length_ms = study.encoder.tau_mem_ms, study.window.length_ms
        swept_ms = sweeps.values(study.sweep, LENGTH)
        length_ms = min(swept_ms) if swept_ms else table["window"].get("length_ms", length_ms)
        tau_ms = automatic.membrane_ms(length_ms, own_ms)
        table = {**table, "encoder": {**table["encoder"], "tau_mem_ms": tau_ms}}
        notes += automatic.of_membrane(tau_ms, own_ms, "shortest window" if swept_ms else "window")
    return {**table, "notes": [*study.notes, *notes]}


def to_toml(study: Spec) -> str:
    """The resolved study as TOML that `resolve` reads back equal, with the number of its form."""
    return specs.to_toml(specs.saved(_whole(study)))


def cells(study: StudySpec) -> Iterator[Cell]:
    """The cells in the order of the sweep: the first axis is the slowest."""
    every = [*_each_cell(study)]
    encoded_ms = None if study.past_windows else reach_ms(*every)  # windows that are swept share their spikes
    return (cell.model_copy(update={"encoded_ms": encoded_ms}) for cell in every)


def _each_cell(study: StudySpec) -> Iterator[Cell]:
    search = _searched(study)
    base = {
        "source": study.dataset.identity(),
        "calibrate": _whole(study.encoder) if study.calibrate else None,
        "seed": 0,
        **{part: _whole(getattr(study, part)) for part in ("window", "split", "early_exit", "encoder")},
        **({"network": _whole(study.network)} if study.network else {}),
        **({"search": search} if search else {}),
        **{choice: study.calibrate and getattr(study, choice) for choice in CHOICES},
        **{name: getattr(study, name) for name in ("balance", "training_windows", "test_every_condition")},
        "measures": {
            name: study.measures[name] for name, one in measures.requested(study.measures).items() if one.of_network
        },
        **({} if study.spikes_per_s is None else {"spikes_per_s": study.spikes_per_s}),
        **({} if study.augmentation is None else {"augmentation": _whole(study.augmentation)}),
    }
    for point in sweeps.points(study.sweep):
        chosen = {"dataset": next(iter(study.dataset.subsets)), **point}
        chosen["subset"] = study.dataset.subsets[chosen["dataset"]]
        if isinstance(point.get("encoder"), str):
            swept = encoders.load(point["encoder"]).model_copy(update={"conditioning": study.encoder.conditioning})
            own_ms = point.get(T_REF, OWN)
            chosen["encoder"] = _whole(swept if own_ms == OWN else encoders.with_t_ref(swept, float(own_ms)))
            if study.calibrate:
                chosen |= {"calibrate": _whole(swept), "conditioned_by": base["calibrate"]}
        chosen.pop(T_REF, None)
        chosen = {_in_cell(key): value for key, value in chosen.items()}
        if study.calibrate:
            chosen |= calibration_keys.start(point)
        cell = specs.build(Cell, specs.override(base, chosen), source=f"sweep of {study.title}")
        cell, clock_Hz = _augmented(cell), (cell.calibrate or cell.encoder).conditioning.resample_Hz
        if cell.network is not None and clock_Hz is not None:
            clock.steps_per_bin(cell.network.step_ms, clock_Hz, "network.step_ms")
        balancing.columns_of(cell.balance, cell.split, cell.source["stratify"], balancing.SETTINGS)
        _check_source(cell, study)
        yield cell


def _augmented(cell: Cell) -> Cell:
    """The cell without the varied copies that it does not need: `auto` needs a test on other conditions, and no search.

    Raises InputError for a search with a kind of copies by name.
    """
    kind = None if cell.augmentation is None else cell.augmentation.kind
    is_idle = kind == NONE or (kind == AUTO and (not cell.split.test_where or cell.search is not None))
    if kind is not None and not is_idle and cell.search is not None:
        raise InputError("augmentation.kind: a search trains without varied copies; leave one of them out")
    if kind is None or is_idle:  # without copies a network learns the sizes of its own conditions
        return cell.model_copy(update={"augmentation": None, "choose_grades": False})
    return cell


def reach_ms(*cells: Cell, recorded_Hz: float | None = None) -> float | None:
    """Where the last window of some cells ends; None if this depends on the trial.

    recorded_Hz: the rate of the recordings, on whose clock windows that are no whole steps may end later.
    """
    ends_ms = [end_ms for cell in cells if (end_ms := _end_ms(cell, recorded_Hz)) is not None]
    return max(ends_ms) if len(ends_ms) == len(cells) else None


def _end_ms(cell: Cell, recorded_Hz: float | None) -> float | None:
    window = cell.window
    if cell.network is None or window.per_trial is None or window.align != "trial":
        return None
    later = max(window.per_trial, cell.training_windows or 1) - 1
    end_ms = window.start_ms + window.length_ms + later * (window.hop_ms or window.length_ms)
    if recorded_Hz is not None:
        clock_Hz = cell.clock_Hz(recorded_Hz)
        length, first, hop = steps_of(window, clock_Hz)
        end_ms = max(end_ms, 1e3 * (first + length + later * hop) / clock_Hz)
    return end_ms if cell.augmentation is None else cell.augmentation.reach_ms(end_ms)


def _void_keys(cell: Cell) -> dict[str, str]:
    """The keys of a study that have no effect in a cell, and why."""
    split = effects.voids(folds=cell.split.folds, test_where=cell.split.test_where, order=cell.split.order)
    onset = effects.voids(align=cell.window.align)
    without = "has no effect without a network, as in `settings={'network': 'rsnn'}`; leave it out"
    network = {} if cell.network is None or cell.search is not None else recipe.void_keys(cell.network)
    return {
        **{f"window.{key}": why for key, why in onset.items()},
        **{f"split.{key.removeprefix('split.')}": why for key, why in split.items()},
        **_void_in_copies(cell.augmentation),
        **({"balance": without} if cell.network is None else {}),
        "search.seed": "has no effect in a study, which draws that of each cell's search from `seed`; leave it out",
        **{f"network.{key}": why for key, why in network.items()},
    }


def _void_in_copies(copies: AugmentationSpec | None) -> dict[str, str]:
    """The keys of varied copies that belong to a part which does not vary. copies: None if none are made."""
    parts = set[str]() if copies is None else copies.parts
    keys = {"time_factor": "time", "gain_factor": "gain", "shift_ms": "start", "taxel_share": "taxels"}
    return {
        f"augmentation.{key}": f"has no effect without '{part}' in augmentation.kind; add it there, or leave it out"
        for key, part in keys.items()
        if part not in parts
    }


def _in_cell(key: str) -> str:
    """A swept key of a study as a key of its cells."""
    return f"source.parameters.{key.removeprefix(SOURCE)}" if key.startswith(SOURCE) else key


def _check_source(cell: Cell, study: StudySpec) -> None:
    if any(key.startswith(SOURCE) for key in sweeps.keys(study.sweep)):
        model = simulator(cell.source["simulate"]).model
        specs.build(model, cell.source["parameters"], source=f"sweep of {study.title}")


def _searched(study: StudySpec) -> dict[str, Any] | None:
    """The study's search without the swept keys; None if there is no search."""
    if study.search is None:
        return None
    swept = {key.removeprefix("network.") for key in sweeps.keys(study.sweep)}
    space = {key: dimension for key, dimension in study.search.space.items() if key not in swept}
    if not space:
        raise InputError(f"search: the sweep of {study.title} decides every key of its space; remove one of them")
    return {**_whole(study.search), "space": space}


def swept_columns(study: StudySpec) -> list[str]:
    """Swept keys that the standard columns of results.csv do not show, such as `window.length_ms`."""
    shown = {"dataset", "seed", "network.hidden", T_REF, "encoder.ra1.t_ref_ms", "encoder.sa1.t_ref_ms"}
    return [key for key in sweeps.keys(study.sweep) if key not in shown]


def split_columns(study: StudySpec) -> list[str]:
    """Swept keys of the split, such as `split.fold`: results are averaged over them, as over seeds."""
    return [key for key in swept_columns(study) if key.startswith(SPLIT)]


def setting_columns(study: StudySpec) -> list[str]:
    """Of `swept_columns`, those that tell apart what is compared: not the encoder's own refractory periods.

    The referee chooses among refractory periods, as among sizes.
    """
    periods = {f"{calibration_keys.ENCODER}{key}" for key in encoders.period_keys(study.encoder.model)}
    return [key for key in swept_columns(study) if key not in periods]


def encoder_columns(study: StudySpec) -> list[str]:
    """Of `setting_columns`, those that decide the spikes, such as `encoder.tau_mem_ms`, and their varied copies."""
    begins = calibration_keys.ENCODER, COPIES
    return [key for key in setting_columns(study) if key in OF_SPIKES or key.startswith(begins)]


def encoder_names(study: StudySpec) -> dict[str, str]:
    """The encoders that a study sweeps, by their models, which tables hold."""
    names = [name for name in sweeps.values(study.sweep, "encoder") if isinstance(name, str)]
    return {encoders.load(name).model: name for name in dict.fromkeys(names)}


def has_one_window(study: StudySpec) -> bool:
    """Whether the networks of all cells have the windows of the first one, as the opponents have."""
    return not any(key.startswith("window.") or key == "training_windows" for key in swept_columns(study))


def has_one_split(study: StudySpec) -> bool:
    """Whether all cells have the split of a study that names none: folds may then test every trial."""
    return study.split == SplitSpec() and not split_columns(study)


def by_split(cells: Iterable[Cell]) -> list[list[Cell]]:
    """Groups of cells with the same split."""
    groups: dict[str, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(cell.split.model_dump_json(), []).append(cell)
    return list(groups.values())


def value_at(cell: Cell, dotted: str) -> Any:
    """The value of a dotted key in a cell."""
    if dotted == T_REF:
        return encoders.t_ref_pair_ms(cell.encoder)[0]
    if dotted == "encoder":
        return cell.encoder.model
    if dotted.startswith(COPIES) and cell.augmentation is None:
        return NONE if dotted == f"{COPIES}kind" else None
    value: Any = cell
    for name in _in_cell(dotted).split("."):
        own = getattr(value, "own", None)  # the keys of a network that is a part, before those of every network
        value = value[name] if isinstance(value, dict) else getattr(own if hasattr(own, name) else value, name)
    return value


def _whole(spec: Spec) -> dict[str, Any]:
    return spec.model_dump(mode="json", exclude_none=True)


def _relative_to(study: Path, name: str) -> str | Path:
    """A relative path of a part is one from the folder of the study file, or else from the current folder."""
    return (files.place_of(study, name) or study.parent / name) if name.endswith(".toml") else name
