"""Cost and accuracy of the decided windows: on each side of the network's split, and before and after a change."""

from collections import defaultdict, deque
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.streams.chain import Chain
from neurotact_parts.streams.stream_state import Decision

from neurotact.encoders.cost import encoding_cost
from neurotact.metrics import synops
from neurotact.metrics.flops import SYNAPSES
from neurotact.metrics.prices import MEMORY_45NM
from neurotact.metrics.synops import TEST, TRAINING, UNKNOWN, UNSEEN, VALIDATION
from neurotact.networks.use.ledger import SOPS, network_cost

MOST_WINDOWS = 1_000
"""Default number of windows to compare before and after a change."""
SEEN = (TRAINING, VALIDATION, UNKNOWN)
LEAST_SEEN_FIRST = (UNSEEN, TEST, VALIDATION, TRAINING, UNKNOWN)
RECENT = 200
"""Number of past decisions shown to a page that opens later."""
ONE_CHANGE_S = 2.0
"""Changes within this time count as one, for example while a slider moves."""


class Scored(NamedTuple):
    """A decision and the facts about its window.

    number: of the decision. truth: index of the true class; None if it is unknown, or changed within the window.
    version: of the settings for the whole window; None if they changed within it.
    nJ: of arithmetic and memory, encoding and network together; NaN where it is not counted (`networks.ledger`).
    side: the side of the network's split that had the trial (`metrics.synops.SIDES`).
    """

    number: int
    decision: Decision
    truth: int | None
    version: int | None
    nJ: float
    side: str = UNSEEN

    @property
    def is_right(self) -> bool:
        """Whether the true class was decided; a window in which the readout heard nothing decides "nothing"."""
        return self.decision.heard and self.truth == self.decision.index

    @property
    def is_seen(self) -> bool:
        """Whether the trial was used to train the network or to choose its exit, or may have been."""
        return self.side in SEEN

    def row(self) -> list[Any]:
        """The decision in the page's format."""
        d = self.decision
        return [
            self.number, d.window, d.time_s, d.index, d.ms, d.steps, d.input_spikes, d.hidden_spikes, d.sops,
            counted(self.nJ), int(d.heard), d.held, -1 if self.truth is None else self.truth, d.start_step, self.side,
        ]  # fmt: skip


def cost_nJ(chain: Chain, decision: Decision) -> float:  # noqa: N802
    """An estimate of the energy of a decision by the default price list, as in the cost ledger."""
    measured: dict[str, Any] = {"input_spikes": decision.input_spikes, "hidden_spikes": decision.hidden_spikes}
    costs = synops.of_network(chain.network, *(np.array([n]) for n in measured.values()))
    measured |= {name: int(part[0]) for name, part in zip(SOPS, costs[:3], strict=True)}
    if there := chain.network.synapses:  # a decision tells all operations: those of the readout are the mean of spikes
        spec = chain.network.spec
        heard = decision.hidden_spikes + decision.input_spikes * spec.hears_afferents
        into_readout = heard * there[SYNAPSES[-1]] / spec.heard(chain.network.n_inputs)
        into_readout = min(into_readout, decision.sops) if spec.hidden else decision.sops
        measured |= there | dict(zip(SOPS, (decision.sops - into_readout, 0, into_readout), strict=True))
    network = network_cost(
        chain.network.spec, chain.network.n_inputs, chain.network.n_classes, measured,
        steps=decision.steps, signal_ms=decision.ms,
    )  # fmt: skip
    encoder = chain.encoder.model_dump(mode="json")
    encoding = encoding_cost(
        chain.n_taxels, decision.steps, decision.ms, encoder,
        recorded_Hz=chain.sampling_rate_Hz, spikes=decision.input_spikes,
    )  # fmt: skip
    return (encoding + network).energy_nJ(MEMORY_45NM)


def counted(nJ: float) -> float | None:
    """An energy in the page's format: None where it is not counted, as of an encoder that declares no cost."""
    return None if np.isnan(nJ) else nJ


def summary(rows: Sequence[Scored]) -> dict[str, Any] | None:
    """Means over windows, and the accuracy over those of known class; None without windows.

    accuracy: over touches that the network had not seen; accuracy_seen: over the others.
    """
    if not rows:
        return None
    known = [row for row in rows if row.truth is not None]
    new, seen = ([row for row in known if row.is_seen == is_seen] for is_seen in (False, True))
    means = {
        key: float(np.mean([getattr(row.decision, key) for row in rows])) for key in ("ms", "sops", "hidden_spikes")
    }
    return {
        "windows": len(rows),
        "accuracy": _accuracy(new),
        "accuracy_seen": _accuracy(seen),
        "spikes": float(np.mean([row.decision.input_spikes for row in rows])),
        "nJ": counted(float(np.mean([row.nJ for row in rows]))),
        **means,
    }


def _accuracy(rows: Sequence[Scored]) -> float | None:
    return sum(row.is_right for row in rows) / len(rows) if rows else None


class Scores:
    """All decisions so far.

    classes: of the network. A window counts for a class only if that was the same throughout it; the same holds for
    settings. A change of either therefore contains the number of the first window with the new value.
    of_side: for each side, windows by true class and decision, `(class, class + 1)`, of which the last column is
    "nothing"; where touches are refused that are none of the classes, the column before it is these. `confusion` is
    their sum.
    """

    def __init__(self, classes: Sequence[str], *, refuses: bool = False) -> None:
        self.classes = tuple(classes)
        self._n_decisions = len(self.classes) + refuses + 1
        self.compared = 20
        self._label: str | None = None
        self._label_from, self._side = 0, UNSEEN
        self._version, self._version_from = 0, 0
        self._number = 0
        self._changed_at_s: float | None = None
        self._before: deque[Scored] = deque(maxlen=MOST_WINDOWS)
        self._after: deque[Scored] = deque(maxlen=MOST_WINDOWS)
        self.changes: dict[str, tuple[Any, Any]] = {}
        self.clear()

    def clear(self) -> None:
        """Reset the counts, except those before and after a change."""
        self.of_side: dict[str, np.ndarray] = {}
        self.recent: deque[Scored] = deque(maxlen=RECENT)
        self.sums: defaultdict[str, float] = defaultdict(float)

    @property
    def confusion(self) -> np.ndarray:
        """Windows by true class and decision, on all sides, as of `of_side`."""
        return sum(self.of_side.values(), self._none())

    def _none(self) -> np.ndarray:
        return np.zeros((len(self.classes), self._n_decisions), np.int64)

    def sides(self) -> list[dict[str, Any]]:
        """The sides with windows of known class, the least seen first: their windows, correct ones and confusion."""
        return [
            {"side": side, "labelled": int(matrix.sum()), "right": int(matrix.trace()), "confusion": matrix.tolist()}
            for side in LEAST_SEEN_FIRST
            if (matrix := self.of_side.get(side)) is not None
        ]

    def label(self, label: str | None, from_window: int, side: str = UNSEEN) -> None:
        """Set the touched class and the side of its trial; windows from that number on belong to it entirely."""
        self._label, self._label_from, self._side = label, from_window, side

    def change(self, changes: dict[str, tuple[Any, Any]], from_window: int, now_s: float) -> None:
        """Record changed settings, old and new value of each; windows from that number on use the new ones.

        now_s: of a monotonic clock.
        """
        if self._changed_at_s is not None and now_s - self._changed_at_s < ONE_CHANGE_S:
            firsts = {key: old for key, (old, _) in self.changes.items()}
            merged = {key: (firsts.get(key, old), new) for key, (old, new) in changes.items()}
            self.changes = {key: change for key, change in (self.changes | merged).items() if change[0] != change[1]}
        else:
            self._before, self.changes = self._after, changes
        self._after = deque(maxlen=MOST_WINDOWS)
        self._changed_at_s = now_s
        self._version, self._version_from = self._version + 1, from_window

    def take(self, chain: Chain, decisions: Iterable[Decision]) -> list[Scored]:
        """Count decisions of a chain."""
        return [self._take(chain, decision) for decision in decisions]

    def _take(self, chain: Chain, decision: Decision) -> Scored:
        is_labelled = self._label in self.classes and decision.window >= self._label_from
        truth = self.classes.index(str(self._label)) if is_labelled else None
        version = self._version if decision.window >= self._version_from else None
        scored = Scored(self._number, decision, truth, version, cost_nJ(chain, decision), self._side)
        self._number += 1
        self.recent.append(scored)
        if version is not None:
            self._after.append(scored)
        if truth is not None:
            column = decision.index if decision.heard else -1
            self.of_side.setdefault(self._side, self._none())[truth, column] += 1
        one = {
            "decisions": 1, "ms": decision.ms, "nJ": scored.nJ, "sops": decision.sops, "hidden": decision.hidden_spikes,
            "sent": decision.input_spikes, "labelled": truth is not None, "right": scored.is_right,
        }  # fmt: skip
        for name, value in one.items():
            self.sums[name] += value
        return scored

    def comparison(self) -> dict[str, Any]:
        """The last windows before the last change and those after it."""
        n = self.compared
        before, after = ([*rows][-n:] for rows in (self._before, self._after))
        return {
            "windows": n, "before": summary(before), "after": summary(after),
            "changes": {key: list(pair) for key, pair in self.changes.items()},
        }  # fmt: skip
