"""The cost of a decision of a spiking chain, from measured numbers, beside that of the baselines.

The layers are those of `neurotact.metrics.flops`; SOPs and steps are the measured means over test windows.
"""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

import pandas as pd

from neurotact.encoders.afferents import taxels_of
from neurotact.encoders.specs import MODELS
from neurotact.metrics.flops import (
    Cost,
    Integrator,
    Layer,
    MovingAverage,
    SpikingLayer,
    cost,
    ledger_table,
)
from neurotact.metrics.signal_flops import (
    BaselineRemoval,
    Interpolation,
    Rectification,
    ScaledSteps,
    StandardisedSteps,
)
from neurotact.networks import recipe
from neurotact.networks.specs import RSNNSpec
from neurotact.tables import NETWORK, means_over

SOPS = ("sops_input", "sops_recurrent", "sops_readout")
MODEL = "network.model"
ABOUT = (
    "Conditioning and encoding are counted for both populations of every taxel, on every step of the window. "
    "Energy is an estimate of the arithmetic alone, without memory: 4.6 pJ per MAC and 0.9 pJ per other operation, "
    "32-bit floating point at 45 nm (Horowitz, ISSCC 2014)."
)


def encoding_cost(n_taxels: int, steps: float, signal_ms: float, encoder: Mapping[str, Any]) -> Cost:
    """The cost of an encoder over a window, from the recording to the spikes: conditioning and both populations.

    encoder: its spec, as spike trains hold it; by default LIF without conditioning.

    Every step of the encoder's clock counts, even for the moving average of a slower recording that is resampled later.
    Parameters are the values that a sensor's calibration fits: one gain per population (one per grade and polarity), an
    offset and a scale per taxel. Constants that all afferents share (decay, threshold, t_ref, the average's weight) do
    not count, as in every layer of the ledger.

    >>> lif = {"conditioning": {"ema_cutoff_Hz": 30.0, "baseline": "mean"}}
    >>> encoding_cost(8, 300, 150.0, {}).flops, encoding_cost(8, 300, 150.0, lif).flops
    (28800, 40808)
    >>> calibrated = {"conditioning": {"resample_Hz": 1000.0, "offset": [0.0] * 16, "scale": [1.0] * 16}}
    >>> encoding_cost(16, 300, 300.0, calibrated).parameters
    34
    """
    window = max(1, round(steps))
    conditioning = _conditioning(encoder.get("conditioning") or {}, n_taxels, window)
    afferents = _afferents(encoder, n_taxels, window, signal_ms / steps if steps else 0.0)
    return cost(*conditioning, afferents, signal_ms=signal_ms)


def _conditioning(spec: Mapping[str, Any], n_taxels: int, steps: int) -> Iterator[Layer]:
    """The layers of `data.conditioning.condition`, in its order."""
    size = steps, n_taxels
    if spec.get("ema_cutoff_Hz") is not None:
        yield MovingAverage(*size)
    if spec.get("resample_Hz") is not None:
        yield Interpolation(*size)
    if spec.get("baseline", "none") != "none":
        yield BaselineRemoval(*size, level=spec["baseline"])
    if spec.get("offset") is not None:
        yield StandardisedSteps(*size)  # an offset costs the same without scales, or with scales of 1
    elif spec.get("scale") is not None:
        yield ScaledSteps(*size)
    if spec.get("rectify"):
        yield Rectification(*size)


def _afferents(encoder: Mapping[str, Any], n_taxels: int, steps: int, step_ms: float) -> Layer:
    return MODELS[encoder.get("model", "lif")].layer(encoder, n_taxels, steps, step_ms)


def network_cost(
    spec: RSNNSpec, n_afferents: int, n_classes: int, measured: Mapping[str, Any], *, steps: float, signal_ms: float
) -> Cost:
    """The cost of the spiking network for one decision.

    spec: of the network: its hidden neurons, recurrence and readout count.
    measured: mean SOPs of the projections, with the names of `SOPS`.
    steps: simulated steps of a decision, a mean under early exit.

    >>> measured = {"sops_input": 900, "sops_recurrent": 300, "sops_readout": 80}
    >>> found = network_cost(RSNNSpec(hidden=30), 16, 8, measured, steps=300, signal_ms=150)
    >>> found.macs, found.acs, found.parameters
    (22800, 1280, 1620)
    """
    into_hidden, into_readout = measured["sops_input"] + measured["sops_recurrent"], measured["sops_readout"]
    leaky_steps = 0.0 if spec.readout_leak_ms is None else steps
    readout = (
        Integrator(spec.hidden, n_classes, sops=into_readout, leaky_steps=leaky_steps, peak=spec.readout == "max")
        if spec.integrates
        else SpikingLayer(spec.hidden, n_classes, steps=steps, sops=into_readout, recurrent=False)
    )
    return cost(
        SpikingLayer(
            n_afferents, spec.hidden, steps=steps, sops=into_hidden, recurrent=spec.recurrent,
            adapts=spec.threshold_adaptation > 0,
        ),
        readout,
        signal_ms=signal_ms,
    )  # fmt: skip


def decision_ledger(
    spec: RSNNSpec,
    n_afferents: int,
    n_classes: int,
    rate_Hz: float,
    summary: pd.DataFrame,
    *,
    encoder: Mapping[str, Any],
) -> pd.DataFrame:
    """The ledger of one trained network: encoder, network and both, from the `all` row of a SOP summary.

    summary: of `metrics.synops.summary`. spec: as for `network_cost`; encoder: as for `encoding_cost`.
    """
    measured = summary.iloc[-1]
    steps = float(measured["steps"])
    signal_ms = 1e3 * steps / rate_Hz
    encoding = encoding_cost(taxels_of(n_afferents, encoder), steps, signal_ms, encoder)
    network = network_cost(spec, n_afferents, n_classes, measured, steps=steps, signal_ms=signal_ms)
    return ledger_table([("encoder", encoding), ("network", network), ("both", encoding + network)])


def study_ledger(
    spec: RSNNSpec,
    results: pd.DataFrame,
    baselines: pd.DataFrame | None,
    *,
    n_afferents: int,
    n_classes: int,
    rate_Hz: float,
    encoder: Mapping[str, Any],
) -> pd.DataFrame:
    """The ledger of a study: the baselines, encoding alone, and encoding with each network (means over seeds).

    spec: of the study's network, resolved by its recipe if it has one; `hidden` and, if it was swept or searched,
        `network.model` come from `results`.
    results: a run's `results.csv` with the columns `pair` and `setting`.
    baselines: its `baselines.csv`, whose rows are means over splits and data sets; None: no such rows.
    encoder: as for `encoding_cost`.
    """
    n_taxels = taxels_of(n_afferents, encoder)
    rows: list[tuple[str, Cost]] = []
    if baselines is not None:
        spent = [field.name for field in fields(Cost) if field.name in baselines]
        means = baselines.groupby(["classifier", "input"], sort=False)[spent].mean()
        for (classifier, source), row in means.iterrows():  # pyright: ignore[reportGeneralTypeIssues]
            whole = {name: round(row[name]) for name in ("parameters", "bytes") if name in row}
            rows.append((f"{classifier} on {source}", Cost(**{**row.to_dict(), **whole})))
    for steps in sorted(results["window_steps"].unique()):
        window_ms = 1e3 * steps / rate_Hz
        rows.append(
            (f"conditioning and encoding alone, {window_ms:g} ms", encoding_cost(n_taxels, steps, window_ms, encoder))
        )
    by = [*NETWORK, *([MODEL] if MODEL in results else [])]
    for _, row in means_over(results, by, [*SOPS, "window_steps"], "seeds").iterrows():
        name = f"spiking: {row['setting']}, t_ref {row['pair']} ms, N = {row['hidden']}"
        sizes: dict[str, Any] = {"n_afferents": n_afferents, "n_classes": n_classes}
        rows.append((name, row_cost(spec, row, **sizes, rate_Hz=rate_Hz, encoder=encoder)))
    return ledger_table(rows)


def row_cost(
    spec: RSNNSpec,
    row: Mapping[str, Any],
    *,
    n_afferents: int,
    n_classes: int,
    rate_Hz: float,
    encoder: Mapping[str, Any],
    early: bool = False,
    encoding: bool = True,
) -> Cost:
    """The cost of a decision for one row of `results.csv`, encoding and network together; a row of means works too.

    early: with early exit. encoding: whether conditioning and encoding count. The other arguments are as for
    `study_ledger`.
    """
    window_steps = float(row["window_steps"])
    steps = float(row["exit_steps"]) if early else window_steps
    signal_ms = 1e3 * steps / rate_Hz
    chosen = recipe.resolve(spec, recipe.Seen(1, round(window_steps), rate_Hz, 1.0))
    own = chosen.model_copy(update={"hidden": int(row["hidden"]), "model": row.get(MODEL, chosen.model)})
    measured = {name: row[f"exit_{name}" if early else name] for name in SOPS}
    network = network_cost(own, n_afferents, n_classes, measured, steps=steps, signal_ms=signal_ms)
    return network + encoding_cost(taxels_of(n_afferents, encoder), steps, signal_ms, encoder) if encoding else network
