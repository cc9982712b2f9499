"""The page of a report: the common parts, its style and scripts, and its downloads."""

import ast
import json
import re
import shlex
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from functools import lru_cache
from gzip import compress
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from neurotact import plugins
from neurotact.errors import number_of
from neurotact.figures.style import Drawn, save
from neurotact.files import read_json, write_text
from neurotact.spec import assignments_of
from neurotact.studies.loading import Study
from neurotact.studies.store import PAGE
from neurotact.studies.study import to_toml

PRINTED: ContextVar[Callable[[Drawn], object]] = ContextVar("printed", default=lambda drawn: None)
"""Called with each figure of a report when it is saved, and may change it then: who prints them for a paper."""
NETWORKS = ("marks.js", "plotly.js", "state.js", "cell.js", "trade_off.js", "compare.js", "table.js", "main.js")
PROTOCOL = ("marks.js", "plotly.js", "state.js", "table.js", "protocol.js")


_SETTINGS = re.compile(r"`settings=(\{[^`]*\})`")
# \x60 is the backquote: in one, a pattern would be read as the name of a parameter.
_SPEC = re.compile(r"\x60\w+=nt\.\w+\((\w+)=(\w+)\)\x60")


class Table(NamedTuple):
    """A table as text: caption, column heads, rows, whose first `n_heads` cells are row heads; `named`: of `few`."""

    caption: str
    columns: list[str]
    rows: list[list[str]]
    n_heads: int = 0
    named: Sequence[int] = ()

    @property
    def first(self) -> list[int]:
        """At most five rows, in their order: of `named` the first ones, or without it from both ends.

        >>> Table("", [], [[str(row)] for row in range(9)]).first, Table("", [], [["a"], ["b"]], named=[1]).first
        ([0, 1, 2, 3, 8], [1])
        """
        order = self.named or sorted(range(len(self.rows)), key=lambda row: row % (len(self.rows) - 1 or 1))
        return sorted([*dict.fromkeys(order)][:5])

    @property
    def few(self) -> "Table":
        """The table with these rows alone."""
        return self._replace(rows=[self.rows[row] for row in self.first])

    def as_json(self) -> dict[str, Any]:
        """For programs, with all rows; `named` are those that are shown first."""
        return self._replace(named=self.first)._asdict()


class Figure(NamedTuple):
    """A large figure of the first screen: what it is, its value, what the value is of, and what it is compared with."""

    what: str
    value: str
    of: str
    against: str


class Entry(NamedTuple):
    """A cell of a sortable table: its text, and its sort key."""

    text: str
    value: str | float


class _Parts(NamedTuple):
    """The parts that the template inserts unchanged.

    plotly: the library, gzipped and in base64: 2 MB in place of 4.8, unpacked by the browser.
    policy: a content security policy that allows these two scripts and no network access.
    """

    style: Markup
    script: Markup
    plotly: Markup
    data: Markup
    policy: str


def write(
    template: str,
    study: Study,
    folder: Path,
    *,
    n_done: int,
    n_cells: int,
    tables: Mapping[str, pd.DataFrame],
    figures: Iterable[Drawn],
    downloads: Mapping[str, str],
    specs: Mapping[str, str],
    **shown: Any,
) -> Path:
    """Write `report.html` and its figures into a run folder; the page's path.

    template: in `assets`; `shown` holds its own variables, besides those of every page.
    tables: for the verdicts on the study's claims. downloads: files that may be in the folder, and their descriptions.
    specs: parts of the study as TOML, in addition to the whole study.
    Raises InputError when a claim names a missing column.
    """
    judged = plugins.load_function("tools", "verdicts_on")(study.claims, tables) if study.claims else {}
    explained = study.as_shipped and n_done == n_cells  # the reasons hold for the study as shipped
    page = _template(template).render(
        study=study,
        n_done=n_done,
        n_cells=n_cells,
        explained=explained,
        figures=[_keep(drawn, folder) for drawn in figures],
        timing=_timing_sentence(folder),
        downloads=_listed(folder, downloads),
        specs={"Whole study": to_toml(study), **specs},
        versions=if_there(folder / "versions.json"),
        **(judged if explained else judged | {"reasons": {}}),
        **shown,
    )
    write_text(folder / PAGE, page)
    return folder / PAGE


def parts(data: dict[str, Any], scripts: Sequence[str]) -> _Parts:
    """The parts of a page that shows `data` by the named scripts."""
    script = "\n".join(["(() => {", '"use strict";', *map(_read, scripts), "})();"])
    plotly, library_hash = _plotly()
    allowed = f"'sha256-{_hash(script)}' '{library_hash}'"
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
    return _Parts(Markup(_read("style.css")), Markup(script), Markup(plotly), Markup(_script_json(data)), policy)


def _script_json(value: Any) -> str:
    """JSON that cannot end the script element that holds it.

    >>> _script_json({"name": "</script>&"})
    '{"name":"\\\\u003c/script\\\\u003e\\\\u0026"}'
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _timing_sentence(folder: Path) -> str:
    """The run time of the cells, in words; empty without timings.csv."""
    path = folder / "timings.csv"
    if not path.is_file():
        return ""
    every = pd.read_csv(path).dropna(subset="seconds")  # drops cells with a damaged timing
    timings = every.dropna(subset="cell")
    if timings.empty:
        return ""
    seconds = timings["seconds"]
    beside = [f"{row['part']} {row['seconds']:.1f} s" for _, row in every[every["cell"].isna()].iterrows()]
    before = f" Before them: {', '.join(beside)}." if beside else ""
    took = (
        f"{number_of(len(timings), 'cell')} took {_duration(seconds.sum())} of worker time: {seconds.median():.1f} s "
        f"in the median, {seconds.max():.1f} s at most"
    )
    if "epochs" not in timings:
        return f"{took}.{before}"
    low, high = (f"{timings['epochs'].agg(which):.0f}" for which in ("min", "max"))
    return f"{took}, for {low if low == high else f'{low} to {high}'} epochs of training each.{before}"


def if_there(path: Path) -> dict[str, Any]:
    """The content of a JSON file; empty if there is none."""
    return read_json(path) if path.is_file() else {}


def typed(text: str, option: str) -> str:
    """A message whose settings and specs are as they are typed in a shell, and whose percent signs stay with numbers.

    >>> typed("try `settings={'window.length_ms': ..., 'window.align': 'onset'}`", "with")
    'try `with window.length_ms=VALUE with window.align=onset`'
    """
    text = _SPEC.sub(lambda match: f"{match[0][0]}--{match[1]} {match[2]}{match[0][0]}", text)
    return _SETTINGS.sub(lambda match: _as_typed(match[1], option) or match[0], text).replace(" %", "\u00a0%")


def _as_typed(settings: str, option: str) -> str | None:
    try:
        given = ast.literal_eval(settings)
    except (SyntaxError, ValueError):
        return None
    if not isinstance(given, dict):
        return None
    return f"`{' '.join(f'{option} {shlex.quote(text_of)}' for text_of in assignments_of(given))}`"


def plain(value: Any) -> str | float:
    """The sort key of a table cell; empty for a missing number."""
    if isinstance(value, str):
        return value
    return "" if pd.isna(value) else float(value)


@lru_cache(maxsize=1)
def _plotly() -> tuple[str, str]:
    """plotly.js packed, and its hash in the form of a policy."""
    library = get_plotlyjs()
    return b64encode(compress(library.encode(), 9, mtime=0)).decode(), f"sha256-{_hash(library)}"


def _read(name: str) -> str:
    return (resources.files("neurotact.report") / "assets" / name).read_text(encoding="utf-8")


def _keep(drawn: Drawn, folder: Path) -> dict[str, Any]:
    """Write a figure into a run folder; returns the page's data of it, including the picture."""
    for suffix in (".svg", ".png"):
        save(drawn.figure, folder / "figures" / f"{drawn.name}{suffix}")
        drawn.figure.set_layout_engine("none")  # Laid out once: faster, and both files look the same.
    svg = (folder / "figures" / f"{drawn.name}.svg").read_bytes()
    width = round(96 * drawn.figure.get_figwidth())
    source = f"data:image/svg+xml;base64,{b64encode(svg).decode()}"
    PRINTED.get()(drawn)
    return {"source": source, "width": width, **{k: getattr(drawn, k) for k in ("name", "title", "caption", "alt")}}


def _listed(folder: Path, downloads: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """The downloads of the page: file name, description, and a link that contains the file."""
    return [(name, what, _inline(folder / name)) for name, what in downloads.items() if (folder / name).is_file()]


def _inline(path: Path) -> str:
    """A file as a link that works wherever the page is moved."""
    kinds = {".csv": "text/csv", ".json": "application/json", ".md": "text/markdown", ".toml": "application/toml"}
    return f"data:{kinds[path.suffix]};base64,{b64encode(path.read_bytes()).decode()}"


def _template(name: str):
    """A page's template; a missing variable is an error."""
    environment = Environment(
        loader=PackageLoader("neurotact.report", "assets"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typed"] = typed
    return environment.get_template(name)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"


def _hash(script: str) -> str:
    return b64encode(sha256(script.encode()).digest()).decode()
