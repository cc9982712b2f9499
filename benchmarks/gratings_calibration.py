"""The simulated gratings compared with the signals and spikes of the texture paper.

    python benchmarks/gratings_calibration.py [-o DIR] [--trials N] [--set KEY=VALUE]

Simulates the published experiment, prints every calibration fact with its target and the simulated value, and with
`-o` writes the facts as a table and draws figures for comparison with the paper's Figs. 5, 6, 10 and 12. `--set`
tries another value of a parameter. Those of `GratingsSpec` were chosen only by these facts; no classifier is trained.
"""

import argparse
import sys
from pathlib import Path

from gratings_calibration_figures import draw_all
from gratings_facts import count_facts, measure, noise_facts, rate_facts, signal_facts, start_facts
from neurotact_parts.studies.texture.simulator import GratingsSpec, simulate
from signal_facts import keep, print_facts

from neurotact.data.recordings import Recordings
from neurotact.encoders.afferents import AfferentSpec
from neurotact.errors import InputError
from neurotact.progress import tracked
from neurotact.spec import build, load, parse_assignments
from neurotact.tables import write_table


def main(arguments: list[str] | None = None) -> int:
    """Print every fact with its target, and whether it holds."""
    parser = argparse.ArgumentParser(prog="python benchmarks/gratings_calibration.py", description=__doc__)
    parser.add_argument("-o", "--out", type=Path, help="folder for facts.csv and the figures")
    parser.add_argument("--trials", type=int, default=20, help="for each grating, force and speed (default 20)")
    parser.add_argument("--encoder", default="sa1-ra1-lif", help="name or path of an encoder")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of the simulation")
    given = parser.parse_args(arguments)
    try:
        spec = build(GratingsSpec, {"trials": given.trials} | parse_assignments(given.set), "--set")
        encoder = load(AfferentSpec, given.encoder)
    except InputError as error:
        parser.error(str(error))
    recordings = _simulated(spec)
    measured = measure(recordings, encoder)
    facts = [
        *noise_facts(spec.noise_mV_rms),
        *signal_facts(measured.signals),
        *start_facts(spec, encoder),
        *count_facts(measured.firing),
        *rate_facts(measured.firing),
    ]
    print_facts(facts)
    if given.out is not None:
        keep(facts, given.out)
        write_table(measured.signals, given.out / "signals.csv")
        write_table(measured.firing, given.out / "firing.csv")
        draw_all(recordings, measured.firing, encoder, given.out)
    return 0


def _simulated(spec: GratingsSpec) -> Recordings:
    with tracked("simulate") as progress:
        return simulate(spec, progress)


if __name__ == "__main__":
    sys.exit(main())
