"""What the autoscaler is told that runs need: never for longer than they live."""

from __future__ import annotations

import pytest
import ray
from actor_fakes import wait_until

from mlbs_actors.actors.node.demand import ACTOR_NAME, NAMESPACE, Bundle, Demand, DemandLedger
from mlbs_actors.actors.node.processes import here

A_CPU: Bundle = {"CPU": 1, "memory": 100}


@pytest.fixture
def now() -> list[float]:
    return [0.0]


@pytest.fixture
def requests() -> list[list[Bundle]]:
    return []


@pytest.fixture
def ledger(now: list[float], requests: list[list[Bundle]]) -> DemandLedger:
    return DemandLedger(requests.append, lease=60.0, clock=lambda: now[0])


def test_the_needs_of_all_runs_are_added_up(ledger: DemandLedger, requests: list[list[Bundle]]) -> None:
    ledger.renew("a", [A_CPU] * 2)
    ledger.renew("b", [A_CPU])
    ledger.renew("a", [A_CPU])
    assert [len(one) for one in requests] == [2, 3, 2]


def test_a_need_that_is_the_same_is_requested_once(
    ledger: DemandLedger, now: list[float], requests: list[list[Bundle]]
) -> None:
    for now[0] in range(0, 600, 10):
        ledger.renew("a", [A_CPU])
        assert ledger.look()
    assert requests == [[A_CPU]]


def test_the_need_of_a_run_that_is_silent_is_withdrawn_and_that_of_others_stays(
    ledger: DemandLedger, now: list[float], requests: list[list[Bundle]]
) -> None:
    ledger.renew("killed", [A_CPU] * 4)
    now[0] = 50.0
    ledger.renew("alive", [A_CPU])
    assert ledger.look()
    now[0] = 61.0
    assert ledger.look()
    assert requests[-1] == [A_CPU]
    now[0] = 111.0
    assert not ledger.look()
    assert requests[-1] == []


def test_a_run_that_ends_needs_nothing_more(ledger: DemandLedger, requests: list[list[Bundle]]) -> None:
    ledger.renew("a", [A_CPU])
    ledger.renew("a", [])
    assert requests == [[A_CPU], []]
    assert not ledger.look()


def test_what_an_earlier_ledger_has_left_is_withdrawn(
    ledger: DemandLedger, requests: list[list[Bundle]]
) -> None:
    assert not ledger.look()
    assert requests == [[]]


def is_there() -> bool:
    try:
        ray.get_actor(ACTOR_NAME, namespace=NAMESPACE)
    except ValueError:
        return False
    return True


@pytest.mark.ray
@pytest.mark.usefixtures("ray_session")
def test_what_tells_the_autoscaler_ends_after_the_last_run_and_is_there_again_for_the_next() -> None:
    if is_there():  # of another test, with another lease
        ray.kill(ray.get_actor(ACTOR_NAME, namespace=NAMESPACE))
        wait_until(lambda: not is_there())
    killed = Demand(here(), lease=1.0)
    killed.tell([A_CPU] * 3)
    wait_until(is_there)
    wait_until(lambda: not is_there())
    run = Demand(here(), lease=600.0)
    run.tell([A_CPU] * 2)
    wait_until(is_there)
    ray.kill(ray.get_actor(ACTOR_NAME, namespace=NAMESPACE))
    wait_until(lambda: not is_there())
    cpus = iter(range(1, 10_000))

    def told_again() -> bool:
        run.tell([A_CPU] * next(cpus))
        return is_there()

    wait_until(told_again)
    run.end()
    ray.kill(ray.get_actor(ACTOR_NAME, namespace=NAMESPACE))
