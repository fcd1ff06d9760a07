"""What is installed knows nothing of the tools that only developers run."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def imported_packages(path: Path) -> Iterator[str]:
    """Every top-level package that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.partition(".")[0]


def test_no_installed_module_imports_a_developer_tool() -> None:
    paths = [path for name in ("mlbs_actors", "orchestrator") for path in (ROOT / name).rglob("*.py")]
    assert len(paths) > 100
    for path in paths:
        assert not {"benchmark", "chaos", "tests", "scripts"} & set(imported_packages(path)), path
