"""The claims of the texture paper from finished runs: at the repeated start, in the mean over starts, at random starts.

    python benchmarks/texture_claims.py --at RUN... --over RUN... [--before CLAIMS.csv] > docs/data/texture-claims.csv

--at: run folders of the studies at the default start. --over: runs of the same studies that sweep `start_mm`, and of
start-position; the first one that holds a measure is averaged over starts and seeds before a rule is applied.
--before: an earlier table, whose column of random starts is copied, and each other column with its verdict
where no run here has one. Claims and rules are those of `studies/*.toml` today, found by a run's title.
A claim that both kinds of run hold is judged by the mean over starts; one on signals, spikes or costs alone does not
hang on the start. Whether it would hold without the effect is judged in the rows of the mean over starts, or of the
default start where those are too few or not here.
"""

import argparse
import csv
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from neurotact_parts.studies.verdicts import BASELINES, State, Verdict, judge

from neurotact.report.tables import with_pair
from neurotact.studies.claims import Claim
from neurotact.studies.encoding_tables import read_encoding
from neurotact.studies.study import resolve
from neurotact.tables import read_table

STUDIES = Path(__file__).parents[1] / "studies"
ORDER = (
    "refractory-period", "early-exit", "minimal-duration", "sensing-conditions", "unknown-conditions",
    "network-selection", "scaling-coefficients", "texture-baselines",
)  # fmt: skip
TABLES = (
    "results",
    "encoding",
    "selection",
    "cut_short",
    "exit_curve",
    "conditions",
    "signals",
    "same_drive",
    BASELINES,
)
START = "start_mm"
NAMES = frozenset({
    "dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", "pair", "label", "force_N", "speed_mm_per_s", "mode", "patience",
    "cut_ms", "known", "drive", "t_ref_ms", "gain_sa", "gain_ra", "encoder", "features", "classifier", "decision",
    "window_ms", "step",
})  # fmt: skip
"""Columns that name a row; so do swept keys, which hold a point."""
SAME_NETWORKS = {"start-position": "refractory-period"}
"""Studies that sweep starts, and the study whose networks they train."""
UNTRIED = "holds; not tried without the effect"
STARTLESS_TABLES = ("encoding", "signals", "same_drive", BASELINES)
STARTLESS = ("flops", "bytes", "isi_", "spikes_", "silent_", "latency_", "sops_input")
"""Measures of signals, of spikes over a second and of costs: a start moves them by little, and none is an accuracy."""
HEADS = ("study", "claim", "source", "published", "repeated start", "mean over starts", "random start", "verdict")


class Run(NamedTuple):
    study: str
    tables: dict[str, pd.DataFrame]


def read(folder: Path) -> Run:
    """A run folder's tables, under the name of its study."""
    title = tomllib.loads((folder / "study.toml").read_text())["title"]
    specs = {path.stem: tomllib.loads(path.read_text()) for path in sorted(STUDIES.rglob("*.toml"))}
    (name,) = (name for name, spec in specs.items() if spec["title"] == title)
    spec = resolve(name) if "protocol" not in specs[name] else None
    tables = {}
    for table in TABLES:
        path = folder / f"{table}.csv"
        if path.is_file():
            found = read_encoding(path) if table == "encoding" else read_table(path)
            tables[table] = with_pair(found, spec) if spec and "t_ref_ra_ms" in found and table != BASELINES else found
    if "encoder.sa1.gain" in tables["results"]:
        gains = {"gain_sa": "encoder.sa1.gain", "gain_ra": "encoder.ra1.gain"}
        tables["results"] = tables["results"].assign(**{new: tables["results"][old] for new, old in gains.items()})
    return Run(name, tables)


def claims_of(study: str) -> list[Claim]:
    (path,) = STUDIES.rglob(f"{study}.toml")
    return [Claim(**claim) for claim in tomllib.loads(path.read_text()).get("claims", [])]


def averaged(table: pd.DataFrame) -> pd.DataFrame:
    """Means over repeated starts and seeds, a row for each of what else names a row.

    >>> rows = pd.DataFrame({"pair": "1&1", "dataset.parameters.start_mm": [4.41, 9.41], "seed": 0, "x": [1.0, 3.0]})
    >>> averaged(rows).to_dict("records")
    [{'pair': '1&1', 'x': 2.0}]
    """
    starts = [column for column in table if column.rpartition(".")[2] in ("start", START)]
    for kind in (column for column in starts if column.endswith("start")):
        table = table[table[kind] == "repeated"]
    names = [c for c in table if (c in NAMES or "." in c) and c not in starts]
    numbers = table.select_dtypes("number").columns.difference([*names, *starts, "seed"], sort=False)
    return table.groupby(names, sort=False, dropna=False)[list(numbers)].mean().reset_index()


def rows_of(earlier: Path | None) -> dict[tuple[str, str], dict[str, str]]:
    """The rows of an earlier table, by study and claim."""
    lines = earlier.read_text().splitlines() if earlier else []
    return {(row["study"], row["claim"]): row for row in csv.DictReader(lines)}


def verdict(at: Verdict | None, over: Verdict | None) -> str:
    """By the mean over starts where it was run."""
    for found, alone in ((over, ""), (at, " at this start alone")):
        if found is not None and found.state is not State.MISSING:
            hangs = found.claim.table not in STARTLESS_TABLES and not found.claim.measure.startswith(STARTLESS)
            told = at if found.state is State.FEW and at is not None and at.holds else found
            return told.told + (alone if hangs and told.state in (State.REPRODUCED, State.FAILS) else "")
    return "not run"


def verdict_of(earlier: dict[str, str], at: Verdict | None) -> str:
    """Of a mean over starts on an earlier page, whose rows are not here."""
    if not earlier["verdict"].startswith(("yes", "holds")):
        return earlier["verdict"]
    return at.told if at is not None and at.holds else UNTRIED


def serves(run: Run, study: str, claim: Claim) -> bool:
    """Whether a run over starts can judge a claim; one of another study by its networks alone: it encodes two pairs."""
    return run.study == study or (claim.table == "results" and SAME_NETWORKS.get(run.study) == study)


def rows(at: list[Run], over: list[Run], before: dict[tuple[str, str], dict[str, str]]) -> Iterator[tuple[str, ...]]:
    over = [run._replace(tables={name: averaged(table) for name, table in run.tables.items()}) for run in over]
    for study in ORDER:
        here = next((run for run in at if run.study == study), None)
        for claim in claims_of(study):
            one = judge(claim, here.tables) if here else None
            there = [run for run in over if serves(run, study, claim)]
            means = [judge(claim, run.tables) for run in there]
            mean = next((found for found in means if found.reproduced is not None), None)
            earlier = before.get((study, claim.name), {})
            if here is None and mean is None and not earlier:
                continue
            ours = ["-" if found is None or found.reproduced is None else found.ours for found in (one, mean)]
            judged = verdict(one, mean)
            if here is None:
                ours[0] = earlier.get("repeated start", "-")
            if mean is None and (here is None or earlier.get("mean over starts", "-") != "-"):
                ours[1], judged = earlier["mean over starts"], verdict_of(earlier, one)
            shown = earlier.get("random start", "-")
            yield study, claim.name, claim.source, claim.published, *ours, shown, judged


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--at", type=Path, nargs="*", default=[])
    parser.add_argument("--over", type=Path, nargs="*", default=[])
    parser.add_argument("--before", type=Path)
    options = parser.parse_args()
    found = list(rows([*map(read, options.at)], [*map(read, options.over)], rows_of(options.before)))
    csv.writer(sys.stdout, lineterminator="\n").writerows([HEADS, *found])
    counts = Counter(row[-1].partition(",")[0] for row in found)
    print(f"{len(found)} claims: " + "; ".join(f"{n} {state}" for state, n in counts.most_common()), file=sys.stderr)


if __name__ == "__main__":
    main()
