"""Calls that take turns: so many at once, in their order, and none is lost where one fails."""

from __future__ import annotations

from concurrent.futures import Future

import pytest

from mlbs_actors.actors.turns import Turns


class Calls:
    """Notes which calls were begun; they end when they are told to."""

    def __init__(self) -> None:
        self.begun: list[str] = []
        self.futures: dict[str, Future[str]] = {}

    def begin(self, name: str) -> Future[str]:
        self.begun.append(name)
        return self.futures.setdefault(name, Future())


def test_so_many_are_under_way_and_the_others_follow_in_their_order() -> None:
    turns, calls = Turns(2), Calls()
    answers = {name: turns.take(lambda name=name: calls.begin(name)) for name in "abcd"}  # type: ignore[misc]
    assert calls.begun == ["a", "b"]
    calls.futures["b"].set_result("B")
    assert answers["b"].result(timeout=0) == "B"
    assert calls.begun == ["a", "b", "c"]
    calls.futures["a"].set_result("A")
    calls.futures["c"].set_result("C")
    assert calls.begun == ["a", "b", "c", "d"]
    calls.futures["d"].set_result("D")
    again = turns.take(lambda: calls.begin("e"))
    assert calls.begun[-1] == "e"
    assert not again.done()


def test_one_that_fails_gives_its_turn_to_the_next() -> None:
    turns, calls = Turns(1), Calls()

    def fails() -> Future[str]:
        raise KeyError("no such stream")

    first = turns.take(lambda: calls.begin("a"))
    second, third = turns.take(fails), turns.take(lambda: calls.begin("c"))
    calls.futures["a"].set_exception(OSError("gone"))
    with pytest.raises(OSError, match="gone"):
        first.result(timeout=0)
    with pytest.raises(KeyError):
        second.result(timeout=0)
    assert calls.begun == ["a", "c"]
    calls.futures["c"].set_result("C")
    assert third.result(timeout=0) == "C"
