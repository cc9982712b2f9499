"""Our MiniRocket beside aeon's on problems that aeon ships: the same features, and the accuracies of both.

aeon's pins exclude ours, so that it needs an environment of its own: `python -m venv E && E/bin/pip install aeon`, then
`NEUROTACT_AEON_PYTHON=E/bin/python python benchmarks/opponents.py`. The features are compared for aeon's own choice of
channels and biases. The accuracies are those of the published split of each problem, with 10,000 features.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from neurotact.baselines.minirocket import TRIPLES, Convolution, MiniRocket, MiniRocketClassifier
from neurotact.baselines.pooled_gru import PooledGRUClassifier

PROBLEMS = ("GunPoint", "ItalyPowerDemand", "ArrowHead", "OSULeaf", "BasicMotions")
SEEDS = 3
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


def main() -> None:
    python = os.environ.get("NEUROTACT_AEON_PYTHON")
    if python is None:
        sys.exit("set NEUROTACT_AEON_PYTHON to the Python of an environment with aeon")
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
                "pooled GRU (%)": 100 * gru.score((X_test - scale[0]) / scale[1], y_test),
            })  # fmt: skip
    print(pd.DataFrame(rows).round(3).to_string(index=False))


if __name__ == "__main__":
    main()
