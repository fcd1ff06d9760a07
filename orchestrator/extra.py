"""Packages that only some installations have: those of the extra ``run``, and matplotlib for plots.

The engine needs none of them, and nearly all of this package those of ``run``.
"""

from __future__ import annotations

from importlib.util import find_spec

__all__ = ["missing_packages", "require_matplotlib", "require_run"]

_PACKAGES = ("av", "filelock", "jinja2", "PIL", "pyarrow", "pycocotools", "ray", "rich")


def missing_packages() -> list[str]:
    """Return the names of the modules of the extra that are not installed."""
    return [name for name in _PACKAGES if find_spec(name) is None]


def require_run() -> None:
    """Raise MissingPackageError, which is an ImportError, unless the extra is installed."""
    if missing := missing_packages():
        from mlbs_actors.errors import MissingPackageError

        raise MissingPackageError(
            f"Packages are missing that a run needs ({', '.join(missing)}); pip install 'mlbs-actors[run]'."
        )


def require_matplotlib() -> None:
    """Raise ConfigError if there is no matplotlib for ``--plots``, before anything is computed."""
    if find_spec("matplotlib") is None:
        from mlbs_actors.errors import ConfigError

        raise ConfigError(
            "--plots needs matplotlib; install it with scripts/setup bench, or as the extra bench of "
            "the wheel."
        )
