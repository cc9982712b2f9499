"""An encoder as a scikit-learn transformer: taxel signals in, spikes out."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from neurotact.checks import sequences
from neurotact.data.recordings import Recordings, check_sampling_rate
from neurotact.data.windowed import SpikeArray
from neurotact.encoders import specs
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.specs import EncoderSpec
from neurotact.errors import InputError


class SpikeEncoder(TransformerMixin, BaseEstimator):
    """SA-I and RA-I afferents before a classifier: `make_pipeline(SpikeEncoder(...), SpikingClassifier())`.

    Parameters
    ----------
    encoder : name or path of an encoder spec (`encoders/*.toml`), or a spec, such as `nt.calibrate` returns.
    settings : keys of that spec, dotted: `{"sa1.t_ref_ms": 5}`.
    sampling_rate_Hz : of the signals, samples per second; required, since plain arrays have no clock.
    unit : of the signals; that of the encoder spec when None.

    Attributes
    ----------
    n_features_in_, the number of taxels; spec_, the encoder spec.

    The whole of each trial is encoded; nothing is fitted. Raises InputError for signals that are not finite
    `(trial, time, taxel)` arrays, and for a spec that does not fit them.

    >>> spikes = SpikeEncoder(sampling_rate_Hz=2000.0).fit_transform(np.full((2, 400, 8), 10.0))
    >>> spikes.shape, spikes.sampling_rate_Hz
    ((2, 400, 16), 2000.0)
    """

    def __init__(
        self,
        encoder: str | Path | EncoderSpec = "sa1-ra1-lif",
        settings: Mapping[str, Any] | None = None,
        *,
        sampling_rate_Hz: float | None = None,
        unit: str | None = None,
    ):
        self.encoder = encoder
        self.settings = settings
        self.sampling_rate_Hz = sampling_rate_Hz
        self.unit = unit

    def fit(self, X: ArrayLike, y: ArrayLike | None = None) -> "SpikeEncoder":
        """Check the spec against signals X `(trial, time, taxel)`; y is ignored."""
        if self.sampling_rate_Hz is None:
            raise InputError("sampling_rate_Hz: X does not say its clock; pass SpikeEncoder(sampling_rate_Hz=...)")
        check_sampling_rate(self.sampling_rate_Hz, "SpikeEncoder")
        signals = sequences(X, "trial, time, taxel", np.float32)
        self.spec_ = specs.resolve(self.encoder, self.settings)
        self.n_features_in_ = signals.shape[2]
        return self

    def transform(self, X: ArrayLike) -> SpikeArray:
        """Spikes `(trial, time, afferent)` uint8 of signals `(trial, time, taxel)`."""
        check_is_fitted(self)
        signals = sequences(X, "trial, time, taxel", np.float32)
        if signals.shape[2] != self.n_features_in_:
            raise InputError(f"X: has {signals.shape[2]} taxels, but training had {self.n_features_in_}; give those")
        nameless = pd.DataFrame({"label": ["unknown"] * len(signals)})
        rate_Hz: Any = self.sampling_rate_Hz
        recordings = Recordings(signals, rate_Hz, self.unit or self.spec_.unit, nameless, source="X")
        trains = encode_recordings(recordings, self.spec_)
        raster = np.zeros((len(trains), int(trains.trial_steps[0]), len(trains.afferents)), np.uint8)
        for trial, (steps, units) in enumerate(zip(trains.steps, trains.units, strict=True)):
            raster[trial, steps, units] = 1
        return SpikeArray.of(raster, trains.sampling_rate_Hz)
