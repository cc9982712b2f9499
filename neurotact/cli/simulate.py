"""The commands that simulate an experiment: one for each simulator that is found by name."""

from typing import Any

from neurotact import files, plugins, spec
from neurotact.cli.lazy import command_of, lazy_group, new_app
from neurotact.cli.options import Force, OutFile, SetOption
from neurotact.data import hdf5
from neurotact.data.sources import simulator
from neurotact.progress import counting, track


def _command(name: str) -> Any:
    experiment = simulator(name)

    def command(out: OutFile, set_: SetOption = None, force: Force = False) -> None:
        files.check_new(out, force=force)
        what: Any = experiment.build(spec.parse_assignments(set_ or []), f"simulate {name}")
        with track("simulate", what.n_trials) as advance:
            recordings = experiment.simulate(what, counting(advance))
        hdf5.save_recordings(recordings, out)
        print(f"{out}: {recordings.summary()}")

    command.__doc__ = experiment.about
    return command_of(command)


def _helps() -> dict[str, Any]:
    return {name: lambda name=name: simulator(name).about for name in plugins.names("simulators")}


app = new_app("Simulate an experiment.")
app.info.cls = lazy_group(_helps, _command)


@app.callback()
def _simulate() -> None:
    """Simulate an experiment."""
