"""The cost of a decision of a spiking chain, from measured numbers, beside that of the baselines.

The layers are those of `neurotact.metrics.flops`; SOPs and steps are the measured means over test windows.
"""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import astuple, fields
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.cost import NOT_COUNTED, encoding_cost, is_countable, no_cost
from neurotact.encoders.specs import taxels_of
from neurotact.errors import InputError, number_of
from neurotact.metrics.flops import SYNAPSES, Cost, Integrator, NotCounted, SpikingLayer, cost, ledger_table
from neurotact.metrics.prices import ACCESSES, ARITHMETIC_45NM, PriceList
from neurotact.networks.definition import module, recipe
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.use.measuring import OWN_KEYS, SPIKES, TOUCHED
from neurotact.spec import build, digest
from neurotact.tables import columns_of_network, in_words_of_size, means_over

SOPS = ("sops_input", "sops_recurrent", "sops_readout")
MEASURED = (*SOPS, "sops_total", "sops_total_feedforward")
GIVES_COST = "its module gives it with a method named cost (docs/plugins.md)"
MODEL = "network.model"
STEPS_PER_BIN = "steps_per_bin"
"""Column of results: steps of the encoder's clock in one of the network's."""
STRETCHES = "readout_stretches"
"""Column of results: stretches of a window with readout weights of their own."""
BLOCKS = "recurrent_blocks"
"""Column of results: blocks of hidden neurons within which recurrent synapses exist; absent where all have one."""
DIRECT = "direct"
"""Column of results: 1 where the readout hears the afferents past a hidden layer; absent or empty where it does not."""
OF_COST = {f"network.{key}": key for key in ("readout", "readout_tau_ms", "threshold_adaptation")}
"""Columns of results where these keys of a network are swept or searched, on which its operations depend."""
KIND = "afferents"
"""Column of the rows of a study: which afferents made the spikes of the network."""
AMONG = "among"
"""Column of the rows of a study: whether hidden neurons sent spikes to one another."""
ABOUT = {
    "sensor": "Conditioning and encoding are in the sensor and not counted; neurons are, on every step of their clock.",
    "processor": "Conditioning and encoding are counted for both populations of every taxel, on every step of the "
    "encoder's clock (with integration = exact, on every sample, and for every spike), a moving average on every "
    "sample of the sensor; neurons on every step of the network's clock.",
}
"""What is counted, by where a study encodes."""


class Afferents(NamedTuple):
    """What made the spikes of a network: how many afferents, by an encoder (its table), and its steps per second.

    recorded_Hz: samples of the recordings per second; None if unknown.
    """

    n: int
    encoder: Mapping[str, Any]
    rate_Hz: float
    recorded_Hz: float | None = None

    @staticmethod
    def of(trains: SpikeTrains) -> "Afferents":
        """What made these spikes."""
        return Afferents(len(trains.afferents), trains.encoder, trains.sampling_rate_Hz, trains.recorded_Hz)

    @property
    def is_countable(self) -> bool:
        """Whether the cost of conditioning and encoding is known."""
        return is_countable(self.encoder, self.recorded_Hz)

    @property
    def has_average_apart(self) -> bool:
        """Whether a moving average runs at the rate of the recordings, and all else at another."""
        averaged = (self.encoder.get("conditioning") or {}).get("ema_cutoff_Hz") is not None
        return averaged and self.recorded_Hz not in (None, self.rate_Hz)

    def cost(self, steps: float, spikes: float | None = None) -> Cost:
        """The cost of conditioning and encoding, none of a sensor's events; steps, spikes: of a decision.

        InputError where it is not known.
        """
        if not self.encoder:
            return Cost()
        n_taxels, signal_ms = taxels_of(self.n, self.encoder), 1e3 * steps / self.rate_Hz
        return encoding_cost(n_taxels, steps, signal_ms, self.encoder, recorded_Hz=self.recorded_Hz, spikes=spikes)


def network_cost(
    spec: RSNNSpec,
    n_afferents: int,
    n_classes: int,
    measured: Mapping[str, Any],
    *,
    steps: float,
    signal_ms: float,
    event_driven: bool = False,
) -> Cost:
    """The cost of the spiking network for one decision.

    spec: of the network: its hidden neurons, recurrence and readout count.
    measured: mean SOPs of the projections, with the names of `SOPS`; and of `TOUCHED`, where it is event-driven; and
        of `SPIKES` and `SYNAPSES`, where SOPs do not tell them: weights were pruned, or layers are another package's.
    steps, signal_ms: of a decision, a mean under early exit; steps are of the encoder's clock, of which a network with
        a `step_ms` computes one in several.
    event_driven: neurons are updated when a spike comes, in place of on every step; NaN where the steps with a spike
        were not measured, or a network is another package's.

    >>> measured = {"sops_input": 900, "sops_recurrent": 300, "sops_readout": 80}
    >>> found = network_cost(RSNNSpec(hidden=30), 16, 8, measured, steps=300, signal_ms=150)
    >>> found.macs, found.acs, found.parameters
    (22800, 1280, 1620)
    """
    steps = steps if spec.own_step_ms is None else signal_ms / spec.own_step_ms
    if spec.own is not None:
        found = module.cost_of(spec, n_afferents, n_classes, measured, steps, signal_ms)
        if found is None:
            raise InputError(f"network: the cost of '{spec.model}' is not counted; {GIVES_COST}")
        return found if not event_driven else found + NotCounted()
    touched = [measured.get(name) for name in TOUCHED] if event_driven else [None, None]
    if event_driven and any(map(pd.isna, touched)):
        return NotCounted(signal_ms=signal_ms)
    arrived, sent = _spikes_of(spec, n_classes, measured)
    into, among, out = (_known(measured.get(name)) for name in SYNAPSES)
    into_hidden, into_readout = measured["sops_input"] + measured["sops_recurrent"], measured["sops_readout"]
    leaky_steps = 0.0 if spec.readout_leak_ms is None else steps
    readout = (
        Integrator(
            spec.heard(n_afferents), n_classes, sops=into_readout, leaky_steps=leaky_steps,
            peak=spec.readout == "max", stretches=spec.readout_stretches, touched=touched[1], steps=steps,
            synapses=out,
            spikes=sent if spec.hidden else arrived,
            beside=(n_afferents, arrived) if spec.hidden and spec.direct else (0, 0.0),
            sops_sent=into_readout * _share_sent(spec, arrived, sent),
        )
        if spec.integrates
        else SpikingLayer(
            spec.hidden, n_classes, steps=steps, sops=into_readout, recurrent=False, spikes=sent, touched=touched[1],
            sops_sent=into_readout, synapses=(out, None),
        )
    )  # fmt: skip
    if not spec.hidden:
        return cost(readout, signal_ms=signal_ms)
    return cost(
        SpikingLayer(
            n_afferents, spec.hidden, steps=steps, sops=into_hidden, recurrent=spec.fan_among,
            adapts=spec.threshold_adaptation > 0, spikes=arrived, sent=sent,
            touched=touched[0], sops_sent=measured["sops_recurrent"], synapses=(into, among),
        ),
        readout,
        signal_ms=signal_ms,
    )  # fmt: skip


def _spikes_of(spec: RSNNSpec, n_classes: int, measured: Mapping[str, Any]) -> tuple[float, float]:
    """Spikes of afferents and of hidden neurons: measured or, where all weights are there, from the operations."""
    if SPIKES[0] in measured and SPIKES[1] in measured:
        return measured[SPIKES[0]], measured[SPIKES[1]]
    heard = measured["sops_readout"] / n_classes
    if not spec.hidden:
        return heard, 0.0
    arrived = measured["sops_input"] / spec.hidden
    return arrived, heard - arrived if spec.direct else heard


def _share_sent(spec: RSNNSpec, arrived: float, sent: float) -> float:
    """The share of the spikes into a readout that are of hidden neurons, and not of afferents."""
    if not spec.hears_afferents:
        return 1.0
    return sent / (arrived + sent) if sent else 0.0


def _known(value: Any) -> float | None:
    """A number that was measured, or None: in a table with rows that have it, other rows hold NaN."""
    return None if pd.isna(value) else value


def is_counted(spec: RSNNSpec) -> bool:
    """Whether the cost of a network is known; that of another package's is where its module gives it.

    >>> is_counted(RSNNSpec()), is_counted(RSNNSpec(hidden=[20, 10]))
    (True, True)
    """
    none: dict[str, float] = dict.fromkeys((*MEASURED, *SPIKES), 0.0)
    return spec.own is None or module.cost_of(spec, 1, 2, none, 1.0, 1.0) is not None


def spec_of_row(spec: RSNNSpec, row: Mapping[str, Any]) -> RSNNSpec:
    """The spec of the network of a row of results; spec: of its study, of whose keys some may be swept."""
    keys = row.get(OWN_KEYS)
    if not isinstance(keys, str):
        rsnn = spec if spec.own is None else RSNNSpec(recipe=spec.recipe, training=spec.training)
        return rsnn.model_copy(update={key: row[name] for name, key in OF_COST.items() if pd.notna(row.get(name))})
    common = {key: getattr(spec, key) for key in ("step_ms", "training")}
    return build(RSNNSpec, {**json.loads(keys), **common}, source=OWN_KEYS)


def is_row_counted(spec: RSNNSpec, row: Mapping[str, Any]) -> bool:
    """Whether the cost of the network of a row of results is known; spec: of its study."""
    return is_counted(spec_of_row(spec, row))


def input_spikes(row: Mapping[str, Any], before: str = "") -> float:
    """Mean spikes into a network, from a row of results; before: `exit_` with early exit."""
    own = row.get(f"{before}input_spikes")
    return row[f"{before}sops_input"] / row["hidden"] if own is None or pd.isna(own) else own


def decision_ledger(
    spec: RSNNSpec,
    n_afferents: int,
    n_classes: int,
    rate_Hz: float,
    summary: pd.DataFrame,
    *,
    encoder: Mapping[str, Any] | None,
    recorded_Hz: float | None = None,
    prices: PriceList = ARITHMETIC_45NM,
    synapses: Mapping[str, int] = MappingProxyType({}),
) -> pd.DataFrame:
    """The ledger of one trained network: encoder, network and both, from the `all` row of a SOP summary.

    summary: of `metrics.synops.summary`. spec: as for `network_cost`; encoder, recorded_Hz: as for `encoding_cost`;
    where the encoder is None, or empty as of the events of a sensor, the network alone counts; so it does, with a
    warning, where a rate is missing. NaN, with a warning, where the encoder declares no cost. synapses:
    `Network.synapses`.
    """
    measured = {**summary.iloc[-1], **synapses}
    steps = float(measured["steps"])
    signal_ms = 1e3 * steps / rate_Hz
    spent = []
    if is_counted(spec):
        how = {"steps": steps, "signal_ms": signal_ms, "event_driven": prices.event_driven}
        spent.append(network_cost(spec, n_afferents, n_classes, measured, **how))
    else:
        warnings.warn(f"the cost of the network '{spec.model}' is not counted; {GIVES_COST}", stacklevel=3)
    made_by = Afferents(n_afferents, encoder, rate_Hz, recorded_Hz) if encoder else None
    if made_by is None or not made_by.is_countable:
        if made_by is not None:
            warnings.warn(f"the ledger has the network alone: {NOT_COUNTED}", stacklevel=3)
        return ledger_table([("network", one) for one in spent], prices)
    if why := no_cost(made_by.encoder):
        warnings.warn(why, stacklevel=3)
    is_told = spec.own is None and spec.hidden and not synapses  # by SOPs
    n_spikes = measured["sops_input"] / spec.hidden if is_told else measured["input_spikes"]
    encoding = made_by.cost(steps, n_spikes)
    whole = [("network", one) for one in spent] + [("both", encoding + one) for one in spent]
    return ledger_table([("encoder", encoding), *whole], prices)


def study_ledger(
    spec: RSNNSpec,
    results: pd.DataFrame,
    baselines: pd.DataFrame | None,
    *,
    afferents: Sequence[Afferents],
    n_classes: int,
    prices: PriceList = ARITHMETIC_45NM,
    encoding: bool = True,
) -> pd.DataFrame:
    """The ledger of a study: the baselines, encoding alone, and encoding with each network (means over seeds).

    Where spikes cost something, encoding alone has a row for each refractory period.

    spec: of the study's network, resolved by its recipe if it has one; `hidden` and, if it was swept or searched,
        `network.model` come from `results`.
    results: a run's `results.csv` with the columns `pair` and `setting`.
    baselines: its `baselines.csv`, whose rows are means over splits and data sets; None: no such rows.
    afferents: of each row of `results`; they may differ where encoders are calibrated for each split.
    encoding: whether conditioning and encoding count.
    """
    kinds = [digest([*one]) for one in afferents]
    of_kind, results = dict(zip(kinds, afferents, strict=True)), results.assign(**{KIND: kinds})
    rows: list[tuple[str, Cost | None]] = []
    if baselines is not None:
        spent = [field.name for field in fields(Cost) if field.name in baselines]
        means = baselines.groupby(["classifier", "input"], sort=False)[spent].mean()
        for (classifier, source), row in means.iterrows():  # pyright: ignore[reportGeneralTypeIssues]
            counted = row.drop(ACCESSES, errors="ignore").notna().all()
            rows.append((f"{classifier} on {source}", _cost_of(row.to_dict()) if counted else None))
    for steps in sorted(results["window_steps"].unique()) if encoding else ():
        mine = results[results["window_steps"] == steps]
        sent = mine["sops_input"] / mine["hidden"] if "input_spikes" not in mine else mine.apply(input_spikes, axis=1)
        alone = {}
        for (setting, pair), own in sent.groupby([mine["setting"], mine["pair"]], sort=False):
            spikes = own.groupby(mine[KIND], sort=False).agg(["mean", "size"])
            each = [(of_kind[str(kind)].cost(steps, one["mean"]), one["size"]) for kind, one in spikes.iterrows()]
            alone[f": {setting}, t_ref {pair} ms"] = _mean(each)
        if np.allclose([*map(astuple, alone.values())], astuple(next(iter(alone.values()))), equal_nan=True):
            alone = {"": next(iter(alone.values()))}  # spikes cost nothing, and one row stands for all
        rows += [(f"conditioning and encoding alone{of}, {one.signal_ms:g} ms", one) for of, one in alone.items()]
    by = [*columns_of_network(results), *([MODEL] if MODEL in results else [])]
    counted = [is_row_counted(spec, row) for row in results.to_dict("records")]
    if not all(counted):
        n = counted.count(False)
        warnings.warn(f"the cost of {number_of(n, 'network')} is not counted; {GIVES_COST}", stacklevel=2)
        results = results[counted]
    results = results.assign(**{AMONG: results["sops_recurrent"] > 0})
    alike = (STEPS_PER_BIN, STRETCHES, BLOCKS, DIRECT, OWN_KEYS, *OF_COST)
    alike = [KIND, AMONG, *(name for name in alike if name in results)]
    measures = [*(MEASURED if OWN_KEYS in results else SOPS), "window_steps"]
    measures += [name for name in (*SPIKES, *SYNAPSES, *TOUCHED) if name in results]
    means = means_over(results, [*by, *alike], measures, "seeds")
    for _, parts in means.groupby(by, sort=False, dropna=False):
        first, spent = parts.iloc[0], []
        for row in parts.to_dict("records"):
            made_by = of_kind[row[KIND]]
            how = {"encoding": encoding, "event_driven": prices.event_driven}
            one = row_cost(spec, row, made_by, n_classes=n_classes, **how)
            spent.append((one, row["seeds"]))
        size = in_words_of_size(first, first.get(OWN_KEYS))
        rows.append((f"spiking: {first['setting']}, t_ref {first['pair']} ms, {size}", _mean(spent)))
    return ledger_table(rows, prices)


def _mean(costs: Sequence[tuple[Cost, float]]) -> Cost:
    """The mean of costs, each with its weight."""
    if len(costs) == 1:
        return costs[0][0]
    total = sum(weight for _, weight in costs)
    names = [field.name for field in fields(Cost)]
    return _cost_of({name: sum(getattr(cost, name) * weight for cost, weight in costs) / total for name in names})


def _cost_of(means: Mapping[str, Any]) -> Cost:
    """The cost with these means, some of which are of whole numbers."""
    if any(pd.isna(value) for name, value in means.items() if name not in ACCESSES):
        return NotCounted(**means)
    return Cost(**{**means, **{name: round(means[name]) for name in ("parameters", "bytes") if name in means}})


def row_cost(
    spec: RSNNSpec,
    row: Mapping[str, Any],
    afferents: Afferents,
    *,
    n_classes: int,
    early: bool = False,
    encoding: bool = True,
    event_driven: bool = False,
) -> Cost:
    """The cost of a decision for one row of `results.csv`, encoding and network together; a row of means works too.

    afferents: of this row. early: with early exit. encoding: whether conditioning and encoding count. event_driven:
    as for `network_cost`. The other arguments are as for `study_ledger`. InputError where `is_row_counted` is False.
    """
    window_steps, rate_Hz, spec = float(row["window_steps"]), afferents.rate_Hz, spec_of_row(spec, row)
    steps = float(row["exit_steps"]) if early else window_steps
    signal_ms = 1e3 * steps / rate_Hz
    chosen = recipe.resolve(spec, recipe.Seen(1, round(window_steps), rate_Hz, 1.0))
    step_ms = 1e3 * row.get(STEPS_PER_BIN, 1) / rate_Hz
    is_given = spec.recipe is None or "model" in spec.model_fields_set
    model = row.get(MODEL, spec.model if is_given else "auto")
    if model == "auto":  # decided in training: hidden neurons that are connected have operations among them
        model = "rsnn" if row["sops_recurrent"] > 0 else "snn"
    stretches = round(row.get(STRETCHES, 1))
    of_rsnn = {
        "hidden": int(row["hidden"]), "model": model, STRETCHES: stretches, BLOCKS: _blocks_of(row),
        "direct": row.get(DIRECT) == 1,
    }  # fmt: skip
    own = chosen.model_copy(update={"step_ms": step_ms, **(of_rsnn if spec.own is None else {})})
    before = "exit_" if early else ""
    measured = {name: row[f"{before}{name}"] for name in (SOPS if spec.own is None else MEASURED)}
    measured |= {name: row.get(f"{before}{name}") for name in TOUCHED}
    if spec.own is not None:
        measured |= {name: row.get(f"{before}{name}", float("nan")) for name in SPIKES}
    elif _known(row.get(SYNAPSES[0])) is not None:
        measured |= {name: row[name] for name in SYNAPSES} | {name: row[f"{before}{name}"] for name in SPIKES}
    how = {"steps": steps, "signal_ms": signal_ms, "event_driven": event_driven}
    network = network_cost(own, afferents.n, n_classes, measured, **how)
    if not encoding:
        return network
    return network + afferents.cost(steps, input_spikes(row, before))


def _blocks_of(row: Mapping[str, Any]) -> int:
    """The recurrent blocks of a row's network; beside rows with several, others have an empty cell."""
    blocks = row.get(BLOCKS)
    return 1 if blocks is None or pd.isna(blocks) else round(blocks)
