"""A live session: a thread that feeds one stream, handles requests of pages between two pieces, and reports to them.

It never waits for a page. Requests wait in a short queue and are done by this thread, so that a change takes effect
between two samples.
"""

import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event
from typing import Any

import numpy as np
from neurotact_parts.exporters.live import messages
from neurotact_parts.exporters.live.feeds import TICK_S, ByHand, Feed, Replay
from neurotact_parts.exporters.live.frames import Audience, FrameBuilder, Mailbox
from neurotact_parts.exporters.live.scores import Scored, Scores, counted
from neurotact_parts.streams import sources
from neurotact_parts.streams.chain import Chain
from neurotact_parts.streams.sources import Arrived, Faults
from neurotact_parts.streams.stream import Stream
from neurotact_parts.streams.stream_state import Trace

from neurotact.backend import Backend
from neurotact.data.spikes import populations_of
from neurotact.encoders.afferents import POPULATIONS, AfferentSpec
from neurotact.errors import InputError, nearest, number_of
from neurotact.files import write_text
from neurotact.metrics.synops import UNSEEN
from neurotact.spec import build, override, to_toml

FRAME_S = 1 / 60
STATE_S = 0.2
"""Interval between two messages about counts and settings, unless there was a request."""
MOST_WAITING = 64
"""Maximum number of waiting requests; further ones are dropped."""
PATIENCE = "patience"
LONGEST_t_ref_ms = 1_000.0


class Session:
    """One chain, one feed and any number of pages.

    run: the name that the page shows. afferents: their names; the first word of each is its population.
    sides: of the network's split, that each trial of the feed's file was on; without them no trial was seen.
    save_to: the folder for saved encoders; None: saving is off.
    waits: whether the feed starts with the first page; a device does not wait.
    on_end: called by the thread when the feed has ended or failed; `failure` and `fault` hold the reason.
    refused: messages of pages that were dropped.
    """

    def __init__(
        self,
        chain: Chain,
        feed: Feed,
        *,
        run: str,
        afferents: tuple[str, ...],
        sides: Sequence[str] = (),
        save_to: Path | None = None,
        hold_ms: float = 5.0,
        backend: Backend = "auto",
    ) -> None:
        if len(feed.taxels) != chain.n_taxels:
            raise InputError(
                f"`source={feed.name!r}`: has {number_of(len(feed.taxels), 'taxel')} but the chain has "
                f"{chain.n_taxels}; give the taxels that the network was trained on"
            )
        self.feed, self.run_name, self.afferents, self.save_to = feed, run, afferents, save_to
        self._sides, self._side = sides, UNSEEN
        self._frames = FrameBuilder(chain.sampling_rate_Hz, chain.n_taxels)
        self.stream = Stream(chain, unit=feed.unit, hold_ms=hold_ms, backend=backend, watch=self._watch)
        self._start = self._settings()
        self.scores = Scores(chain.classes, refuses=chain.rule.least_lead > 0)
        self.faults, self.audience = Faults(), Audience()
        self._afferent_spikes, self._hidden = np.zeros(chain.network.n_inputs, np.int64), 0
        self._requests: Queue[tuple[Mailbox, messages.Message]] = Queue(MOST_WAITING)
        self._label: str | None = None
        self._framed_s = self._stated_s = -np.inf
        self._has_news = True
        self.waits = feed.kind != "device"
        self.refused = 0
        self.ended = self._again = False
        self.failure: InputError | None = None
        self.fault: Exception | None = None
        self.on_end: Callable[[], None] | None = None
        self._stopped = Event()

    # --- called by the server, in any thread ------------------------------------------------------

    def ask(self, box: Mailbox, message: messages.Message) -> bool:
        """Whether a request was accepted; its answer, if any, goes to the page's mailbox."""
        try:
            self._requests.put_nowait((box, message))
        except Full:
            return False
        return True

    def refuse(self) -> None:
        """Count a dropped message of a page."""
        self.refused += 1
        self._has_news = True

    def stop(self) -> None:
        """End the thread soon."""
        self._stopped.set()

    def hello(self) -> dict[str, Any]:
        """The facts that do not change."""
        chain, feed = self.stream.chain, self.feed
        populations = populations_of(self.afferents)
        return {
            "kind": "hello",
            "run": self.run_name,
            "source": {"kind": feed.kind, "name": feed.name, "unit": feed.unit, "taxels": feed.taxels},
            "classes": chain.classes,
            **({"refuses": True} if chain.rule.least_lead > 0 else {}),
            "populations": [
                {"name": name, "key": key, "afferents": its.tolist()}
                for key, (name, its) in zip(POPULATIONS, populations.items(), strict=False)
            ],
            "afferents": self.afferents,
            "hidden": chain.network.spec.hidden,
            "integrates": chain.network.bias is not None,
            "clock_Hz": chain.clock_Hz,
            "sampling_rate_Hz": chain.sampling_rate_Hz,
            "bucket_s": self._frames.bucket_s,
            "window_steps": chain.windows.length,
            "start": self._start,
            "controls": [control._asdict() for control in feed.controls] if isinstance(feed, ByHand) else [],
            "speeds": [messages.SLOWEST, messages.FASTEST] if isinstance(feed, (ByHand, Replay)) else None,
            "save_to": None if self.save_to is None else str(self.save_to),
        }

    # --- the thread -------------------------------------------------------------------------------

    def run(self) -> None:
        """Feed the stream; after the feed has ended or failed, answer pages until `stop` is called."""
        if self.waits:
            self._serve_pages(lambda: len(self.audience) > 0)
        while not self._stopped.is_set():
            self._again = self.ended = False
            try:
                self._run_feed()
            except InputError as error:
                self.failure = error
            except Exception as error:  # raised by the thread that started this one
                self.fault = error
            self.ended = self._has_news = True
            if self.on_end is not None:
                self.on_end()
            self._serve_pages(lambda: self._again)

    def _run_feed(self) -> None:
        for arrived in self.feed.pieces(self.faults):
            self._handle_requests()
            if self._stopped.is_set():
                return
            self.take(arrived)
            self._report()

    def _serve_pages(self, is_over: Callable[[], bool]) -> None:
        """Answer pages while there is no input."""
        while not (is_over() or self._stopped.wait(TICK_S)):
            self._handle_requests()
            self._report()

    def take(self, arrived: Arrived) -> list[Scored]:
        """Push a piece into the stream, and count its decisions."""
        side = self._sides[arrived.trial] if self._sides and arrived.trial is not None else self._side
        if (self.feed.label, side) != (self._label, self._side):
            self._label, self._side = self.feed.label, side
            self.scores.label(self._label, self._n_windows(), side)
            self._mark(f"touch: {self._label or 'unknown'}")
        if arrived.samples is not None:
            tally = self.stream.tally
            self._frames.samples(arrived.samples, tally.samples + tally.missing)
        decisions = self.scores.take(self.stream.chain, sources.decide(self.stream, (arrived,)))
        if decisions:
            self._has_news = True
            rows = [scored.row() for scored in decisions]
            for box in (box for box in self.audience.each() if box.is_greeted):
                box.decisions(rows)
        return decisions

    def _watch(self, trace: Trace) -> None:
        self._afferent_spikes += trace.afferents.sum(axis=0)
        self._hidden += int(trace.hidden.sum())
        self._frames.trace(trace)

    def _n_windows(self) -> int:
        """Number of windows opened so far: all later ones use only the current settings."""
        return self.stream.state().n_windows

    def _now_s(self) -> float:
        tally = self.stream.tally
        return (tally.samples + tally.missing) / self.stream.chain.sampling_rate_Hz

    def _mark(self, what: str) -> None:
        self._frames.marks.append((self._now_s(), what))
        del self._frames.marks[:-8]

    # --- requests of pages ------------------------------------------------------------------------

    def _handle_requests(self) -> None:
        while True:
            try:
                box, message = self._requests.get_nowait()
            except Empty:
                return
            try:
                answer = self.do(message)
            except InputError as error:
                answer = {"kind": "refused", "why": str(error)}
            if answer:
                box.note(_json(answer))
            self._has_news = True

    def do(self, message: messages.Message) -> dict[str, Any] | None:
        """Handle a request between two samples. Raises InputError, whose text the page shows, if that is impossible."""
        done: dict[type, Callable[[Any], dict[str, Any] | None]] = {
            messages.Change: self._change, messages.Move: self._move, messages.Speed: self._speed,
            messages.Label: self._touch, messages.Compare: self._compare, messages.Save: self._save,
            messages.Do: self._do,
        }  # fmt: skip
        return done[type(message)](message)

    def _settings(self) -> dict[str, Any]:
        encoder = self.stream.chain.lif
        settings: dict[str, Any] = {}
        for key in POPULATIONS:
            kind = getattr(encoder, key)
            settings |= {f"{key}.t_ref_ms": kind.t_ref_ms, f"{key}.gain": kind.gain}
        return {**settings, PATIENCE: self.stream.chain.rule.patience}

    def _change(self, message: messages.Change) -> None:
        now, chain = self._settings(), self.stream.chain
        for key in message.values:
            if key not in now:
                raise InputError(f"{key}: cannot be changed while the stream runs; {nearest(key, [*now])}")
        wanted = {**now, **message.values}
        patience = wanted.pop(PATIENCE)
        for key in (key for key in wanted if key.endswith("t_ref_ms")):
            if wanted[key] is None or not 0 <= wanted[key] <= LONGEST_t_ref_ms:
                raise InputError(f"{key}: must be from 0 to {LONGEST_t_ref_ms:g} ms")
            wanted[key] = round(wanted[key] * 1e-3 * chain.clock_Hz) / chain.clock_Hz * 1e3  # whole steps
        if patience is not None and not (patience == int(patience) and 1 <= patience <= chain.windows.length):
            raise InputError(f"patience: must be a whole number of steps from 1 to {chain.windows.length}")
        encoder = build(AfferentSpec, override(chain.encoder.model_dump(mode="json"), wanted), source="live")
        rule = chain.rule
        if patience != rule.patience:
            patience = None if patience is None else int(patience)
            rule = replace(rule, patience=patience, from_first_spike=True)
        self.stream = self.stream.changed(encoder=encoder, rule=rule)
        then = self._settings()
        changes = {key: (now[key], value) for key, value in then.items() if now[key] != value}
        if changes:
            self.scores.change(changes, self._n_windows(), time.monotonic())
            self._mark("changed")

    def _move(self, message: messages.Move) -> None:
        if not isinstance(self.feed, ByHand):
            raise InputError(f"{self.feed.name}: has no finger to control; start with `source='gratings'`")
        self.feed.move(message.values)

    def _speed(self, message: messages.Speed) -> None:
        if not isinstance(self.feed, (ByHand, Replay)):
            raise InputError(f"{self.feed.name}: sets its own rate")
        self.feed.speed = message.speed

    def _touch(self, message: messages.Label) -> None:
        if self.feed.kind != "device":
            raise InputError(f"{self.feed.name}: sets the touched class itself")
        if message.label is not None and message.label not in self.scores.classes:
            raise InputError(f"label: '{message.label[:40]}' is not a class of the network")
        self.feed.label = message.label

    def _compare(self, message: messages.Compare) -> None:
        self.scores.compared = message.windows

    def _do(self, message: messages.Do) -> None:
        if message.kind == "again":
            self._again = isinstance(self.feed, Replay) and self.ended
            return
        self.scores.clear()
        self._afferent_spikes[:], self._hidden = 0, 0
        for box in self.audience.each():
            box.note(_json({"kind": "cleared"}))

    def _save(self, message: messages.Save) -> dict[str, Any]:
        if self.save_to is None:
            raise InputError("saving is off; give a folder with `save_to`")
        path = self.save_to / f"{message.name}.toml"
        if os.path.lexists(path):
            raise InputError(f"{path}: already exists; choose another name")
        chain, patience = self.stream.chain, self.stream.chain.rule.patience
        stop = (
            "none: full windows" if patience is None else f"{patience} steps ({1e3 * patience / chain.clock_Hz:g} ms)"
        )
        comment = f"# Set by hand in neurotact live on {json.dumps(self.run_name)}; patience of the exit: {stop}.\n"
        write_text(path, comment + to_toml(chain.encoder.model_dump(mode="json", exclude_none=True)))
        return {"kind": "saved", "path": str(path)}

    # --- messages to the pages --------------------------------------------------------------------

    def _report(self) -> None:
        now_s = time.monotonic()
        boxes = self.audience.each()
        if not boxes:
            self._frames.clear()
            return
        for box in (box for box in boxes if not box.is_greeted):
            box.is_greeted = self._has_news = True
            box.note(_json(self.hello()))
            box.decisions([scored.row() for scored in self.scores.recent])
        if now_s - self._framed_s >= FRAME_S:
            self._framed_s = now_s
            frame = self._frames.frame({"now_s": self._now_s(), "race": self._race(), **self._counted()})
            for box in boxes:
                box.frame(frame)
        if self._has_news and (now_s - self._stated_s >= STATE_S):
            self._stated_s, self._has_news = now_s, False
            state = _json(self.state())
            for box in boxes:
                box.state(state)

    def _counted(self) -> dict[str, Any]:
        sums = self.scores.sums
        spikes = [int(self._afferent_spikes[its].sum()) for its in populations_of(self.afferents).values()]
        totals = {"spikes": spikes, "hidden": self._hidden, "sops": sums["sops"], "ms": sums["ms"]}
        return {"totals": {**totals, "nJ": counted(sums["nJ"]), "decisions": sums["decisions"]}}

    def _race(self) -> dict[str, Any] | None:
        """The outputs of the classes in the oldest open window."""
        state, clock_Hz = self.stream.state(), self.stream.chain.clock_Hz
        if not state.windows:
            return None
        window = state.windows[0]
        leader, n = window.leader, self.stream.chain.network.steps_per_bin
        return {
            "window": window.window, "steps": window.steps, "counts": leader.counts[0].tolist(),
            "leader": int(leader.index[0]), "standing": int(leader.standing_since_spike[0]) * n,
            "heard": bool(leader.heard[0]), "begin_s": self._now_s() - window.steps / clock_Hz,
        }  # fmt: skip

    def state(self) -> dict[str, Any]:
        """Counts and settings."""
        feed, sums = self.feed, self.scores.sums
        return {
            "kind": "state",
            "settings": self._settings(),
            "compared": self.scores.comparison(),
            "confusion": self.scores.confusion.tolist(),
            "labelled": sums["labelled"],
            "right": sums["right"],
            "sides": self.scores.sides(),
            "label": feed.label,
            "note": feed.note,
            "side": self._side,
            "speed": feed.speed if isinstance(feed, (ByHand, Replay)) else None,
            "values": feed.values if isinstance(feed, ByHand) else None,
            "trouble": sources.trouble_of(self.stream.tally, self.faults),
            "pages": len(self.audience),
            "refused": self.refused,
            "ended": self.ended,
            "failure": None if self.failure is None else str(self.failure),
        }


def _json(table: dict[str, Any]) -> str:
    return json.dumps(table, allow_nan=False, separators=(",", ":"))
