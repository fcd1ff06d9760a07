"""Actors are started, asked and ended alike, whatever runs them."""

from __future__ import annotations

import asyncio
import os
from dataclasses import dataclass

import pytest
from actor_fakes import wait_until
from ray.exceptions import GetTimeoutError
from thread_host import die, hang

from mlbs_actors.actors.ipc.channels import ChannelAddress, ChannelClosedError, ChannelListener, connect
from mlbs_actors.actors.node.failures import cause_of
from mlbs_actors.actors.node.host import Handle
from mlbs_actors.actors.node.processes import (
    LOST_PROCESS,
    end,
    get,
    here,
    identity,
    is_answered,
    kill,
    spawn,
    wait,
)


@dataclass
class Counter:
    """An actor that counts, and does as it is told."""

    count: int = 0

    def add(self, number: int) -> int:
        self.count += number
        return self.count

    def divide(self, by: int) -> float:
        return self.count / by

    def listen(self) -> ChannelAddress:
        self.channel = ChannelListener()
        return self.channel.address

    def serve(self) -> None:
        self.channel.serve(lambda message: [message + 1])

    def hang(self) -> None:
        hang()

    def die(self) -> None:
        die()


class Starter:
    """An asynchronous actor that starts another one."""

    async def start(self) -> Handle:
        self.started = spawn(Counter, node=here())
        return self.started

    async def add(self, number: int) -> int:
        added: int = await self.started.add.remote(number)
        return added

    async def never(self) -> None:
        await asyncio.Event().wait()


class Unable:
    def __init__(self) -> None:
        raise ValueError("not today")


def test_calls_are_answered_in_their_order_and_can_be_given_answers_of_others(host: str) -> None:
    counter, other = spawn(Counter, 5, node=here()), spawn(Counter, node=here())
    answers = [counter.add.remote(number) for number in (1, 2, other.add.remote(10))]
    assert [get(answer) for answer in answers] == [6, 8, 18]
    assert end([counter, other])


def test_an_error_is_raised_by_the_call_that_had_it_and_the_actor_goes_on(host: str) -> None:
    counter = spawn(Counter, 1, node=here())
    failed, there = counter.divide.remote(0), counter.add.remote(1)
    with pytest.raises(ZeroDivisionError) as caught:
        get(failed)
    assert type(cause_of(caught.value)) is ZeroDivisionError
    assert get(there) == 2
    assert end([counter])


def test_an_actor_that_cannot_start_is_lost_and_says_why(host: str) -> None:
    with pytest.raises(LOST_PROCESS, match="not today"):
        get(spawn(Unable, node=here()).__ray_ready__.remote())


def test_an_actor_that_dies_fails_its_calls_under_its_identity(host: str) -> None:
    counter = spawn(Counter, node=here())
    dying, later = counter.die.remote(), counter.add.remote(1)
    for lost in (dying, later):
        with pytest.raises(LOST_PROCESS) as caught:
            get(lost)
        assert vars(caught.value)["actor_id"] == identity(counter)


def test_one_that_hangs_keeps_its_callers_waiting_until_it_is_ended(host: str) -> None:
    counter = spawn(Counter, node=here())
    get(counter.add.remote(1))
    hanging = counter.hang.remote()
    with pytest.raises(GetTimeoutError):
        get(hanging, 0.05)
    assert wait([hanging], timeout=0.0) == ([], [hanging])
    kill(counter)
    wait_until(lambda: is_answered(hanging))
    assert end([counter])
    with pytest.raises(LOST_PROCESS):
        get(hanging)


def test_the_other_end_of_a_channel_learns_that_an_actor_was_ended_while_it_waited(host: str) -> None:
    counter = spawn(Counter, node=here())
    address = get(counter.listen.remote())
    served = counter.serve.remote()
    with connect(address) as channel:
        channel.send(1)
        assert channel.receive() == 2
        kill(counter)
        with pytest.raises(ChannelClosedError):
            channel.receive()
    with pytest.raises(LOST_PROCESS):
        get(served)
    assert (address.owner == os.getpid()) == (host == "threads")


def test_an_asynchronous_actor_answers_others_while_one_call_waits_and_takes_along_what_it_started(
    host: str,
) -> None:
    starter = spawn(Starter, node=here())
    started, waiting = get(starter.start.remote()), starter.never.remote()
    assert get(starter.add.remote(3)) == get(started.add.remote(0)) == 3
    assert not is_answered(waiting)
    assert end([starter])
    with pytest.raises(LOST_PROCESS):
        get(started.hang.remote(), 180.0)
