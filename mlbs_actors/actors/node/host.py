"""What actors run on: Ray, behind the few calls that this package makes of it.

An actor's methods are called as Ray has them (``handle.method.remote(...)``), and its failures are Ray's
exceptions. All else that depends on who runs the actors is in :class:`Host`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from mlbs_actors.actors.node.reservation import Reservation

__all__ = ["Handle", "Host", "RayHost", "Reference", "ask"]

#: An actor's handle; its methods are made at run time, so it has no static type.
Handle: TypeAlias = Any

#: Reference to the answer of a call; its type is known where it is created.
Reference: TypeAlias = "ray.ObjectRef[Any]"


class Host(Protocol):
    """Runs actors, each apart from all others."""

    def spawn(
        self,
        kind: type,
        arguments: Sequence[object],
        *,
        node: str,
        reservation: Reservation | None,
        name: str | None,
    ) -> Handle:
        """Start an actor; see :func:`mlbs_actors.actors.node.processes.spawn`."""

    def get(self, reference: Reference, timeout: float | None) -> Any:
        """Wait for an answer, for at most this time, s; raises the error of the call, or GetTimeoutError."""

    def wait(
        self, references: Sequence[Reference], least: int, timeout: float | None
    ) -> tuple[list[Reference], list[Reference]]:
        """Wait for some answers, for at most this time, s; return those that are there, and the others."""

    def is_there(self) -> bool:
        """Whether it still runs actors; without it none is left, and none of its calls may be made."""

    def kill(self, handle: Handle) -> None:
        """End an actor whatever it is doing, without waiting for it."""

    def identity(self, handle: Handle) -> str:
        """Return an actor's id, which errors about it contain."""

    def here(self) -> str:
        """Return the id of the node of the calling process."""

    def cores(self, node: str) -> int:
        """Return the number of a node's cores."""


class RayHost:
    """Runs each actor in a process of its own, in the present Ray session."""

    def spawn(
        self,
        kind: type,
        arguments: Sequence[object],
        *,
        node: str,
        reservation: Reservation | None,
        name: str | None,
    ) -> Handle:
        """Start an actor, without Ray's own restarts and retries.

        A restarted actor would be an empty one, and a retried call could feed a frame to a model twice.
        """
        actor: Handle = ray.remote(num_cpus=0, max_restarts=0, max_task_retries=0)(kind)
        options: dict[str, object] = {"scheduling_strategy": _there_or_nowhere(node), "name": name}
        if reservation is not None:
            options |= reservation.options()
        return actor.options(**options).remote(*arguments)

    def get(self, reference: Reference, timeout: float | None) -> Any:
        """See :meth:`Host.get`."""
        return ray.get(reference, timeout=timeout)

    def wait(
        self, references: Sequence[Reference], least: int, timeout: float | None
    ) -> tuple[list[Reference], list[Reference]]:
        """See :meth:`Host.wait`."""
        return ray.wait(list(references), num_returns=least, timeout=timeout)

    def is_there(self) -> bool:
        """Whether there is a session: without one, any call of Ray's would set up or join another."""
        return bool(ray.is_initialized())

    def kill(self, handle: Handle) -> None:
        """See :meth:`Host.kill`."""
        ray.kill(handle)

    def identity(self, handle: Handle) -> str:
        """See :meth:`Host.identity`."""
        return str(handle._actor_id.hex())

    def here(self) -> str:
        """See :meth:`Host.here`."""
        return str(ray.get_runtime_context().get_node_id())

    def cores(self, node: str) -> int:
        """Return the cores of a node, as Ray counts them."""
        nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
        return int(next(one["Resources"].get("CPU", 1) for one in nodes if one["NodeID"] == node))


def ask(call: Callable[[], object], *, node: str) -> Reference:
    """Call a picklable function once in some process of Ray's on a node; return at once."""
    task: Handle = ray.remote(num_cpus=0, max_retries=0)(_called)
    answer: Reference = task.options(scheduling_strategy=_there_or_nowhere(node)).remote(call)
    return answer


def _called(call: Callable[[], object]) -> object:
    return call()


def _there_or_nowhere(node: str) -> NodeAffinitySchedulingStrategy:
    return NodeAffinitySchedulingStrategy(node_id=node, soft=False)
