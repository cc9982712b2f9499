"""The BibTeX of a study: the software, and what each part that it uses cites by DOI or arXiv number.

A part declares its source once, where it is: in its docstring or its spec. `references.bib` has the rest of each entry,
by the DOI or the arXiv number; what it lacks, such as the source of another package's part, is cited by number alone.
"""

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import resources
from types import ModuleType
from typing import Any, get_args

from neurotact import plugins
from neurotact import spec as specs
from neurotact.baselines import opponent
from neurotact.data import augmentation
from neurotact.data.fetch import SETS
from neurotact.encoders import specs as encoders
from neurotact.errors import InputError
from neurotact.networks.training import balancing
from neurotact.studies.loading import Study
from neurotact.studies.study import StudySpec
from neurotact.tables import in_latex

NUMBER = re.compile(r"\b10\.\d{4,9}/[^\s;,]+|arXiv:?\s+(?:#\s+)?(\d{4}\.\d{4,5})")
FIELD = re.compile(r"^\s*(\w+) = \{(.*)\},?$", re.MULTILINE)
CITATION = re.compile(r"(?P<author>.+?): (?P<title>.+?)(?:\. (?P<venue>[^.]+?))?(?: \((?P<year>\d{4})\).*)?$")
"""The form of citations in the registry of data sets: `A. Author, B. Author: Title. Journal 1:2 (2020), doi 10...`."""

GROUPS: dict[str, tuple[plugins.Group, ...]] = {
    "model": ("encoders", "networks"), "encoder": ("encoders",), "encoders": ("encoders",), "prices": ("prices",),
    "surrogate": ("surrogates",), "loss": ("losses",),
}  # fmt: skip
"""Keys of a study whose values name parts, and the groups of these."""


def numbers_in(text: str) -> list[str]:
    """The DOIs and arXiv numbers that a text names, each once.

    >>> numbers_in("(Izhikevich 2001, doi 10.1016/S0893-6080(01)00078-8), arXiv 2210.13107).")
    ['10.1016/S0893-6080(01)00078-8', '2210.13107']
    """
    found = (match[1] or _without_end(match[0]) for match in NUMBER.finditer(text))
    return list(dict.fromkeys(found))


def _without_end(doi: str) -> str:
    """A DOI without the point, the colon or the closing bracket of the sentence around it."""
    while doi[-1] in ".:" or (doi[-1] == ")" and doi.count(")") > doi.count("(")):
        doi = doi[:-1]
    return doi


@cache
def known() -> dict[str, str]:
    """The entries of `references.bib`, by each DOI, arXiv number and package."""
    text = (resources.files(__package__ or "") / "references.bib").read_text(encoding="utf-8")
    found = {}
    for entry in re.findall(r"^@.*?^\}", text, re.MULTILINE | re.DOTALL):
        fields = dict(FIELD.findall(entry))
        found |= {fields[key]: entry for key in ("doi", "eprint", "of") if key in fields}
    return found


def bibtex(study: Study, versions: Mapping[str, str]) -> str:
    """The entries of the software in these versions, and of what a study uses."""
    of = re.compile(r"^  of = .*\n", re.MULTILINE)
    software = [
        of.sub(f"  note = {{Version {in_latex(version)}}},\n", known()[name])
        for name, version in versions.items()
        if name in known() and (name != "nni" or getattr(study, "search", None) is not None)
    ]
    cited = [known().get(number) or _by_number(number) for text in texts(study) for number in numbers_in(text)]
    return "\n".join(dict.fromkeys([*software, *map(_of_citation, sets(study)), *cited])) + "\n"


def _by_number(number: str) -> str:
    key = re.sub(r"\W", "-", number)
    fields = f"  doi = {{{number}}}," if "/" in number else f"  eprint = {{{number}}},\n  archiveprefix = {{arXiv}},"
    shown = in_latex(f"{'doi:' if '/' in number else 'arXiv:'}{number}")
    return f"@misc{{{key},\n  key = {{{key}}},\n  title = {{{shown}}},\n{fields}\n}}"


def _of_citation(name: str) -> str:
    """The entry of a public data set, from its citation in the registry."""
    about = SETS[name]
    number = next(iter(numbers_in(about.citation)), "")
    if number in known():
        return known()[number]
    match = CITATION.match(about.citation)
    assert match is not None, about.citation
    fields = {key: in_latex(value) for key, value in match.groupdict().items() if value}
    people = re.sub(r",? et al\.", ", others", fields["author"])
    is_of_people = re.match(r"[A-Z]\. ", people) is not None
    fields["author"] = " and ".join(re.split(r",? (?=others)|, ", people)) if is_of_people else f"{{{people}}}"
    fields["title"] = f"{{{fields['title']}}}"
    fields |= {"howpublished": fields.pop("venue")} if "venue" in fields else {}
    fields |= {"doi": number} if "/" in number else {"url": about.page.partition(" ")[0]}
    lines = [f"  {key} = {{{value}}}," for key, value in fields.items()]
    return "\n".join([f"@misc{{{name},", *lines, "}"])


def sets(study: Study) -> list[str]:
    """The public data sets of a study."""
    readers = {value for key, value in _leaves(study.model_dump(mode="json")) if key == "read"}
    return [name for name, one in SETS.items() if one.reader and one.reader in readers]


def texts(study: Study) -> Iterator[str]:
    """What the parts of a study say of themselves."""
    for group, name in dict.fromkeys(used(study)):
        if group == "prices":
            yield from _of_prices(name)
        elif group == "opponents":
            part = plugins.load(group, name, opponent.Opponent)
            yield " ".join([part.about, *(docstring or "" for docstring in _docstrings(part.build))])
        else:
            yield " ".join(docstring or "" for docstring in _docstrings(plugins.load(group, name)))
    if isinstance(study, StudySpec):
        yield ((augmentation.__doc__ or "") if has_copies(study) else "")
        yield (balancing.__doc__ or "") if study.balance != "none" else ""


def has_copies(study: StudySpec) -> bool:
    """Whether networks may train on varied copies: by name, or by `auto` where other conditions are tested."""
    kind = study.augmentation.kind if study.augmentation else augmentation.NONE
    return kind != augmentation.NONE and (
        kind != augmentation.AUTO or bool(study.split.test_where and not study.search)
    )


def _docstrings(part: Any) -> list[str | None]:
    """Of a part that is a module, of its spec or keys, or of the part itself, and of the module that has it."""
    if isinstance(part, ModuleType):
        return [part.__doc__, sys.modules[part.__package__ or part.__name__].__doc__]
    home = next((getattr(part, name) for name in ("spec", "keys") if hasattr(part, name)), part)
    module = sys.modules.get(getattr(home, "__module__", ""))
    return [home.__doc__, module.__doc__ if module else None]


def used(study: Study) -> Iterator[tuple[plugins.Group, str]]:
    """The parts of a study, each with its group."""
    yield "ways", study.way
    if isinstance(study, StudySpec):
        if study.baselines != "none":
            for takes in get_args(opponent.Takes):
                for name in opponent.joined(takes, study.baselines):
                    yield "opponents", name
        yield "prices", study.prices.name
    for key, value in _leaves(study.model_dump(mode="json")):
        for group in GROUPS.get(key, ()):
            name = _model_of(value) if group == "encoders" and isinstance(value, str) else value
            if group == "prices" or plugins.has(group, name):
                yield group, name


def _model_of(encoder: str) -> str:
    """The model of an encoder that is named in a sweep or as a parameter, where it is one."""
    try:
        return encoders.load(encoder).model
    except InputError:
        return encoder


def _of_prices(name: str) -> Iterator[str]:
    """What a price list says of itself, and the one that it is like."""
    while name:
        try:
            path = specs.find("prices", name)
        except InputError:
            return
        text = specs.text(path)
        yield text
        name = tomllib.loads(text).get("like", "")


def _leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for inner, one in value.items():
            yield from _leaves(one, str(inner).partition(" ")[0])
    elif isinstance(value, list):
        for one in value:
            yield from _leaves(one, key)
    else:
        yield key, value
