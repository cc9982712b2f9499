"""The command that shows a running chain on a local page: live."""

import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from neurotact import effects, plugins, spec
from neurotact.cli.deploy import (
    Baud,
    Contact,
    Format,
    FullWindow,
    HoldMs,
    HopMs,
    Lsb,
    QuietMs,
    RateHz,
    StallS,
    StartMs,
    TimeColumn,
    Unit,
    WindowMs,
    Zero,
)
from neurotact.cli.options import RunFolder, SetOption
from neurotact.cli.words import say
from neurotact.data import hdf5
from neurotact.data.digests import recorded_digest
from neurotact.data.recordings import default_channels
from neurotact.data.sources import simulator
from neurotact.deploy.chain import Chain, chain_of
from neurotact.deploy.sources import DEFAULT_BAUD, STALL_S, Layout, kind_of, trouble_of
from neurotact.encoders.specs import afferent_names
from neurotact.errors import InputError
from neurotact.live.feeds import ByHand, Device, Feed, Replay
from neurotact.live.messages import FASTEST, SLOWEST
from neurotact.live.session import Session
from neurotact.metrics.synops import SIDES, UNKNOWN
from neurotact.networks.training import trained

MOST_PORTS = 65_535


def live(
    run: RunFolder,
    source: Annotated[
        str,
        typer.Option(
            "--from", help="FILE.h5, - (standard input), a device file, serial:/dev/ttyUSB0, FILE.csv, or gratings."
        ),
    ],
    speed: Annotated[
        float | None,
        typer.Option(
            min=SLOWEST,
            max=FASTEST,
            show_default="1",
            help="Speed of a replay or of the simulated finger; 1 is real time.",
        ),
    ] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Repeat recordings from the start.")] = False,
    settings: SetOption = None,
    save_to: Annotated[
        Path | None, typer.Option("--save-to", file_okay=False, help="Folder for encoders saved from the page.")
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=MOST_PORTS, help="Port of the page; 0 chooses a free one.")] = 0,
    format_: Format = None,
    baud: Baud = None,
    sampling_rate_Hz: RateHz = None,
    unit: Unit = None,
    time_column: TimeColumn = None,
    lsb: Lsb = None,
    zero: Zero = None,
    length_ms: WindowMs = None,
    start_ms: StartMs = None,
    hop_ms: HopMs = None,
    contact: Contact = False,
    quiet_ms: QuietMs = None,
    full_window: FullWindow = False,
    hold_ms: HoldMs = 5.0,
    stall_s: StallS = None,
) -> None:
    """Show a running chain on a local page with sliders: touch, spikes, decision.

    Prints the address to open in a browser on this machine, and serves the page until Ctrl-C. Recordings are replayed
    at their own rate; a device is read as its samples arrive; gratings is a simulated finger that the page moves (--set
    changes its spec). The page's sliders change refractory periods, gains and patience of the running stream.
    """
    server = _server_module()
    feed: Feed | None = None
    kind = "simulation" if source in plugins.names("simulators") else kind_of(source)
    effects.check(
        source=kind, speed=speed, loop=loop, settings=settings, format=format_, baud=baud,
        sampling_rate_Hz=sampling_rate_Hz, time_column=time_column, lsb=lsb, zero=zero, stall_s=stall_s,
    )  # fmt: skip
    speed = 1.0 if speed is None else speed
    if kind == "recordings":
        feed = Replay(source, speed, loops=loop)
    elif kind == "simulation":
        feed = ByHand(source, simulator(source), spec.parse_assignments(settings or []), speed)
    chain = chain_of(
        run, sampling_rate_Hz=feed.sampling_rate_Hz if feed else sampling_rate_Hz, early_exit=not full_window,
        length_ms=length_ms, start_ms=start_ms, hop_ms=hop_ms, contact=contact, quiet_ms=quiet_ms,
    )  # fmt: skip
    if feed is None:
        layout = Layout.of(format_, time_column, lsb, zero)
        feed = Device(
            source, layout, default_channels(chain.n_taxels), chain.sampling_rate_Hz, unit or chain.encoder.unit,
            stall_s=stall_s or STALL_S, baud=baud or DEFAULT_BAUD,
        )  # fmt: skip
    feed.unit = unit or feed.unit
    sides = _sides(run, feed) if isinstance(feed, Replay) else []
    session = Session(
        chain, feed, run=str(run), afferents=_afferents(run, chain, feed), sides=sides, save_to=save_to, hold_ms=hold_ms
    )
    served = server.Server(session, port)
    session.on_end = lambda: _ended(session, served.stop)
    with suppress(KeyboardInterrupt):  # the normal end, from the moment that the address is said
        print(f"{served.address}  (press Ctrl-C to stop)", flush=True)
        served.run()
    if session.failure is not None and not session.stream.tally.samples:
        raise session.failure
    tally = session.stream.tally
    trouble = trouble_of(tally, session.noted)
    say(f"{tally.samples} samples, {tally.decisions} decisions; {trouble or 'every sample was used unchanged'}")
    sys.exit(0)


def _ended(session: Session, stop: Callable[[], None]) -> None:
    """Raise if nothing could be read, or the thread failed: there is nothing to show."""
    if session.fault is not None or (session.failure is not None and not session.stream.tally.samples):
        stop()
    elif session.failure is not None:
        say(session.failure)


def _sides(run: Path, feed: Replay) -> list[str]:
    """The side of the network's split that each trial was on, as for `neurotact infer`; says how many on each."""
    known = trained.recall(trained.restore(run))
    with hdf5.open_recordings(feed.name) as stored:
        sides = [UNKNOWN] * len(stored)
        if known is not None and known.trials.training.recorded:
            digests = (recorded_digest(stored, trial) for trial in range(len(stored)))
            sides = known.sides_of_recorded(digests).tolist()
    counts = ", ".join(f"{sides.count(side)} {side}" for side in SIDES if side in sides)
    say(f"{feed.name}: {counts} trials of the network; the page shows the accuracy of each apart")
    return sides


def _afferents(run: Path, chain: Chain, feed: Feed) -> tuple[str, ...]:
    """The taxel names from the network's training, or those of the source."""
    provenance = trained.restore(run).provenance
    known = None if provenance is None else provenance.afferents
    if known and len(known) == chain.network.n_inputs:
        return known
    return afferent_names(feed.taxels, chain.encoder.model_dump())


def _server_module():
    try:
        from neurotact.live import server
    except ImportError as error:
        missing = error.name or "a package"
        if missing.startswith("neurotact"):
            raise
        raise InputError(f"live: needs {missing}; pip install 'neurotact[live]'") from error
    return server
