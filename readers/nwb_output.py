"""Spike trains as a file of Neurodata Without Borders (NWB 2): units are afferents, rows of its table trials."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from neurotact_parts.readers.nwb import AFFERENT, KEPT, OURS

from neurotact import files
from neurotact.data.digests import DIGEST, TOUCH, spike_digests
from neurotact.data.hdf5_output import create
from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError, optional
from neurotact.spec import digest

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
"""The start of a session of unknown date: NWB needs one."""


def to_nwb(
    spikes: SpikeTrains, path: str | Path, *, session_start: datetime = EPOCH, about: str = "", force: bool = False
) -> None:
    """Write spike trains to an NWB file; `neurotact import nwb` reads them back equal.

    The trials follow one another without a gap, from 0 s on; a spike is written at the beginning of its step. Units
    have the afferents' names, trials the conditions; clock, encoder and source are in the notes as JSON.

    session_start: with a time zone. about: the description of the session. force: replace an existing file.
    Raises InputError where pynwb is not installed, for no trials, and for conditions with names that NWB reserves.

    >>> import pandas as pd, tempfile
    >>> from neurotact.data.spikes import from_rasters
    >>> raster = np.zeros((1, 4, 2), np.uint8)
    >>> raster[0, 1, 0] = raster[0, 3, 1] = 1
    >>> trains = from_rasters(raster, 2000.0, ("SA-I taxel1", "RA-I taxel1"), pd.DataFrame({"label": ["felt"]}))
    >>> path = Path(tempfile.mkdtemp()) / "felt.nwb"
    >>> to_nwb(trains, path)
    >>> back = nt.read_nwb(path)
    >>> back.afferents, back.steps[0].tolist()
    (('SA-I taxel1', 'RA-I taxel1'), [1, 3])
    """
    files.check_new(path, force=force)
    pynwb = optional("pynwb", "nwb: cannot be written ({}); pip install 'neurotact[neuro]'")
    _check(spikes)
    if session_start.tzinfo is None:
        raise InputError("session_start: has no time zone; give one, as in datetime(2026, 1, 1, tzinfo=UTC)")
    made = pynwb.NWBFile(
        session_description=about or f"{len(spikes)} trials of tactile afferents",
        identifier=digest([*spike_digests(spikes), _notes(spikes)]),
        session_start_time=session_start,
        notes=json.dumps({OURS: _notes(spikes)}),
    )
    _add_trials(made, spikes)
    _add_units(made, spikes, pynwb)
    with files.whole(path) as draft, create(draft) as (file, _), pynwb.NWBHDF5IO(file=file, mode="w") as nwb:
        nwb.write(made)


def _notes(spikes: SpikeTrains) -> dict[str, Any]:
    known = {} if spikes.recorded_Hz is None else {"recorded_Hz": spikes.recorded_Hz}
    return {
        "sampling_rate_Hz": spikes.sampling_rate_Hz, "encoder": dict(spikes.encoder), "source": spikes.source, **known
    }  # fmt: skip


def _add_trials(made: Any, spikes: SpikeTrains) -> None:
    ends = np.cumsum(spikes.trial_steps)
    start_s, stop_s = ((ends - n) / spikes.sampling_rate_Hz for n in (spikes.trial_steps, 0))
    for start, stop in zip(start_s.tolist(), stop_s.tolist(), strict=True):
        made.add_trial(start_time=start, stop_time=stop)
    for name in spikes.conditions.columns:
        what = "class of the trial" if name == LABEL else "condition of the trial"
        made.add_trial_column(name=str(name), description=what, data=spikes.conditions[name].tolist())
    if spikes.trial_digests:
        made.add_trial_column(name=DIGEST, description="digest of what was recorded", data=list(spikes.trial_digests))
    if spikes.trial_touches:
        made.add_trial_column(
            name=TOUCH, description="name of its touch, and of all copies", data=list(spikes.trial_touches)
        )


def _add_units(made: Any, spikes: SpikeTrains, pynwb: Any) -> None:
    before = np.cumsum(spikes.trial_steps) - spikes.trial_steps
    steps = np.concatenate([np.asarray(trial, np.int64) + n for trial, n in zip(spikes.steps, before, strict=True)])
    units = np.concatenate([np.asarray(trial, np.int64) for trial in spikes.units])
    order = np.argsort(units, kind="stable")
    ends = np.searchsorted(units[order], np.arange(1, len(spikes.afferents)))
    made.units = pynwb.misc.Units(
        name="units", description="tactile afferents", resolution=1 / spikes.sampling_rate_Hz
    )  # fmt: skip
    made.add_unit_column(name=AFFERENT, description="type of the afferent and its taxel")
    for name, own in zip(spikes.afferents, np.split(steps[order], ends), strict=True):
        made.add_unit(spike_times=own / spikes.sampling_rate_Hz, **{AFFERENT: name})


def _check(spikes: SpikeTrains) -> None:
    if not len(spikes) or not len(spikes.afferents) or not (spikes.trial_steps > 0).all():
        raise InputError("spikes: hold no trials, or an empty one, which NWB cannot store; drop it")
    for name in map(str, spikes.conditions.columns):
        if name in KEPT or "/" in name or ":" in name:
            raise InputError(f"conditions: '{name}' cannot be a column of NWB's trials; rename it")
