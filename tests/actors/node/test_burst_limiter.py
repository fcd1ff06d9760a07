"""Calls that take limiter: so many at once, in their order, and none is lost where one fails."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import ClassVar

import pytest

from mlbs_actors.actors.node.burst_limiter import BurstLimiter


class Calls:
    """Notes which calls were begun; they end when they are told to."""

    def __init__(self) -> None:
        self.begun: list[str] = []
        self.futures: dict[str, Future[str]] = {}

    def begin(self, name: str) -> Future[str]:
        self.begun.append(name)
        return self.futures.setdefault(name, Future())


def test_so_many_are_under_way_and_the_others_follow_in_their_order() -> None:
    limiter, calls = BurstLimiter(2, 60.0), Calls()
    answers = {name: limiter.submit(lambda name=name: calls.begin(name)) for name in "abcd"}  # type: ignore[misc]
    assert calls.begun == ["a", "b"]
    calls.futures["b"].set_result("B")
    assert answers["b"].result(timeout=0) == "B"
    assert calls.begun == ["a", "b", "c"]
    calls.futures["a"].set_result("A")
    calls.futures["c"].set_result("C")
    assert calls.begun == ["a", "b", "c", "d"]
    calls.futures["d"].set_result("D")
    again = limiter.submit(lambda: calls.begin("e"))
    assert calls.begun[-1] == "e"
    assert not again.done()


def test_who_has_to_wait_is_told_so_before_it_begins() -> None:
    limiter, calls = BurstLimiter(1, 60.0), Calls()
    limiter.submit(lambda: calls.begin("a"), lambda: calls.begun.append("a waits"))
    limiter.submit(lambda: calls.begin("b"), lambda: calls.begun.append("b waits"))
    calls.futures["a"].set_result("A")
    assert calls.begun == ["a", "b waits", "b"]


def test_one_that_fails_gives_its_turn_to_the_next() -> None:
    limiter, calls = BurstLimiter(1, 60.0), Calls()

    def fails() -> Future[str]:
        raise KeyError("no such stream")

    first = limiter.submit(lambda: calls.begin("a"))
    second, third = limiter.submit(fails), limiter.submit(lambda: calls.begin("c"))
    calls.futures["a"].set_exception(OSError("gone"))
    with pytest.raises(OSError, match="gone"):
        first.result(timeout=0)
    with pytest.raises(KeyError):
        second.result(timeout=0)
    assert calls.begun == ["a", "c"]
    calls.futures["c"].set_result("C")
    assert third.result(timeout=0) == "C"


class Patience:
    """A timer that goes off when it is told to."""

    started: ClassVar[list[Patience]] = []

    def __init__(self, seconds: float, go_off: Callable[[], None]) -> None:
        self.seconds, self.go_off = seconds, go_off
        self.cancelled = self.daemon = False

    def start(self) -> None:
        self.started.append(self)

    def cancel(self) -> None:
        self.cancelled = True


def test_one_that_lasts_too_long_keeps_nobody_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mlbs_actors.actors.node.burst_limiter.Timer", Patience)
    monkeypatch.setattr(Patience, "started", [])
    limiter, calls = BurstLimiter(1, 3.0), Calls()
    answers = [limiter.submit(lambda name=name: calls.begin(name)) for name in "abc"]  # type: ignore[misc]
    late, prompt = Patience.started[0], answers[1]
    assert late.seconds == 3.0
    assert late.daemon
    late.go_off()
    assert calls.begun == ["a", "b"]
    # Its turn is another's by now, and not given on again.
    calls.futures["a"].set_result("A")
    assert answers[0].result(timeout=0) == "A"
    assert calls.begun == ["a", "b"]
    calls.futures["b"].set_result("B")
    assert prompt.result(timeout=0) == "B"
    assert Patience.started[1].cancelled
    assert calls.begun == ["a", "b", "c"]
