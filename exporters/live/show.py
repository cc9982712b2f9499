"""A running chain on a local page."""

import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from neurotact_parts.exporters.live.messages import FASTEST, SLOWEST
from neurotact_parts.streams.streamed import SampleSpec, StreamedSpec

from neurotact import effects, plugins
from neurotact.data import hdf5
from neurotact.data.dataset import simulator
from neurotact.data.digests import recorded_digest
from neurotact.data.recordings import default_channels
from neurotact.encoders.specs import afferent_names
from neurotact.errors import InputError, number_of
from neurotact.lazily import lazily
from neurotact.metrics.synops import SIDES, UNKNOWN
from neurotact.progress import Tell
from neurotact.spec import checked_settings, takes_specs

with lazily():
    from neurotact_parts.exporters.live import feeds
    from neurotact_parts.exporters.live import session as sessions
    from neurotact_parts.streams import chain as chains
    from neurotact_parts.streams import sources

    from neurotact.networks.use import fitted


log = logging.getLogger("neurotact")


@takes_specs
def live(
    run: "fitted.Fitted",
    source: str | Path,
    *,
    speed: float | None = None,
    loop: bool = False,
    shuffle: bool = False,
    settings: Mapping[str, Any] | None = None,
    save_to: str | Path | None = None,
    port: int = 0,
    samples: SampleSpec = SampleSpec(),
    streamed: StreamedSpec = StreamedSpec(),
    show: Tell = print,
) -> str:
    """Show a running chain on a local page with sliders, as `neurotact live` does, until Ctrl-C.

    run: a run folder that `train` wrote, or a fitted `SpikingClassifier` or a pipeline that ends in one.
    source: FILE.h5, "-" (standard input), a device file, "serial:/dev/ttyUSB0", "udp:PORT", "lsl:NAME", FILE.csv, or
        a simulated finger, "gratings", that the page moves; settings: changes of its spec.
    speed: of a replay or of the finger, 1 if None. loop: repeat recordings from the start.
    shuffle: replay their trials in a random order; files often hold one class after the other.
    save_to: folder for encoders that the page saves. port: of the page; 0 chooses a free one.
    samples, streamed: as for `stream`.
    show: called with the address of the page, which only this machine can open.
    Returns what became of the samples, in words. Raises InputError for a source that cannot be read, for a chain that
    cannot run sample by sample, and without the packages of `neurotact[live]`.

    >>> nt.live("run", "gratings")  # doctest: +SKIP
    http://127.0.0.1:40321/...  (press Ctrl-C to stop)
    """
    if fitted.restore(run).of_classes("the live page").encoder == {}:
        raise InputError(
            f"{fitted.name_of(run)}: takes the events of a sensor, of which the page has no view; use neurotact stream"
        )
    server = _server_module()
    source, feed = str(source), None
    kind = "simulation" if plugins.has("simulators", source) else sources.kind_of(source)
    given = {**samples.given(), **streamed.given()}
    effects.check(source=kind, speed=speed, loop=loop, shuffle=shuffle, settings=settings, **given)
    feed = _feed_at_its_rate(kind, source, 1.0 if speed is None else speed, loop, shuffle, settings)
    if feed is not None:
        streamed = streamed.model_copy(update={"sampling_rate_Hz": feed.sampling_rate_Hz})
    chain = chains.chain_of(run, streamed)
    if feed is None:
        taxels = chain.taxels or default_channels(chain.n_taxels)
        feed = feeds.Device(source, samples, taxels, chain.sampling_rate_Hz, chain.encoder.unit)
    if isinstance(feed, feeds.Replay):
        feed.give_in_order(chain.taxels)
    feed.unit = samples.unit or feed.unit
    sides = sides_of(run, feed) if isinstance(feed, feeds.Replay) else []
    session = sessions.Session(
        chain, feed, run=fitted.name_of(run), afferents=_afferents(run, chain, feed), sides=sides,
        save_to=None if save_to is None else Path(save_to), hold_ms=samples.hold_ms,
    )  # fmt: skip
    served = server.Server(session, port)
    session.on_end = lambda: _ended(session, served.stop)
    with suppress(KeyboardInterrupt):  # Ctrl-C is the normal way to end, once the address is printed
        show(f"{served.address}  (press Ctrl-C to stop)")
        served.run()
    if session.failure is not None and not session.stream.tally.samples:
        raise session.failure
    tally = session.stream.tally
    trouble = sources.trouble_of(tally, session.faults)
    told = f"{number_of(tally.samples, 'sample')}, {number_of(tally.decisions, 'decision')}"
    return f"{told}; {trouble or 'every sample was used unchanged'}"


def _feed_at_its_rate(
    kind: str, source: str, speed: float, loop: bool, shuffle: bool, settings: Mapping[str, Any] | None
) -> Any:
    """Recordings or a simulated finger; None for a device, whose rate is that of the chain."""
    if not SLOWEST <= speed <= FASTEST:
        raise InputError(f"`speed={speed!r}`: must be from {SLOWEST:g} to {FASTEST:g}")
    if kind == "recordings":
        return feeds.Replay(source, speed, loops=loop, shuffled=shuffle)
    if kind == "simulation":
        return feeds.ByHand(source, simulator(source), checked_settings(settings), speed)
    return None


def _ended(session: "sessions.Session", stop: Callable[[], None]) -> None:
    """Raise if nothing could be read, or the thread failed: there is nothing to show."""
    if session.fault is not None or (session.failure is not None and not session.stream.tally.samples):
        stop()
    elif session.failure is not None:
        log.warning("%s", session.failure)


def sides_of(run: "fitted.Fitted", feed: "feeds.Replay") -> list[str]:
    """The side of the network's split that each trial was on, as for `neurotact infer`; logs how many on each."""
    known = fitted.restore(run).provenance
    with hdf5.open_recordings(feed.name) as stored:
        sides = [UNKNOWN] * len(stored)
        if known is not None and known.trials.training.recorded:
            stored = stored.in_order(feed.taxels)
            digests = (recorded_digest(stored, trial) for trial in range(len(stored)))
            sides = known.sides_of_recorded(digests).tolist()
    counts = ", ".join(f"{sides.count(side)} {side}" for side in SIDES if side in sides)
    log.warning("%s: %s trials of the network; the page shows the accuracy of each apart", feed.name, counts)
    return sides


def _afferents(run: "fitted.Fitted", chain: "chains.Chain", feed: "feeds.Feed") -> tuple[str, ...]:
    """The taxel names from the network's training, or those of the source."""
    provenance = fitted.restore(run).provenance
    known = None if provenance is None else provenance.afferents
    if known and len(known) == chain.network.n_inputs:
        return known
    return afferent_names(feed.taxels, chain.encoder.model_dump())


def _server_module():
    try:
        from neurotact_parts.exporters.live import server
    except ImportError as error:
        missing = error.name or "a package"
        if missing.startswith("neurotact"):
            raise
        raise InputError(f"live: needs {missing}; pip install 'neurotact[live]'") from error
    return server
