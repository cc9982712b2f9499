"""What our estimators share with those of scikit-learn, beside their checks (`checks`), which load without it."""

from collections.abc import Collection, Mapping
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted, validate_data


class NestedSettings(BaseEstimator):
    """An estimator whose parameter `settings` changes keys of a spec, and which a search can set one by one.

    `sa1__t_ref_ms` in `set_params` is the key `sa1.t_ref_ms` of `settings`, so that a pipeline takes
    `spikeencoder__sa1__t_ref_ms`. spec_keys: the keys at the top of the spec; those in tables are checked with it.
    """

    spec_keys: ClassVar[Collection[str]] = ()
    settings: Mapping[str, Any] | None

    def set_params(self, **params: Any) -> Self:
        """Set parameters of the constructor, and keys of the spec by their names with `__` for each dot."""
        own = self.get_params(deep=False)
        nested = {
            key: value for key, value in params.items() if key not in own and key.split("__")[0] in self.spec_keys
        }
        super().set_params(**{key: value for key, value in params.items() if key not in nested})
        if nested:
            changes = {key.replace("__", "."): value for key, value in nested.items()}
            self.settings = {**(self.settings or {}), **changes}
        return self


def training_examples(estimator: BaseEstimator, X: ArrayLike, y: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """X `(example, feature)` float64 and y `(example,)`, checked; the estimator records the features."""
    features, labels = validate_data(estimator, X, y, dtype=np.float64)
    return np.asarray(features), np.asarray(labels)


def further_examples(estimator: BaseEstimator, X: ArrayLike) -> np.ndarray:
    """X `(example, feature)` float64 for a fitted estimator, checked against the features it was fitted with."""
    check_is_fitted(estimator)
    return np.asarray(validate_data(estimator, X, dtype=np.float64, reset=False))
