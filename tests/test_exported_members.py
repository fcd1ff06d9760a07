"""Every public name has one home, and the package gives out what a user needs and no more."""

from __future__ import annotations

import ast
import importlib
import importlib.metadata
import inspect
import pkgutil
import pydoc
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

import mlbs_actors
from mlbs_actors.kernels.machine_code import WITHOUT_KERNELS

PACKAGE = Path(mlbs_actors.__file__).parent
PLAIN_MODULES = sorted(
    found.name for found in pkgutil.walk_packages(mlbs_actors.__path__, "mlbs_actors.") if not found.ispkg
)


def public_definitions(module: ModuleType) -> set[str]:
    """Classes and functions that a module defines itself."""
    return {
        name
        for name, member in vars(module).items()
        if not name.startswith("_")
        and (inspect.isclass(member) or inspect.isfunction(member))
        and member.__module__ == module.__name__
    }


def imported_modules(path: Path) -> set[str]:
    """Every module that a file imports, wherever in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    return names


def test_the_package_gives_out_what_it_lists_and_nothing_else() -> None:
    imported = {
        name
        for name, member in vars(mlbs_actors).items()
        if not name.startswith("_") and not isinstance(member, ModuleType)
    }
    assert imported - {"TYPE_CHECKING"} <= set(mlbs_actors.__all__)
    assert all(hasattr(mlbs_actors, name) for name in mlbs_actors.__all__)
    assert not hasattr(mlbs_actors, "nothing")
    assert mlbs_actors.__version__ == importlib.metadata.version("mlbs-actors")


def test_help_and_dir_begin_with_what_a_program_needs() -> None:
    first, contents, _ = pydoc.plain(pydoc.render_doc(mlbs_actors)).partition("PACKAGE CONTENTS")
    assert contents
    assert all(f"``{name}``" in first for name in mlbs_actors.__all__)
    assert [name for name in dir(mlbs_actors) if not name.startswith("_")] == sorted(mlbs_actors.__all__)


def test_a_process_that_runs_no_part_of_the_engine_does_not_load_it() -> None:
    code = "import sys, mlbs_actors.actors.pipeline; sys.exit(bool({'numba', 'scipy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_module_lists_the_names_it_defines() -> None:
    for name in PLAIN_MODULES:
        module = importlib.import_module(name)
        listed = module.__all__
        assert len(set(listed)) == len(listed), name
        assert public_definitions(module) <= set(listed), name
        assert all(hasattr(module, member) for member in listed), name


def test_no_name_is_exported_by_two_modules() -> None:
    homes: dict[str, list[str]] = {}
    for name in PLAIN_MODULES:
        for member in importlib.import_module(name).__all__:
            homes.setdefault(member, []).append(name)
    assert {member: names for member, names in homes.items() if len(names) > 1} == {}


def test_what_the_package_gives_out_is_exported_by_the_module_that_defines_it() -> None:
    for member in mlbs_actors.__all__:
        home = importlib.import_module(getattr(mlbs_actors, member).__module__)
        assert member in home.__all__
        assert getattr(home, member) is getattr(mlbs_actors, member)


def test_only_the_actors_import_ray_and_nothing_here_imports_the_orchestrator() -> None:
    paths = sorted(PACKAGE.rglob("*.py"))
    assert len(paths) > 20
    for path in paths:
        tops = {name.split(".")[0] for name in imported_modules(path)}
        assert "orchestrator" not in tops, path.name
        if PACKAGE / "actors" not in path.parents:
            assert "ray" not in tops, path.name
            assert not any(name.startswith("mlbs_actors.actors") for name in imported_modules(path)), path


def test_folders_of_the_engine_import_each_other_in_one_direction_only() -> None:
    below: dict[str, set[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        folder, *inside = path.relative_to(PACKAGE).parts
        if inside:
            named = (name.split(".") for name in imported_modules(path) if name.startswith("mlbs_actors."))
            below.setdefault(folder, set()).update(name[1] for name in named)
    folders = {one: {other for other in below[one] & below.keys() if other != one} for one in below}
    assert len(folders) > 8
    list(TopologicalSorter(folders).static_order())  # raises CycleError, which names the circle


def test_no_kernel_depends_on_what_its_machine_code_is_not_named_after() -> None:
    imported = {path: imported_modules(path) for path in PACKAGE.rglob("*.py")}
    homes = {".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts): path for path in imported}
    homes |= {name.removesuffix(".__init__"): path for name, path in homes.items()}
    reached: set[Path] = set()
    ahead = [path for path, names in imported.items() if "mlbs_actors.kernels.jit" in names]
    assert len(ahead) > 20
    while ahead:
        path = ahead.pop()
        if path not in reached:
            reached.add(path)
            ahead += [homes[name] for name in imported[path] if name in homes]
    first_parts = {path.relative_to(PACKAGE).parts[0] for path in reached}
    assert not first_parts & WITHOUT_KERNELS
    assert {path.relative_to(PACKAGE).parts[0] for path in imported} >= WITHOUT_KERNELS


def test_what_needs_no_streams_is_imported_without_any_extra() -> None:
    code = """
import sys

for package in ("av", "filelock", "jinja2", "PIL", "pyarrow", "pycocotools", "ray", "rich"):
    sys.modules[package] = None
from mlbs_actors import MissingPackageError, pictures, record, scenes

try:
    record.recorded_stream("out")
except MissingPackageError as error:
    assert "pip install 'mlbs-actors[read]'" in str(error)
else:
    sys.exit("it was read without pyarrow")
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("opencv", "words"),
    [("None", "pip install opencv-python-headless"), ("types.SimpleNamespace(__version__='4.9.0')", "4.10")],
)
def test_without_a_fitting_opencv_the_import_says_what_to_do(opencv: str, words: str) -> None:
    code = f"import sys, types; sys.modules['cv2'] = {opencv}; import mlbs_actors"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    last_line = ended.stderr.splitlines()[-1]
    assert last_line.startswith("ImportError: mlbs_actors needs OpenCV")
    assert words in last_line


def test_the_engine_runs_without_ray() -> None:
    code = "import sys, mlbs_actors.subtractor; sys.exit('ray' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
