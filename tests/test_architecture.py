"""Imports go one way, and nothing reads a pickle."""

import ast
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import neurotact

PACKAGE = Path(neurotact.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))
ROOMS = ("encoders", "exporters", "networks", "opponents", "readers", "streams", "studies")
BESIDE = sorted(path for room in ROOMS for path in (PACKAGE.parent / room).rglob("*.py"))
"""Modules of the packages beside the framework."""
FLOORS = (
    ("errors",),
    ("interrupt", "effects", "classes", "lazily"),
    ("files", "loaded", "progress", "backend", "notebook", "repeated_warnings"),
    ("spec", "effects", "neurons", "tables", "checks", "estimators", "plugins", "workers", "versions"),
    ("data",),
    ("metrics",),
    ("encoders",),
    ("baselines",),
    ("networks",),
    ("figures",),
    ("studies",),
    ("report",),
    ("api",),
    ("cli",),
    ("__main__",),
)
LARGEST_ROOM = 0.30
"""Share of the package's lines that one room may hold."""
FLOOR = {part: floor for floor, parts in enumerate(FLOORS) for part in parts}
LOADS = re.compile("^(load|save)$|pickle")
PICKLES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
PLAIN_VALUES = "plain_objects.py"
"""Checks every opcode of a pickle before it is read, and refuses every name in it."""

OPTION = re.compile(r"(?<![\w-])(?:--[a-zA-Z]|-o\b)")
OTHER_PROGRAMS = re.compile(r"ros2 topic echo --csv|pip install --no-deps|--nworkers -1 --nthreads 1")
"""Options of programs that are not neurotact."""
TYPED = re.compile(r"neurotact (import|study run) .*")
"""Command lines of messages, which are to be typed."""
OPTIONS_ALLOWED = {
    "exporters/c/proof.py": "calls compilers",
    "neurotact/report/period_choice.py": "gives whole commands, to be typed as they stand",
}

OF_CLI = {"api", "errors", "files", "interrupt", "lazily", "plugins", "progress", "spec", "tables"}
"""What the command line may import besides its own modules: the API, and how options are read and results printed."""
OF_CLI_ALONE = {
    "export": {"effects"},  # `export` refuses options beside a check of chips
}


class Module(NamedTuple):
    """imports: dotted names, wherever in the module the import stands. loads: calls that may read or write a pickle.

    texts: the string literals; of an f-string all parts in one, with `X` in place of each value.
    """

    docstring: str | None
    imports: tuple[str, ...]
    loads: tuple[ast.Call, ...]
    texts: tuple[str, ...]


@cache
def module(path: Path) -> Module:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    inner = {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
    loads = tuple(node for node in nodes if isinstance(node, ast.Call) and LOADS.search(_name(node)))
    return Module(ast.get_docstring(tree), tuple(_imports(path, nodes)), loads, tuple(_texts(nodes, inner)))


def _name(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _imports(path: Path, nodes: list[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _texts(nodes: list[ast.AST], inner: set[int]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "X" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner:
            yield node.value


def part_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def parts_used(path: Path) -> set[str]:
    """Which parts of neurotact a module imports; the package itself (`neurotact.__version__`) is no part."""
    names = [name.split(".") for name in module(path).imports]
    return {name[1] for name in names if name[0] == "neurotact" and len(name) > 1 and not name[1].startswith("_")}


def test_every_part_has_its_floor():
    parts = {part_of(path) for path in MODULES} - {"__init__"}
    assert parts <= set(FLOOR)


def test_a_module_imports_from_lower_floors_alone():
    for path in MODULES:
        part = part_of(path)
        floor = FLOOR.get(part, 0)  # that of the package itself: it imports nothing
        assert not {used for used in parts_used(path) if used != part and FLOOR[used] >= floor}, path


def test_the_command_line_calls_the_api_alone():
    used = {path.stem: parts_used(path) - {"cli", *OF_CLI} for path in MODULES if part_of(path) == "cli"}
    assert {name: parts for name, parts in used.items() if parts} == OF_CLI_ALONE


def test_no_module_imports_itself_in_a_circle():
    names = {module_of(path): path for path in MODULES}
    used = {
        name: {_module_in(one, names) for one in module(path).imports} - {None, name} for name, path in names.items()
    }
    TopologicalSorter(used).prepare()  # raises CycleError, which names the circle


def module_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _module_in(dotted: str, names: Mapping[str, Path]) -> str | None:
    """The module that an imported name is, or lies in; None where it is of another package."""
    return dotted if dotted in names else next((one for one in [dotted.rpartition(".")[0]] if one in names), None)


def test_no_room_holds_most_of_the_package():
    lines = Counter()
    for path in MODULES:
        lines[part_of(path)] += len(path.read_text(encoding="utf-8").splitlines())
    room, most = lines.most_common(1)[0]
    assert most < LARGEST_ROOM * lines.total(), room


def test_the_framework_imports_no_package_beside_it():
    """The framework finds them by name (`neurotact.plugins`)."""
    assert BESIDE
    assert [path for path in MODULES if any(name.startswith("neurotact_") for name in module(path).imports)] == []
    for path in BESIDE:
        assert not any(name.startswith(("neurotact.api", "neurotact.cli")) for name in module(path).imports), path


def test_nothing_reads_or_writes_a_pickle():
    for path in (*MODULES, *BESIDE):
        assert path.name == PLAIN_VALUES or not PICKLES & {name.split(".")[0] for name in module(path).imports}, path
        for call in module(path).loads:
            called = ast.unparse(call.func)
            where = f"{path}, line {call.lineno}: {called}"
            assert "pickle" not in called.rpartition(".")[2], where
            given = {word.arg: ast.unparse(word.value) for word in call.keywords}
            assert called != "torch.save", f"{where} is a pickle"
            assert called != "torch.load" or given.get("weights_only") == "True", f"{where} without weights_only=True"
            if called in ("np.load", "numpy.load"):
                assert given.get("allow_pickle") == "False", f"{where} without allow_pickle=False"


def test_a_module_says_what_it_is():
    assert [path for path in (*MODULES, *BESIDE) if not module(path).docstring] == []


def test_no_two_test_files_have_one_name():
    """Pytest imports them by their base name."""
    names = [path.name for path in Path(__file__).parent.rglob("test_*.py")]
    assert len(names) == len(set(names))


def test_only_the_command_line_names_an_option():
    """A message names the parameter, in backquotes; the command line turns it into the option (`cli.words`)."""
    typed = {path for path in MODULES if part_of(path) == "cli"} | {PACKAGE.parent / name for name in OPTIONS_ALLOWED}
    for path in sorted({*MODULES, *BESIDE} - typed):
        texts = module(path).texts
        assert [text for text in texts if OPTION.search(TYPED.sub("", OTHER_PROGRAMS.sub("", text)))] == [], path
