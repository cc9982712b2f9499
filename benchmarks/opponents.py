"""Our opponents beside libraries and published values on public problems: none of them is a straw man.

On scikit-learn's handwritten digits each family, sized on validation examples as the studies do, stands beside the
library's own search: five-fold cross-validation over a finer grid. ELM has no library here; beside it stands ridge
regression on as many random features. The search learns from training and validation examples, and once more from the
training examples alone, as our families and networks do.

With aeon, our MiniRocket beside its own on problems that it ships: equal features, and the accuracies of both, beside
the published means over 30 resamples (Dempster et al. 2021, results_ucr109_mean.csv of their repository). aeon's pins
exclude ours, so that it needs an environment of its own: `python -m venv E && E/bin/pip install aeon`, then
`NEUROTACT_AEON_PYTHON=E/bin/python python benchmarks/opponents.py`. The features are compared for aeon's own choice of
channels and biases. The accuracies are those of the published split of each problem, with 10,000 features.
"""

import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from neurotact_parts.opponents.elm import ELM_HIDDEN
from neurotact_parts.opponents.minirocket import TRIPLES, Convolution, MiniRocket, MiniRocketClassifier
from neurotact_parts.opponents.pooled_gru import PooledGRUClassifier
from sklearn.base import BaseEstimator
from sklearn.datasets import load_digits
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.kernel_approximation import RBFSampler
from sklearn.linear_model import LogisticRegression, RidgeClassifier
from sklearn.model_selection import GridSearchCV, train_test_split
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from neurotact.baselines.opponent import Sides, accuracy, best_of, load

PROBLEMS = ("GunPoint", "ItalyPowerDemand", "ArrowHead", "OSULeaf", "BasicMotions")
PUBLISHED = {"GunPoint": 99.2, "ItalyPowerDemand": 96.0, "ArrowHead": 88.1, "OSULeaf": 95.8}
"""MiniRocket in %, as published."""
SEEDS = 3
LIBRARY: dict[str, tuple[BaseEstimator, dict[str, list]]] = {
    "logistic regression": (LogisticRegression(max_iter=5000), {"C": list(np.logspace(-3, 3, 13))}),
    "SVM": (SVC(), {"C": list(np.logspace(-1, 3, 9)), "gamma": list(np.logspace(-4, 0, 9))}),
    "extra trees": (
        ExtraTreesClassifier(500, random_state=0),
        {"min_samples_leaf": [1, 2, 4], "max_features": ["sqrt", 0.3, 1.0]},
    ),
    "ELM": (
        make_pipeline(RBFSampler(n_components=max(ELM_HIDDEN), random_state=0), RidgeClassifier()),
        {"rbfsampler__gamma": list(np.logspace(-4, 0, 9)), "ridgeclassifier__alpha": list(np.logspace(-4, 2, 7))},
    ),
}
"""Estimator and grid of scikit-learn beside each of our opponents."""
THEIRS = """
import sys
import numpy as np
from aeon.classification.convolution_based import MiniRocketClassifier
from aeon.datasets import load_classification
from aeon.transformations.collection.convolution_based import MiniRocket
folder, *problems = sys.argv[1:]
for name in problems:
    (X, y), (X_test, y_test) = (load_classification(name, split=side) for side in ("train", "test"))
    transform = MiniRocket(random_state=0).fit(X)
    parts = zip(("n_channels", "channels", "dilations", "per_dilation", "biases"), transform.parameters)
    scores = [MiniRocketClassifier(random_state=seed).fit(X, y).score(X_test, y_test) for seed in range(SEEDS)]
    np.savez(f"{folder}/{name}.npz", X=X, y=y.astype(str), X_test=X_test, y_test=y_test.astype(str), scores=scores,
             features=np.asarray(transform.transform(X_test)), **dict(parts))
""".replace("SEEDS", str(SEEDS))


def of_aeon(arrays: dict[str, np.ndarray]) -> MiniRocket:
    """Our transform with aeon's channels and biases."""
    _, n_channels, n_steps = arrays["X"].shape
    rocket = MiniRocket()
    rocket.n_channels_, rocket.n_steps_ = n_channels, n_steps
    channels = np.split(arrays["channels"], np.cumsum(arrays["n_channels"])[:-1])
    rocket.convolutions_, first = [], 0
    for place, (dilation, n_biases) in enumerate(zip(arrays["dilations"], arrays["per_dilation"], strict=True)):
        for kernel in range(len(TRIPLES)):
            biases = arrays["biases"][first : first + n_biases]
            own = channels[place * len(TRIPLES) + kernel] if n_channels > 1 else np.zeros(1, int)
            rocket.convolutions_.append(Convolution(int(dilation), kernel, own, biases, (place + kernel) % 2 == 0))
            first += int(n_biases)
    return rocket


def on_digits() -> pd.DataFrame:
    """Test accuracy in % of each family and of scikit-learn's search on 1,797 digits of 8 x 8 pixels."""
    pixels, digits = load_digits(return_X_y=True)
    rows = []
    for seed in range(SEEDS):
        X, X_test, y, y_test = train_test_split(pixels, digits, test_size=0.3, random_state=seed, stratify=digits)
        X, X_test = (StandardScaler().fit(X).transform(side) for side in (X, X_test))
        parts = train_test_split(X, y, test_size=0.2, random_state=seed, stratify=y)
        train, validation, y_train, y_validation = parts
        sides = Sides(train, validation, X_test, y_train, y_validation, y_test)
        for name, (estimator, grid) in LIBRARY.items():
            chosen = best_of(load(name), sides, seed)
            search = GridSearchCV(estimator, grid, cv=5).fit(X, y)
            rows.append({
                "family": name, "ours (%)": 100 * accuracy(chosen, X_test, y_test),
                "scikit-learn's search (%)": 100 * search.score(X_test, y_test),
                "without validation (%)": 100 * search.best_estimator_.fit(train, y_train).score(X_test, y_test),
            })  # fmt: skip
    return pd.DataFrame(rows).groupby("family", sort=False).mean().reset_index()


def main() -> None:
    print(on_digits().round(2).to_string(index=False))
    python = os.environ.get("NEUROTACT_AEON_PYTHON")
    if python is None:
        print("set NEUROTACT_AEON_PYTHON to the Python of an environment with aeon for the rest")
        return
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([python, "-c", THEIRS, folder, *PROBLEMS], check=True)
        for name in PROBLEMS:
            with np.load(Path(folder) / f"{name}.npz") as file:
                arrays = dict(file)
            X, X_test = (arrays[key].transpose(0, 2, 1) for key in ("X", "X_test"))
            y, y_test = arrays["y"], arrays["y_test"]
            features = of_aeon(arrays).transform(X_test)
            # A share moves by one step where the sum, in another order, crosses its bias.
            apart = np.abs(features - arrays["features"]) > 0.5 / X.shape[1]
            ours = [MiniRocketClassifier(random_state=seed).fit(X, y).score(X_test, y_test) for seed in range(SEEDS)]
            scale = X.mean(axis=(0, 1)), X.std(axis=(0, 1))
            gru = PooledGRUClassifier(random_state=0).fit((X - scale[0]) / scale[1], y)
            rows.append({
                "problem": name, "features": features.size, "unequal (%)": 100 * apart.mean(),
                "largest difference (steps)": np.abs(features - arrays["features"]).max() * X.shape[1],
                "MiniRocket (%)": 100 * np.mean(ours), "aeon's (%)": 100 * arrays["scores"].mean(),
                "published (%)": PUBLISHED.get(name),
                "pooled GRU (%)": 100 * gru.score((X_test - scale[0]) / scale[1], y_test),
            })  # fmt: skip
    print(pd.DataFrame(rows).round(3).to_string(index=False))


if __name__ == "__main__":
    main()
