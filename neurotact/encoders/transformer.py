"""An encoder as a scikit-learn transformer: taxel signals in, spikes out."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import TransformerMixin
from sklearn.utils.validation import check_is_fitted

from neurotact.checks import check_last_axis, class_labels, sequences, warn_of_swapped
from neurotact.data.recordings import Recordings, check_sampling_rate
from neurotact.data.windowed import Origin, SpikeArray
from neurotact.encoders import calibration, specs
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.model import EncoderSpec, usable
from neurotact.errors import InputError
from neurotact.estimators import NestedSettings
from neurotact.spec import checked_settings, leaves

AXES = "trial, time, taxel"


class SpikeEncoder(TransformerMixin, NestedSettings):
    """SA-I and RA-I afferents before a classifier: `make_pipeline(SpikeEncoder(...), SpikingClassifier())`.

    Parameters
    ----------
    encoder : name or path of an encoder spec (`encoders/*.toml`), or a spec, such as `nt.calibrate` returns.
    settings : keys of that spec, dotted, as in `{"sa1.t_ref_ms": 5}`. In `set_params` and in grids, `sa1__t_ref_ms` is
        one of them, which a pipeline calls `spikeencoder__sa1__t_ref_ms`.
    sampling_rate_Hz : of the signals, samples per second; required, since plain arrays have no clock.
    unit : of the signals; that of the encoder spec when None.
    calibrate : whether `fit` chooses scales and gains from the trials that it is given, as `nt.calibrate` does, so that
        in cross-validation they never see a test fold. None: where classes are given and the encoder is a shipped one
        of LIF afferents, whose gains are those of another sensor; a file or a spec of your own keeps its gains, and so
        do `settings` that name one of `sa1.gain`, `ra1.gain`, `conditioning.offset` and `conditioning.scale`.

    Attributes
    ----------
    n_features_in_, the number of taxels; spec_, the encoder spec; calibration_, how its gains were chosen, or None.

    The whole of each trial is encoded. Warns if there are more taxels than samples. Raises InputError for signals that
    are not finite `(trial, time, taxel)` arrays, for a spec that does not fit them, and as `nt.calibrate` does.

    >>> spikes = SpikeEncoder(sampling_rate_Hz=2000.0).fit_transform(np.full((2, 400, 8), 10.0))
    >>> spikes.shape, spikes.sampling_rate_Hz
    ((2, 400, 16), 2000.0)
    >>> SpikeEncoder(sampling_rate_Hz=2000.0).set_params(sa1__t_ref_ms=5).settings
    {'sa1.t_ref_ms': 5}
    """

    @property
    def spec_keys(self) -> Collection[str]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The keys at the top of the specs of all models."""
        return {key for model in usable().values() for key in model.spec.model_fields}

    def __init__(
        self,
        encoder: str | Path | EncoderSpec = "sa1-ra1-lif",
        settings: Mapping[str, Any] | None = None,
        *,
        sampling_rate_Hz: float | None = None,
        unit: str | None = None,
        calibrate: bool | None = None,
    ):
        self.encoder = encoder
        self.settings = settings
        self.sampling_rate_Hz = sampling_rate_Hz
        self.unit = unit
        self.calibrate = calibrate

    def fit(self, X: ArrayLike, y: ArrayLike | None = None) -> "SpikeEncoder":
        """Choose the gains for signals X `(trial, time, taxel)` of classes y `(trial,)`, or only check the spec."""
        if self.sampling_rate_Hz is None:
            raise InputError("sampling_rate_Hz: X does not say its clock; pass SpikeEncoder(sampling_rate_Hz=...)")
        check_sampling_rate(self.sampling_rate_Hz, "SpikeEncoder")
        signals = sequences(X, AXES, np.float32)
        warn_of_swapped(signals, AXES)
        spec = specs.resolve(self.encoder, self.settings)
        self.calibration_: calibration.Calibration | None = None
        if self._calibrates(spec, y):
            self.calibration_ = self._calibration(signals, spec, y)
            spec = self.calibration_.encoder
        self.spec_: EncoderSpec = spec
        self.n_features_in_ = signals.shape[2]
        return self

    def transform(self, X: ArrayLike) -> SpikeArray:
        """Spikes `(trial, time, afferent)` uint8 of signals `(trial, time, taxel)`."""
        check_is_fitted(self)
        signals = sequences(X, AXES, np.float32)
        check_last_axis(signals, self.n_features_in_, AXES)
        trains = encode_recordings(self._recordings(signals, ["unknown"] * len(signals)), self.spec_)
        raster = np.zeros((len(trains), int(trains.trial_steps[0]), len(trains.afferents)), np.uint8)
        for trial, (steps, units) in enumerate(zip(trains.steps, trains.units, strict=True)):
            raster[trial, steps, units] = 1
        origin = Origin(trains.encoder, trains.afferents, recorded_Hz=trains.recorded_Hz)
        return SpikeArray.of(raster, trains.sampling_rate_Hz, origin)

    def _calibrates(self, spec: EncoderSpec, y: ArrayLike | None) -> bool:
        """Whether `fit` chooses the gains."""
        is_shipped = isinstance(self.encoder, str) and not self.encoder.endswith(".toml") and "/" not in self.encoder
        has_gains = not {*leaves(checked_settings(self.settings))}.isdisjoint(specs.FITTED)
        if self.calibrate is None:
            return y is not None and is_shipped and isinstance(spec, AfferentSpec) and not has_gains
        if not self.calibrate:
            return False
        if y is None:
            raise InputError("y: gains are chosen by how well they separate classes; give the class of each trial")
        if not isinstance(spec, AfferentSpec):
            raise InputError(f"calibrate: has no effect on model = '{spec.model}', whose gains are set by hand")
        return True

    def _calibration(self, signals: np.ndarray, spec: EncoderSpec, y: ArrayLike | None) -> calibration.Calibration:
        assert isinstance(spec, AfferentSpec)
        assert y is not None
        fit, _ = calibration.calibration_for(spec, leaves(checked_settings(self.settings)))
        labels = class_labels(y, len(signals)).astype(str)
        self.n_features_in_ = signals.shape[2]
        recordings = self._recordings(signals, labels.tolist(), spec.unit)
        given = specs.set_keys(self.encoder, checked_settings(self.settings))
        start, notes = calibration.with_integration(spec, given, recordings.sampling_rate_Hz)
        found = fit(recordings, start, tell=False)
        return replace(found, notes=(*notes, *found.notes))

    def _recordings(self, signals: np.ndarray, labels: list[str], unit: str | None = None) -> Recordings:
        rate_Hz: Any = self.sampling_rate_Hz
        conditions = pd.DataFrame({"label": labels})
        return Recordings(signals, rate_Hz, self.unit or unit or self.spec_.unit, conditions, source="X")
