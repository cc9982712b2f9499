"""`neurotact study bundle`: a finished study in one folder, as a paper and its reviewers need it."""

import hashlib
import os
import re
import shlex
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import resources
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple, get_args

import neurotact as nt
from neurotact import files
from neurotact import spec as specs
from neurotact.data.dataset import expand
from neurotact.data.fetch import SETS
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.progress import Tell, untold

with lazily():
    import pandas as pd
    from neurotact_parts.studies.publishing import methods, prints, ran, references, wide_tables

    from neurotact import checks, tables
    from neurotact.data import dataset, hdf5
    from neurotact.figures import style
    from neurotact.report import networks, page, report, ways
    from neurotact.report import tables as report_tables
    from neurotact.studies import loading, measures, runner, store
    from neurotact.studies import study as networks_study

Width = Literal["ieee", "ieee-column", "nature", "nature-column"]
WIDTHS_in: dict[str, float] = dict(zip(get_args(Width), (7.16, 3.5, 180 / 25.4, 85 / 25.4), strict=True))
"""Of two columns and of one. Those of Frontiers are those of Nature, 180 and 85 mm."""
HASHES, RECORDINGS, AGAIN = "SHA256SUMS", "recordings.sha256", "reproduce.sh"
SHARED = "$NEUROTACT_DATA/"
"""Begins the path of recordings whose folder the environment names; in a bundle that is `data`."""
README = """# {title}

{about}

Run it again, and compare every table and the answer byte by byte:

    sh {again}

It needs neurotact {version} ({packages}). {took}
The script checks the hashes, runs the study in the folder `again`, which it makes anew each time, and
ends with "all {count} files are the same". Otherwise it names the files that differ, and the versions that do. The
bytes are the same with the versions and the processor's instructions in `versions.json`; others may change last digits.

{needs}

| file | what it is |
|---|---|
| `study.toml` | the study with every setting, as `neurotact study run` takes it |
| `versions.json` | versions of the software, the machine |
| `answer.json` | the answer in words and numbers |
| `tables/` | every table as CSV and, up to {rows} rows, as LaTeX (its first line names the packages) |
| `figures/` | the figures as PDF, {width_mm:.0f} mm wide |
| `methods.md` | the methods in words, with the numbers of `study.toml` and of the networks that ran |
| `references.bib` | BibTeX of the software and of what the study uses |
{recordings}| `{hashes}` | hashes of all files here: `sha256sum -c {hashes}` |
"""


class _Source(NamedTuple):
    """Recordings of a study: where they are, and where a bundle has them."""

    path: Path
    kept: PurePosixPath

    def files(self) -> list[tuple[Path, PurePosixPath]]:
        """Each file, with its path in a bundle."""
        if not self.path.is_dir():
            return [(self.path, self.kept)]
        inside = sorted(path for path in self.path.rglob("*") if path.is_file())
        return [(path, self.kept / path.relative_to(self.path).as_posix()) for path in inside]


def bundle_study(
    study: str | Path,
    out: str | Path,
    *,
    width: Width = "ieee",
    without_data: bool = False,
    force: bool = False,
    tell: Tell = untold,
) -> Path:
    """Write all that a paper and its reviewers need of a finished study into one folder; its path.

    The folder `out` gets the spec, versions, hashes, tables as CSV and LaTeX, figures as PDF, methods in words,
    `references.bib`, the recordings, and `reproduce.sh`, which runs the study again and compares the bytes.

    study: the folder of the study, whose tables and report are written again first.
    width: of the figures: that of two columns, "ieee" (7.16 in) or "nature" (180 mm, as of Frontiers), or of one,
        "ieee-column" (3.5 in) or "nature-column" (85 mm).
    without_data: leave the recordings out; their hashes stay. force: replace a bundle that is in `out`.
    tell: called with what the command prints.
    Raises InputError for a study that is not finished, for recordings that are not found, and for a folder with
    anything but a bundle.

    >>> nt.bundle_study("mine", "bundle", width="ieee-column")  # doctest: +SKIP
    """
    checks.one_of("width", width, tuple(WIDTHS_in))
    folder, target = Path(study), Path(out)
    what = runner.load(folder)
    _check_place(target, folder, force)
    cells = list(loading.engine_of(what).cells(what))
    wanted = loading.engine_of(what).wanted(what, cells, folder)
    if not all(store.is_done(folder, cell) for cell in wanted):
        raise InputError(f"{folder}: is not finished; {store.resuming(folder)} goes on with it")
    table, sources = _placed(specs.read(folder / runner.STUDY))
    listed = _hashes(sources)
    target.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=target.parent, prefix=files.DRAFT) as place:
        draft = Path(place, "bundle")
        runner.write_tables(folder)
        with _printing(draft / "figures", WIDTHS_in[width]):  # in this process, which draws for the paper
            report.write(folder)
        names, what_ran = _write_tables(draft, folder, what), ran.ran_in(folder, what)
        _write(draft / "study.toml", specs.to_toml(table))
        for name in ("versions.json", "data.json", store.ANSWER):
            if (folder / name).is_file():
                shutil.copyfile(folder / name, draft / name)
        _write(
            draft / "methods.md",
            f"# Methods: {what.title}\n\n{methods.in_words(what, _facts(what, sources), what_ran)}\n",
        )
        _write(draft / "references.bib", references.bibtex(what, files.read_json(folder / runner.VERSIONS)))
        if sources:
            _write(draft / RECORDINGS, listed)
        script = (resources.files(__package__ or "") / AGAIN).read_text(encoding="utf-8")
        version = what_ran.versions["neurotact"]
        put = {"NAMES": " ".join(names), "COUNT": str(len(names)), "VERSION": version}
        put["HASHES"] = f"{HASHES} {RECORDINGS}" if sources else HASHES
        for key, value in put.items():
            script = script.replace(key, value)
        _write(draft / AGAIN, script)
        (draft / AGAIN).chmod(0o755)
        _write(draft / "README.md", _readme(what, sources, WIDTHS_in[width], without_data, what_ran, len(names)))
        for path, kept in () if without_data else (pair for source in sources for pair in source.files()):
            (draft / kept).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, draft / kept)
        _write(draft / HASHES, _hashes([_Source(draft, PurePosixPath())]))
        if target.exists():
            shutil.rmtree(target)
        os.replace(draft, target)
    for name in [] if without_data else references.sets(what):
        tell(f"{target}/data: holds recordings of {name}; licence: {SETS[name].licence}")
    tell(f"{target}: run the study again and compare with sh {shlex.quote(f'{target}/{AGAIN}')}")
    return target


def _check_place(target: Path, folder: Path, force: bool) -> None:
    if target.exists() and folder.resolve().is_relative_to(target.resolve()):
        raise InputError(f"{target}: holds the study; choose another folder")
    if target.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{target}: is in the folder of the study; choose one beside it, such as {folder}-bundle")
    if target.is_dir() and not any(target.iterdir()):
        return
    files.check_new(target, force=force)
    if target.exists() and not (target / HASHES).is_file():
        raise InputError(f"{target}: is not a bundle and is not replaced; choose another folder")


def _placed(table: Mapping[str, Any]) -> tuple[dict[str, Any], list[_Source]]:
    """The table of a study whose recordings are in the folder `data` beside it, and these recordings."""
    sources: dict[str, _Source] = {}

    def moved(value: Any, key: str = "") -> Any:
        if isinstance(value, Mapping):
            return {inner: moved(one, inner) for inner, one in value.items()}
        if isinstance(value, list):
            return [moved(one, key) for one in value]
        if key not in ("file", "path") or not isinstance(value, str):
            return value
        if value not in sources:
            sources[value] = _Source(expand(value), _kept(value, [source.kept for source in sources.values()]))
        return value if value.startswith(SHARED) else str(sources[value].kept)

    return moved(table), [*sources.values()]


def _kept(place: str, taken: list[PurePosixPath]) -> PurePosixPath:
    """Where a bundle has the recordings at a place: by their name, in a folder of their own if another has it."""
    if place.startswith(SHARED):
        return PurePosixPath("data", place.removeprefix(SHARED))
    name = Path(place).name
    several = (PurePosixPath("data", *folder, name) for folder in [(), *((str(n),) for n in range(2, len(taken) + 3))])
    return next(kept for kept in several if kept not in taken)


def _facts(study: "loading.Study", sources: list[_Source]) -> list[str]:
    """The numbers of trials, classes and taxels, and the sampling rate, of the recordings that a study uses."""
    if isinstance(study, networks_study.StudySpec):
        return [dataset.load_recordings(study.dataset).summary()]
    facts = []
    for source in sources:
        with suppress(InputError):  # spikes, or files of another program
            facts.append(hdf5.load_recordings(source.path).summary())
    return facts


def _hashes(sources: list[_Source]) -> str:
    """The SHA-256 of each file, as `sha256sum -c` reads them."""
    lines = []
    for source in sources:
        if not source.path.exists():
            where = "" if source.path.is_absolute() else ", or go to the folder in which the study ran"
            raise InputError(f"{source.path}: the recordings of this study are not there; put them back{where}")
        lines += [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {kept}" for path, kept in source.files()]
    return "".join(f"{line}\n" for line in lines)


@contextmanager
def _printing(folder: Path, width_in: float) -> Iterator[None]:
    """Print each figure of a report that is written in the block."""

    def print_it(drawn: style.Drawn) -> None:
        style.save(prints.fit(drawn.figure, width_in), folder / f"{drawn.name}.pdf")

    token = page.PRINTED.set(print_it)
    try:
        yield
    finally:
        page.PRINTED.reset(token)


def _write_tables(draft: Path, folder: Path, study: "loading.Study") -> list[str]:
    """Write the tables as CSV and LaTeX; the files that a second run has with the same bytes."""
    captions = _captions(study)
    names = sorted(path.name for path in folder.glob("*.csv") if path.name != runner.TIMINGS)
    for name in names:
        (draft / "tables").mkdir(parents=True, exist_ok=True)
        shutil.copyfile(folder / name, draft / "tables" / name)
        about = f"{study.title}: {captions.get(name, Path(name).stem)}"
        if text := wide_tables.in_latex_parts(tables.read_table(folder / name), about):
            _write((draft / "tables" / name).with_suffix(".tex"), text)
    for number, shown in enumerate(_shown(folder, study), 1):
        table = pd.DataFrame(shown["rows"], columns=shown["columns"])
        _write(draft / "tables" / f"shown-{number}.tex", wide_tables.in_latex_parts(table, shown["caption"]))
    return [store.ANSWER, *names] if (folder / store.ANSWER).is_file() else names


def _shown(folder: Path, study: "loading.Study") -> list[dict[str, Any]]:
    """The short tables of the report, as a paper shows them."""
    found = list(nt.study_answer(folder).get("tables", []))
    if isinstance(study, networks_study.StudySpec) and study.network is not None:
        results = report_tables.with_pair(tables.read_table(folder / "results.csv"), study)
        results = report_tables.with_setting(results, study)
        found.insert(0, networks.means_table(results, study)._asdict())
    return found


def _captions(study: "loading.Study") -> dict[str, str]:
    if not isinstance(study, networks_study.StudySpec):
        return ways.DOWNLOADS
    return networks.DOWNLOADS | {
        f"{one.table}.csv": one.download for one in measures.requested(study.measures).values()
    }


def _readme(
    study: "loading.Study",
    sources: list[_Source],
    width_in: float,
    without_data: bool,
    what_ran: "ran.Ran",
    n_files: int,
) -> str:
    lines = []
    for name in references.sets(study):
        lines.append(f"Recordings of {name}: {SETS[name].page}; licence: {SETS[name].licence}.")
    if without_data and sources:
        places = ", ".join(f"`{source.kept}`" for source in sources)
        lines.append(f"The recordings are not here. Put them at {places}, and compare them with `{RECORDINGS}` first.")
    needs = "".join(f"{line}\n\n" for line in lines)
    row = f"| `data/`, `{RECORDINGS}` | the recordings, and their hashes: `sha256sum -c {RECORDINGS}` |\n"
    names = {"again": AGAIN, "recordings": row if sources else "", "hashes": HASHES}
    versions, minutes = what_ran.versions, max(1, round(what_ran.seconds / 60))
    names |= {"version": versions["neurotact"], "packages": f"Python {versions['python']}, PyTorch {versions['torch']}"}
    names["took"] = f"The parts of the study took {minutes} min, one after another. " if what_ran.seconds else ""
    names |= {"title": study.title, "about": " ".join(study.about.split()), "needs": needs}
    text = README.format(count=n_files, width_mm=25.4 * width_in, rows=wide_tables.MOST, **names)
    return re.sub(r"\n{3,}", "\n\n", text)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8", newline="\n")
