"""The documentation imports public names only, and importing a package is quick."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])

#: Modules whose names programs may import; the packages say so themselves.
PUBLIC = (
    "mlbs_actors",
    "mlbs_actors.pictures",
    "mlbs_actors.record",
    "mlbs_actors.scenes",
    "orchestrator",
    "orchestrator.evaluation",
)


def own_imports(code: str) -> set[tuple[str, str]]:
    """The modules of this project that a block imports, each with a name from it, or an empty one."""
    found = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            found |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {(node.module, alias.name) for alias in node.names}
    return {
        (module, name) for module, name in found if module.split(".")[0] in ("mlbs_actors", "orchestrator")
    }


def test_the_documentation_imports_public_names_only() -> None:
    blocks = 0
    for page in PAGES:
        for code in re.findall(
            r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
        ):
            blocks += 1
            for module, name in own_imports(code):
                assert module in PUBLIC, (page.name, module)
                public = importlib.import_module(module)
                assert not name or name in public.__all__ or f"{module}.{name}" in PUBLIC, (
                    page.name,
                    module,
                    name,
                )
    assert blocks > 20


@pytest.mark.parametrize("module", PUBLIC)
def test_a_public_module_gives_out_what_it_lists(module: str) -> None:
    public = importlib.import_module(module)
    assert all(hasattr(public, name) for name in public.__all__)
    assert not hasattr(public, "nothing")
    listed = (public.__doc__ or "").replace("``", " ")
    if module in ("mlbs_actors", "mlbs_actors.record", "orchestrator", "orchestrator.evaluation"):
        assert all(re.search(rf"\b{name}\b", listed) for name in public.__all__), module


@pytest.mark.parametrize("package", ["mlbs_actors", "orchestrator"])
def test_importing_a_package_loads_no_part_of_it_that_takes_long(package: str) -> None:
    heavy = {"numba", "scipy", "ray", "pyarrow", "av", "supervision"}
    code = f"import sys, {package}; print(*({heavy!r} & set(sys.modules)))"
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        == "\n"
    )
