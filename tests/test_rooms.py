"""What a room offers the others, which its `__init__` lists; how many names that is; no text names a lost file."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import neurotact

PACKAGE = Path(neurotact.__file__).parent
ROOT = PACKAGE.parent
BESIDE = ("encoders", "exporters", "networks", "opponents", "prices", "readers", "streams", "studies")
MODULES = sorted(PACKAGE.rglob("*.py"))
OTHERS = [path for room in BESIDE for path in sorted((ROOT / room).rglob("*.py"))]
OFFERS = re.compile(r"Other rooms take:\n\n(.*)", re.DOTALL)
MOST_NAMES = 900


def dotted(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


PATHS = {dotted(path): path for path in MODULES}


def room_of(module: str) -> str:
    """The folder or the file right below the package; of a package beside it, its folder."""
    first, *rest = module.split(".")
    return rest[0] if first == "neurotact" and rest else first


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def defined(module: str) -> set[str]:
    """Functions, classes and values at the top of a module."""
    names = set()
    for node in tree(PATHS[module]).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}
    return names


def taken(path: Path) -> Iterator[tuple[str, str]]:
    """The names that a file takes of modules of the package: by import, or as an attribute of an imported module."""
    alias: dict[str, str] = {}
    nodes = list(ast.walk(tree(path)))
    for node in nodes:
        if not isinstance(node, ast.ImportFrom) or not str(node.module).startswith("neurotact"):
            continue
        for name in node.names:
            if (module := f"{node.module}.{name.name}") in PATHS:
                alias[name.asname or name.name] = module
            elif node.module in PATHS:
                yield str(node.module), name.name
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in alias:
            yield alias[node.value.id], node.attr


def front() -> Iterator[tuple[str, str]]:
    """Names that users import, and those of entry points."""
    for face in PACKAGE.rglob("__init__.pyi"):
        for module, name in re.findall(r"from \.([\w.]+) import (\w+)", face.read_text(encoding="utf-8")):
            yield f"{dotted(face.with_suffix('.py'))}.{module}", name
    yield from re.findall(r'"(neurotact\.[\w.]+):(\w+)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def offered(room: str) -> set[tuple[str, str]]:
    """What the list of a room offers."""
    found = OFFERS.search(ast.get_docstring(tree(PACKAGE / room / "__init__.py")) or "")
    rows = re.findall(r"^ *([\w.]+): (.*)$", re.sub(r",\n +", ", ", found[1]), re.MULTILINE) if found else []
    modules = [(f"neurotact.{room}.{module}".removesuffix(".__init__"), names) for module, names in rows]
    return {(module, name) for module, names in modules for name in names.split(", ")}


def test_a_room_lists_what_others_take_of_it_and_nothing_else():
    used: dict[str, set[tuple[str, str]]] = {}
    every = [(dotted(path), pair) for path in (*MODULES, *OTHERS) for pair in taken(path)]
    for user, (module, name) in [*every, *(("users", pair) for pair in front())]:
        if room_of(user) != room_of(module) and name in defined(module) and PATHS[module].parent != PACKAGE:
            used.setdefault(room_of(module), set()).add((module, name))
    for room, names in used.items():
        assert offered(room) == names, room


def test_no_module_takes_a_private_name_of_another():
    for path in (*MODULES, *OTHERS):
        private = [(module, name) for module, name in taken(path) if re.match("_(?!_|native)", name)]
        assert not [pair for pair in private if pair[0] != dotted(path)], path


def test_the_package_has_few_public_names():
    """Functions and classes that one room takes of another; those of a module right below the package are its own."""
    at_top = [name for module, path in PATHS.items() if path.parent == PACKAGE for name in defined(module)]
    functions = [name for name in at_top if not name.startswith("_") and not name.isupper()]
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    lists = [name for room in rooms for _, name in offered(room) if not name.isupper()]
    assert len(functions) + len(lists) <= MOST_NAMES


@cache
def ends() -> set[str]:
    """Paths of source files from the top, and what follows each folder of them."""
    every = [path.relative_to(ROOT) for room in (*BESIDE, "neurotact", "tests", "native", "benchmarks", "docs")
             for path in (ROOT / room).rglob("*") if path.suffix in {".py", ".cpp", ".hpp"}]  # fmt: skip
    return {"/".join(path.parts[first:]) for path in every for first in range(len(path.parts))}


MADE_UP = ("my_skin/", "NAME.py", "/mine.py")
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), ROOT / "tests" / "README.md", *MODULES, *OTHERS]


@pytest.mark.parametrize(("named", "pages"), [
    (r"`((?:[\w-]+/)+[\w-]+\.(?:py|cpp|hpp))`", [page for page in PAGES if page.name != "CHANGELOG.md"]),
    (r"((?:[\w-]+/)+[\w-]+\.(?:py|cpp|hpp))\b", sorted((ROOT / "native").glob("*.[ch]pp"))),
])  # fmt: skip
def test_a_text_names_no_file_that_is_not_there(named, pages):
    for page in pages:
        found = re.findall(named, page.read_text(encoding="utf-8"))
        assert not [n for n in found if n not in ends() and not any(word in n for word in MADE_UP)], page


def lost(text: str) -> list[str]:
    """The files and folders that a text names and that are neither at the top nor in a folder that it names before."""
    folders, found = [ROOT], []
    for name in re.findall(r"`([\w./-]+(?:/|\.(?:py|cpp|hpp|toml|html)))`", text):
        there = [folder / name for folder in folders if (folder / name).exists()]
        if there:
            folders.append(there[0] if name.endswith("/") else there[0].parent)
        elif "NAME" not in name:
            found.append(name)
    return found


def test_the_page_of_the_rooms_names_what_is_there():
    """Each row of a table by itself, as each section is without its tables."""
    for section in (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").split("\n## "):
        rows = [line for line in section.splitlines() if line.startswith("|")]
        for text in ("\n".join(line for line in section.splitlines() if line not in rows), *rows):
            assert lost(text) == [], text


def test_a_lost_file_is_found():
    assert lost("`neurotact/data/` has `hdf5.py`, `lost.py`") == ["lost.py"]
    assert lost("`hdf5.py`, `neurotact/lost/`, `encoders/NAME.py`") == ["hdf5.py", "neurotact/lost/"]
