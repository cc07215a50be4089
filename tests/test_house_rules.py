"""The rules of the house, held over the syntax trees: who may import whom, how long things may grow."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("sensors", "model", "pipeline")
LONGEST_FUNCTION = 60
LONGEST_MODULE = 450
ONE_IMPORTER = {
    "matplotlib": "pipeline/figures.py",
    "mcap": "sensors/log.py",
    "pymap3d": "sensors/geodesy.py",
}
SHELVES = {
    "sensors/formats": "FORMATS",
    "model/tyres": "TYRES",
    "pipeline/metrics": "METRICS",
    "pipeline/sections": "SECTIONS",
}


def _sources(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def _dotted(path: Path) -> tuple[str, ...]:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return parts[:-1] if parts[-1] == "__init__" else parts


def _absolute(path: Path, node: ast.ImportFrom) -> tuple[str, ...]:
    """The module an import names, with relative dots resolved: ('pipeline', 'fusion', 'motion')."""
    named = tuple((node.module or "").split(".")) if node.module else ()
    if node.level == 0:
        return named
    package = _dotted(path) if path.name == "__init__.py" else _dotted(path)[:-1]
    return ("smts_validate", *package)[: len(package) + 2 - node.level] + named


def _imports(path: Path, nodes: Iterator[ast.AST] | None = None) -> Iterator[tuple[str, ...]]:
    """Every module that a file imports, as parts, without the installed prefix."""
    for node in nodes or ast.walk(_tree(path)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield _bare(tuple(alias.name.split(".")))
        elif isinstance(node, ast.ImportFrom):
            module = _absolute(path, node)
            yield from [_bare(module)] if _bare(module) else []
            for alias in node.names:
                if _file_of(_bare((*module, alias.name))):
                    yield _bare((*module, alias.name))


def _bare(module: tuple[str, ...]) -> tuple[str, ...]:
    return module[1:] if module[:1] == ("smts_validate",) else module


def _file_of(module: tuple[str, ...]) -> Path | None:
    """The source file of one of our modules."""
    if not module or module[0] not in PACKAGES:
        return None
    base = ROOT.joinpath(*module)
    return next((file for file in (base.with_suffix(".py"), base / "__init__.py") if file.is_file()), None)


def _functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (
        node for node in ast.walk(_tree(path)) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    )


ours = pytest.mark.parametrize("path", _sources(*PACKAGES), ids=_name)
everything = pytest.mark.parametrize("path", _sources(*PACKAGES, "tests", "benchmarks"), ids=_name)


@ours
def test_sensors_and_model_know_neither_each_other_nor_the_pipeline(path: Path) -> None:
    folder = _dotted(path)[0]
    allowed = set(PACKAGES) if folder == "pipeline" else {folder}
    for module in _imports(path):
        assert module[0] not in PACKAGES or module[0] in allowed, f"{_name(path)} imports {'.'.join(module)}"


@ours
def test_each_wrapped_package_has_one_importer(path: Path) -> None:
    for module in _imports(path):
        home = ONE_IMPORTER.get(module[0])
        assert home is None or home == _name(path), f"{module[0]} belongs into {home}, not into {_name(path)}"


@ours
def test_only_the_command_line_prints_or_exits(path: Path) -> None:
    if _name(path) == "pipeline/cli.py":
        return
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called not in {"print", "click.echo", "sys.exit", "exit"}, (
                f"{_name(path)}:{node.lineno} {called}"
            )


@ours
def test_a_function_fits_on_a_screen(path: Path) -> None:
    for function in _functions(path):
        length = (function.end_lineno or 0) - function.lineno + 1
        assert length <= LONGEST_FUNCTION, f"{_name(path)}: {function.name} has {length} lines"


@ours
def test_a_module_is_one_idea(path: Path) -> None:
    lines = len(path.read_text(encoding="utf-8").splitlines())
    assert lines <= LONGEST_MODULE, f"{_name(path)} has {lines} lines"


@ours
def test_every_function_states_its_types(path: Path) -> None:
    for function in _functions(path):
        arguments = function.args.posonlyargs + function.args.args + function.args.kwonlyargs
        bare = [a.arg for a in arguments if a.annotation is None and a.arg not in {"self", "cls"}]
        compiled = any("jit" in ast.unparse(d) for d in function.decorator_list)
        assert compiled or (not bare and function.returns), f"{_name(path)}: {function.name} {bare}"


@ours
def test_no_error_is_swallowed_whole(path: Path) -> None:
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.ExceptHandler):
            assert node.type is not None, f"{_name(path)}:{node.lineno} catches everything without a name"
            silent = len(node.body) == 1 and isinstance(node.body[0], ast.Pass)
            broad = ast.unparse(node.type) in {"Exception", "BaseException"}
            assert not (silent and broad), f"{_name(path)}:{node.lineno} swallows every error"


@ours
def test_public_things_say_what_they_mean(path: Path) -> None:
    tree = _tree(path)
    assert ast.get_docstring(tree), f"{_name(path)} has no docstring"
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            assert _is_plain_record(node) or ast.get_docstring(node), (
                f"{_name(path)}: {node.name} says nothing"
            )


def _is_plain_record(node: ast.AST) -> bool:
    """A class of named, typed fields and nothing else: a table of the manifest, a record of MCAP."""
    fields = (ast.AnnAssign, ast.FunctionDef)
    return isinstance(node, ast.ClassDef) and all(
        isinstance(part, fields) and not (isinstance(part, ast.FunctionDef) and not part.name.startswith("_"))
        for part in node.body
    )


def _edges(path: Path) -> set[Path]:
    """Our files that a file needs while it is being imported (imports inside functions come later)."""
    at_import = (node for node in _executed_at_import(_tree(path)))
    return {file for module in _imports(path, at_import) if (file := _file_of(module)) and file != path}


def _executed_at_import(node: ast.AST) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) or _only_for_types(child):
            continue
        yield child
        yield from _executed_at_import(child)


def _only_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def test_imports_run_without_circles() -> None:
    graph = {path: _edges(path) for path in _sources(*PACKAGES)}
    done: set[Path] = set()

    def visit(path: Path, trail: tuple[Path, ...]) -> None:
        assert path not in trail, "circle: " + " -> ".join(_name(p) for p in (*trail, path))
        if path in done:
            return
        for needed in graph[path]:
            # A shelf's __init__ lists its files; a file that reads a type beside it is no circle.
            if needed != path.parent / "__init__.py":
                visit(needed, (*trail, path))
        done.add(path)

    for path in graph:
        visit(path, ())


@pytest.mark.parametrize(("shelf", "register"), SHELVES.items())
def test_every_file_of_a_shelf_is_registered(shelf: str, register: str) -> None:
    folder = ROOT / shelf
    tree = _tree(folder / "__init__.py")
    tuples = [
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        and register
        in {ast.unparse(t) for t in (node.targets if isinstance(node, ast.Assign) else [node.target])}
    ]
    assert len(tuples) == 1, f"{shelf}/__init__.py needs one tuple {register}"
    listed = ast.unparse(tuples[0]) if tuples[0] else ""
    imported = {
        name: node.module or name
        for node in tree.body
        if isinstance(node, ast.ImportFrom)
        for name in ((alias.asname or alias.name) for alias in node.names)
    }
    modules = {imported.get(word, word) for word in re.findall(r"\w+", listed)}
    for file in folder.glob("[!_]*.py"):
        assert file.stem in modules, f"{_name(file)} is not in {register}"


def test_every_package_is_installed_by_the_project_file() -> None:
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    folders = {path.parent.relative_to(ROOT).as_posix() for path in _sources(*PACKAGES)}
    folders |= {"pipeline/templates"}  # data of the reports, no modules
    assert set(setup["package-dir"].values()) == folders
    assert set(setup["packages"]) == {"smts_validate." + folder.replace("/", ".") for folder in folders}


def test_constraints_hold_a_version_for_every_direct_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = list(project["dependencies"])
    for extra, names in project["optional-dependencies"].items():
        wanted += names if extra != "all" else []
    pinned = {
        re.sub(r"[-_.]+", "-", line.split("==")[0]).lower()
        for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
        if "==" in line
    }
    for requirement in wanted:
        name = re.sub(r"[-_.]+", "-", re.split(r"[\[<>=!~ ]", requirement)[0]).lower()
        assert name in pinned, f"{name} has no exact version in constraints.txt"


@everything
def test_nothing_is_left_open(path: Path) -> None:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        assert not re.search(r"\b(TO" r"DO|FIX" r"ME|XX" r"X|HA" r"CK)\b", line), f"{_name(path)}:{number}"
        assert not re.search(r"""["'\s=(]/(ho""" r"""me|work|root|tmp|Users)/\w""", line), (
            f"{_name(path)}:{number}"
        )


@pytest.mark.parametrize("path", _sources("tests"), ids=_name)
def test_no_test_is_skipped_but_for_absent_shared_material(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    for node in ast.walk(_tree(path)):
        name = ast.unparse(node) if isinstance(node, ast.Attribute) else ""
        assert not name.endswith("mark.xfail"), f"{_name(path)} expects a failure"
        skips = ("mark.skip", "mark.skipif", "pytest.skip", "pytest.importorskip")
        if name.endswith(skips) and path != Path(__file__):
            assert "shared" in text, f"{_name(path)} skips, and not for absent ../shared material"
