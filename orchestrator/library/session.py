"""The Ray session of a program's run: the program's own, a cluster that is joined, or one that is started."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from mlbs_actors.errors import ConfigError
from orchestrator.ray_session import joined_ray, ray_session, ray_settings

__all__ = ["present_ray"]


@contextmanager
def present_ray(address: str | None) -> Iterator[bool]:
    """Take part in a Ray session while the ``with`` block runs; one that exists stays as it is.

    Parameters
    ----------
    address : str, optional
        Of a cluster to join, ``HOST:PORT`` or ``auto``.

    Yields
    ------
    bool
        Whether others may use the session, too.

    Raises
    ------
    ConfigError
        If there is a session and an address is given, Ray is imported and there is neither, or the cluster
        cannot be joined.
    """
    if "ray" in sys.modules:
        import ray

        if ray.is_initialized():
            if address is not None:
                raise ConfigError("This program has a Ray session, which is used; leave out address.")
            yield True
        elif address is None:
            raise ConfigError(
                "Ray is imported, but there is no session: call ray.init() before, give an address, or start "
                "before Ray is imported, so that a session of this run's own can be set up."
            )
        else:
            with joined_ray(address, None):
                yield True
        return
    with ray_settings(address) as scratch, ray_session(address, scratch):
        yield address is not None
