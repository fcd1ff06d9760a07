"""What the runs on a cluster need, told to Ray's autoscaler as long as they live.

The autoscaler remembers one request for the whole cluster until another one replaces it, even when the
program that made it was killed. So an actor of the cluster makes it, one for all runs: it adds up what they
need, and forgets a run that has not renewed its need for a while.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeAlias

import ray
from ray.exceptions import GetTimeoutError, RayError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from mlbs_actors.actors.node.host import Handle, Reference

__all__ = ["ACTOR_NAME", "NAMESPACE", "Bundle", "Demand", "DemandLedger"]

#: Resources that should be free together on some node.
Bundle: TypeAlias = "dict[str, float]"

#: Where the actor is found by all runs of a cluster.
NAMESPACE = "mlbs-actors"
ACTOR_NAME = "demand of all runs"

#: How long a run's need counts after it was last told, s, and how often it is told.
_LEASE_SECONDS = 60.0
_RENEWAL_SECONDS = 10.0

#: How long the end of a run waits until its need is withdrawn, s.
_END_SECONDS = 5.0


class DemandLedger:
    """Adds up the needs of runs, and forgets those that are not renewed.

    Parameters
    ----------
    request : callable
        Receives the bundles of all runs whenever they change, and at the first look, as an earlier ledger
        may have left others.
    lease : float
        How long a need counts, s.
    clock : callable
        Monotonic time, s.
    """

    def __init__(
        self,
        request: Callable[[list[Bundle]], object],
        lease: float = _LEASE_SECONDS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._request = request
        self._lease = lease
        self._clock = clock
        self._needs: dict[str, tuple[float, list[Bundle]]] = {}
        self._requested: list[Bundle] | None = None

    def renew(self, run: str, bundles: Sequence[Bundle]) -> None:
        """Take down what a run needs from now on; nothing: it has ended."""
        self._needs.pop(run, None)
        if bundles:
            self._needs[run] = self._clock() + self._lease, list(bundles)
        self.look()

    def look(self) -> bool:
        """Forget runs that are late; return whether any is left."""
        now = self._clock()
        self._needs = {run: need for run, need in self._needs.items() if need[0] > now}
        wanted = [bundle for _, bundles in self._needs.values() for bundle in bundles]
        if wanted != self._requested:
            self._request(wanted)
            self._requested = wanted
        return bool(self._needs)


class _DemandActor:
    """A ledger with a clock of its own; ends when no run has needed anything for the time of a lease."""

    def __init__(self, lease: float) -> None:
        from ray.autoscaler.sdk import request_resources  # slow to import, for clusters only

        self._ledger = DemandLedger(lambda bundles: request_resources(bundles=bundles), lease)
        self._lease = lease
        self._changing = threading.Lock()
        threading.Thread(target=self._watch, daemon=True).start()

    def renew(self, run: str, bundles: list[Bundle]) -> None:
        """See :meth:`DemandLedger.renew`."""
        with self._changing:
            self._ledger.renew(run, bundles)

    def _watch(self) -> None:
        idle = 0
        while idle < 2:
            time.sleep(self._lease / 2)
            with self._changing:
                idle = 0 if self._ledger.look() else idle + 1
        ray.kill(ray.get_runtime_context().current_actor)


class Demand:
    """The need of one run; told at once when it changes, and renewed by every call that comes in time.

    Parameters
    ----------
    node : str
        The driver's own, where the actor is started if there is none yet.
    lease : float
        How long the need counts if the run is killed, s.
    """

    def __init__(self, node: str, lease: float = _LEASE_SECONDS) -> None:
        self._node = node
        self._lease = lease
        self._run = secrets.token_hex(8)
        self._actor: Handle | None = None
        self._told: list[Bundle] = []
        self._told_at = float("-inf")
        self._answer: Reference | None = None

    def tell(self, bundles: Sequence[Bundle]) -> None:
        """Say what the run needs now; returns at once."""
        now = time.monotonic()
        if list(bundles) == self._told and (not bundles or now - self._told_at < _RENEWAL_SECONDS):
            return
        if self._actor is None or self._is_lost():
            self._actor = self._found()
        self._told, self._told_at = list(bundles), now
        self._answer = self._actor.renew.remote(self._run, self._told)

    def end(self) -> None:
        """Withdraw the need, and wait a moment until that is done."""
        self.tell([])
        if self._answer is not None:
            with suppress(RayError, GetTimeoutError):  # such as a cluster that has ended
                ray.get(self._answer, timeout=_END_SECONDS)

    def _is_lost(self) -> bool:
        """Whether the actor is gone: its node was lost, or it ended while no run needed anything."""
        if self._answer is None:
            return False
        there, _ = ray.wait([self._answer], timeout=0)
        try:
            ray.get(there)
        except RayError:
            return True
        return False

    def _found(self) -> Handle:
        # Restarted elsewhere if its node is lost, so that the request cannot outlive the last run.
        actor: Handle = ray.remote(num_cpus=0, max_restarts=-1)(_DemandActor)
        return actor.options(
            name=ACTOR_NAME,
            namespace=NAMESPACE,
            lifetime="detached",
            get_if_exists=True,
            scheduling_strategy=NodeAffinitySchedulingStrategy(self._node, soft=True),
        ).remote(self._lease)
