"""What of the signals of recordings survives an encoder: `nt.what_survives`, `nt.plot_survival`."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from neurotact_parts.encoders.survival.figure import draw_survival
from neurotact_parts.encoders.survival.survival import Survival, survival_of

from neurotact.data import hdf5
from neurotact.data.recordings import Trials
from neurotact.data.trial_choice import TrialChoice, chosen_trials
from neurotact.encoders import specs
from neurotact.encoders.model import EncoderSpec
from neurotact.errors import InputError


def what_survives(
    recordings: Trials | str | Path,
    encoder: str | Path | EncoderSpec = "sa1-ra1-lif",
    settings: Mapping[str, Any] | None = None,
    *,
    where: Mapping[str, Any] | None = None,
    leave_out: str | Sequence[str] | Mapping[str, Any] | None = None,
    seed: int = 0,
) -> Survival:
    """What of the signals survives an encoder: how well spikes are decoded, what they tell, how soon and at what cost.

    recordings: in memory, or the path of a file of them. encoder, settings, where, leave_out: as of `encode`.
    seed: of the trials that are drawn. The numbers are in `table`; `nt.plot_survival` draws them.
    Raises InputError for one class, and as `encode` does.

    >>> import neurotact as nt
    >>> felt = nt.simulate("gratings", trials=1, duration_s=0.6)
    >>> found = nt.what_survives(felt, "step-forward", {"threshold": 2.0})
    >>> found.table.population.tolist()
    ['ON', 'OFF', 'all']
    """
    what = specs.resolve(encoder, settings)
    if not isinstance(recordings, (str, Path)):
        _check("recordings", recordings, Trials, "nt.simulate, nt.load or nt.read_folder returns them")
    with hdf5.open_recordings(recordings) if isinstance(recordings, (str, Path)) else nullcontext(recordings) as stored:
        data = chosen_trials(stored, TrialChoice.of(where, leave_out), stored.source or "recordings")
        return survival_of(data, what, seed)


def plot_survival(found: Survival) -> Figure:
    """What `what_survives` found as a matplotlib figure: a signal and its decoding, spectra, and bits over time.

    >>> import neurotact as nt
    >>> felt = nt.simulate("gratings", trials=1, duration_s=0.6)
    >>> len(nt.plot_survival(nt.what_survives(felt, "send-on-delta")).axes)
    3
    """
    _check("found", found, Survival, "nt.what_survives returns it")
    return draw_survival(found)


def _check(name: str, value: object, wanted: type, fix: str) -> None:
    if not isinstance(value, wanted):
        raise InputError(f"{name}: must be {wanted.__name__}; got {type(value).__name__}; {fix}")
