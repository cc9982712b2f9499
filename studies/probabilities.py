"""What the networks of several papers share: the most probable class decides."""

import numpy as np
from numpy.typing import ArrayLike


class ProbabilitiesMixin:
    """What estimators share that give probabilities; a subclass has `classes_` and `predict_proba`."""

    classes_: np.ndarray

    def predict(self, X: ArrayLike) -> np.ndarray:
        """Labels `(example,)`: the most probable class, the first of equals."""
        winners = self.predict_proba(X).argmax(axis=1)
        return self.classes_[winners]

    def predict_proba(self, X: ArrayLike) -> np.ndarray:
        """Softmax of the outputs, `(example, class)`."""
        raise NotImplementedError
