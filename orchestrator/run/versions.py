"""The versions that label maps depend on."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

import cv2

from mlbs_actors.kernels.machine_code import package_digest

__all__ = ["installed_versions"]

_PACKAGES = ("mlbs-actors", "ray", "numpy", "scipy", "PyMaxflow", "numba", "av")


def installed_versions() -> dict[str, str | None]:
    """Return the versions of Python, the packages and the engine's source; None for what is not installed."""
    return {
        "python": platform.python_version(),
        "source": package_digest(),
        "opencv": cv2.__version__,  # of whichever of its packages
        **{name: _version(name) for name in _PACKAGES},
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
