"""The commands that simulate an experiment: one for each installed simulator."""

from collections.abc import Callable

from neurotact import files, spec
from neurotact.api import recordings as api
from neurotact.api.recordings import Simulator, simulator
from neurotact.cli.lazy import add_plugins, new_app
from neurotact.cli.options import Force, OutFile, SetOption
from neurotact.cli.output import save
from neurotact.progress import tracked

app = new_app("Simulate an experiment.")


def _command(name: str, experiment: Simulator) -> Callable[..., None]:
    def run(out: OutFile, settings: SetOption = None, force: Force = False) -> None:
        files.check_new(out, force=force)
        with tracked("simulate") as progress:
            recordings = api.simulate(name, spec.parse_assignments(settings or []), progress=progress)
        save(recordings, out)

    keys = spec.leaves(experiment.model().model_dump(mode="json"))
    lines = [
        f"{key}={spec.toml_value(value)}" if value is not None else f"{key} (not set)" for key, value in keys.items()
    ]
    run.__doc__ = "\n".join(["\b", "Keys of --set, with their defaults:", *lines])
    return run


add_plugins(app, "simulators", simulator, _command)
