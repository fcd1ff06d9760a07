"""Results from their offer to their taking: each once and in order, whatever is lost in between."""

from __future__ import annotations

import asyncio
import pickle
from collections.abc import Awaitable, Callable, Iterator
from typing import TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mlbs_actors.errors import SinkError
from orchestrator.library.result_queue import Numbered, ResultQueue

Answer = TypeVar("Answer")


def asked(question: Callable[[ResultQueue], Awaitable[Answer]]) -> Answer:
    """Ask a new queue."""

    async def ask() -> Answer:
        return await question(ResultQueue())

    return asyncio.run(ask())


def numbered(numbers: Iterator[int] | range) -> list[Numbered]:
    return [(number, pickle.dumps(number)) for number in numbers]


async def taken(queue: ResultQueue) -> list[object]:
    """Take what is there, as a program receives it."""
    return [pickle.loads(pickle.dumps(one)) for one in await queue.take(1000, 0.0)]


def test_results_are_there_once_they_are_committed_in_order() -> None:
    async def question(queue: ResultQueue) -> tuple[list[object], list[object]]:
        start = await queue.open("a", 0)
        await queue.offer("a", start, numbered(range(8)))
        before = await taken(queue)
        await queue.settle("a", start, 5)
        return before, await taken(queue)

    assert asked(question) == ([], [0, 1, 2, 3, 4])


def test_a_stream_that_goes_back_says_the_rest_again_and_nothing_comes_twice() -> None:
    async def question(queue: ResultQueue) -> list[object]:
        first = await queue.open("a", 0)
        await queue.offer("a", first, numbered(range(12)))
        await queue.settle("a", first, 8)
        second = await queue.open("a", 4)  # its snapshot is older than what was committed
        await queue.offer("a", second, numbered(range(4, 16)))
        await queue.settle("a", second, 16)
        return await taken(queue)

    assert asked(question) == list(range(16))


def test_what_was_committed_just_before_a_loss_is_not_lost() -> None:
    async def question(queue: ResultQueue) -> list[object]:
        first = await queue.open("a", 0)
        await queue.offer("a", first, numbered(range(8)))
        await queue.open("a", 8)  # the process was lost between the commit and its word of that
        return await taken(queue)

    assert asked(question) == list(range(8))


def test_a_start_that_is_over_cannot_say_anything_any_more() -> None:
    async def question(queue: ResultQueue) -> list[object]:
        first = await queue.open("a", 0)
        await queue.open("a", 0)
        with pytest.raises(SinkError, match="started again"):
            await queue.offer("a", first, numbered(range(1)))
        return await taken(queue)

    assert asked(question) == []


def test_names_of_those_that_wait_come_in_the_order_of_their_commits() -> None:
    async def question(queue: ResultQueue) -> list[str]:
        for name in ("b", "a"):
            start = await queue.open(name, 0)
            await queue.offer(name, start, numbered(range(2)))
            await queue.settle(name, start, 2)
        return await queue.ready(0.0)

    assert asked(question) == ["b", "b", "a", "a"]


@given(st.lists(st.tuples(st.integers(1, 6), st.integers(0, 3), st.integers(0, 4)), max_size=12))
def test_every_number_comes_once_wherever_a_process_is_lost(deaths: list[tuple[int, int, int]]) -> None:
    """A group is offered, committed and settled; deaths say after which of these, and how far back."""

    async def question(queue: ResultQueue) -> tuple[list[object], int]:
        committed = 0
        start = await queue.open("a", 0)
        for size, step, back in deaths:
            goal = committed + size
            await queue.offer("a", start, numbered(range(committed, goal)))
            if step >= 1:
                committed = goal
            if step >= 2:
                await queue.settle("a", start, committed)
            if step < 3:  # lost; its snapshot may be older than its record
                said = max(committed - back, 0) if step != 1 else committed
                start = await queue.open("a", said)
                await queue.offer("a", start, numbered(range(said, committed)))
                await queue.settle("a", start, committed)
        return await taken(queue), committed

    results, committed = asked(question)
    assert results == list(range(committed))
