"""The folder in which the machine code of compiled kernels is kept.

Numba compiles a kernel again when its own module changes, but not when a function or constant imported from
another module does. So the folder is named after a digest of the package: any change of what kernels could be
made of starts an empty one.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
from pathlib import Path

from mlbs_actors.errors import ConfigError

__all__ = ["WITHOUT_KERNELS", "compiled_mark", "has_machine_code", "machine_code_folder", "package_digest"]

_PACKAGE = Path(__file__).parents[1]
_FOLDERS = "kernels-*"

#: Folders and modules of the package that no kernel imports anything from.
WITHOUT_KERNELS = frozenset(
    {"__init__.py", "pictures", "record", "result.py", "result_log.py", "scenes", "subtractor.py"}
)

#: Folders that are kept, for the newest versions of the package.
_KEPT = 3


def has_machine_code() -> bool:
    """Whether kernels of this version of the package were compiled on this machine before."""
    return any(path.is_file() for path in machine_code_folder().rglob("*"))


def compiled_mark(part: str) -> Path:
    """Return the file that is there once a part's kernels were compiled by these versions for this CPU."""
    import llvmlite.binding
    import numba

    versions = f"{numba.__version__}-{llvmlite.binding.get_host_cpu_name()}"
    return machine_code_folder() / f"{part}-{versions}.done"


@functools.cache
def machine_code_folder() -> Path:
    """Return the folder of this version: beside the package, or in the user's cache if that is read-only.

    Raises
    ------
    ConfigError
        If neither can be written to.
    """
    name = _FOLDERS.replace("*", package_digest())
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for parent in (_PACKAGE / "__pycache__", cache / "mlbs-actors"):
        try:
            (parent / name).mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(parent / name, os.W_OK):
            _remove_old(parent)
            return parent / name
    raise ConfigError(
        f"Compiled code can be kept neither in {_PACKAGE} nor in {cache}; "
        "set XDG_CACHE_HOME to a folder that can be written to."
    )


def package_digest() -> str:
    """Hash the names and contents of all modules that kernels could depend on."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        inside = path.relative_to(_PACKAGE)
        if inside.parts[0] in WITHOUT_KERNELS:
            continue
        digest.update(f"{inside}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _remove_old(parent: Path) -> None:
    """Keep the newest folders only. A process that still uses another one recompiles what it lacks."""
    by_age = sorted(parent.glob(_FOLDERS), key=lambda folder: folder.stat().st_mtime)
    for folder in by_age[:-_KEPT]:
        shutil.rmtree(folder, ignore_errors=True)
