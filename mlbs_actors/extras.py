"""Packages that are installed with an extra only."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mlbs_actors.errors import MissingPackageError

__all__ = ["needing"]


@contextmanager
def needing(extra: str) -> Iterator[None]:
    """Import, in the ``with`` block, packages of an extra.

    Raises
    ------
    MissingPackageError
        If one of them is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            f"There is no module {error.name!r}; install what this needs: pip install 'mlbs-actors[{extra}]'."
        ) from None
