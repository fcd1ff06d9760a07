"""Which streams start, and what those that wait are told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from mlbs_actors.actors.node.memory import NodeMemory
from orchestrator.run.admission import (
    Admission,
    by_count,
    by_load,
    cores,
    places,
    places_by_memory,
)
from orchestrator.run.need import PLACE_BYTES
from orchestrator.run.stream_state import StreamState, after_start

GIB = 2**30
PLENTY = NodeMemory(64 * GIB, 60 * GIB)


def started(admission: Admission, states: Sequence[StreamState]) -> list[str]:
    """Start streams until the rest has to wait; return the names of those that did."""
    names: list[str] = []
    states = list(states)
    while name := admission(states, ()).start:
        names.append(name)
        states = [after_start(state) if state.name == name else state for state in states]
    return names


def camera(name: str, cores: float = 0.0, memory: int = 0) -> StreamState:
    return StreamState(name, "running" if cores else "waiting", live=True, cores=cores, memory=memory)


def waiting(count: int) -> list[StreamState]:
    return [camera(f"w{number}") for number in range(count)]


def test_a_stream_that_waits_is_told_of_all_places_though_some_are_not_to_be_had_yet() -> None:
    admit = by_count(lambda waiting: 1, "places of the nodes", lambda: 6)
    states = [StreamState("first", "running"), StreamState("second")]
    verdict = admit(states, [])
    assert verdict.start is None
    assert verdict.waits_for(states[1]) == "one of the 6 places of the nodes, which are taken"


def test_only_streams_with_processes_hold_places() -> None:
    states = [StreamState("a", "running"), StreamState("b", "done"), *map(StreamState, "cde")]
    assert started(by_count(3), states) == ["c", "d"]
    assert by_count(3)(states, ["b"]).start == "c"
    assert by_count(2)(states, ["b"]).start is None  # its processes are not gone yet
    assert by_count(1)(states, ()).waits_for(states[2]) == "one of the 1 places, which are taken"


def test_cameras_begin_as_many_as_files_and_more_follow_when_it_is_known_what_they_take() -> None:
    admission = by_load(2, 4, lambda: PLENTY)
    assert started(admission, waiting(10)) == ["w0", "w1", "w2", "w3"]
    running = [camera(f"r{number}", 0.15, GIB) for number in range(4)]
    assert len(started(admission, [*running, *waiting(6)])) == 6
    # Those that start are taken for what the others take.
    assert len(started(admission, [*running, *waiting(20)])) == 6
    verdict = admission([camera(f"r{number}", 0.15, GIB) for number in range(10)] + waiting(1), ())
    assert verdict.start is None
    assert verdict.cameras_wait_for == (
        "CPU time: 10 streams take 1.7 of 2 cores, and another one would take 0.17; a tenth stays free"
    )


def test_cameras_of_a_resumed_run_start_at_once_by_what_they_took() -> None:
    admission = by_load(2, 4, lambda: PLENTY)
    known = [replace(camera(f"w{number}"), earlier_cores=0.5) for number in range(6)]
    assert started(admission, [*known, *waiting(2)]) == [state.name for state in known]


def test_a_camera_away_keeps_its_share() -> None:
    away = [replace(camera(f"r{number}", 0.45, GIB), state="reconnecting") for number in range(4)]
    assert started(by_load(2, 4, lambda: PLENTY), [*away, *waiting(1)]) == []


def test_memory_bounds_cameras_too() -> None:
    running = [camera("a", 0.1, GIB), camera("b", 0.1, GIB)]
    scarce = NodeMemory(16 * GIB, round(3.7 * GIB))  # of which a tenth stays free
    admission = by_load(8, 16, lambda: scarce)
    assert started(admission, [*running, *waiting(4)]) == ["w0", "w1"]
    verdict = admission([*running, *map(after_start, waiting(2)), camera("w2")], ())
    assert verdict.cameras_wait_for == "memory: 0.1 GiB are left for more streams, and one takes 1.0 GiB"


def test_files_keep_two_places_a_core_and_hold_up_no_camera() -> None:
    admission = by_load(2, 4, lambda: PLENTY)
    files = [StreamState(f"f{number}") for number in range(6)]
    assert started(admission, files) == ["f0", "f1", "f2", "f3"]
    running = [replace(file, state="running") for file in files[:3]]
    states = [*running, camera("a", 0.3, GIB), *files[3:], camera("b")]
    assert started(admission, states) == []
    quiet = [*running[:2], camera("a", 0.3, GIB), *files[2:], camera("b", 0.0)]
    assert started(admission, quiet) == ["f2"]
    quick = [replace(state, cores=0.05) if state.name == "a" else state for state in states]
    assert started(admission, quick) == ["b"]


def test_one_stream_runs_however_small_the_machine() -> None:
    assert started(by_load(1, 1, lambda: NodeMemory(GIB, 0)), waiting(2)) == ["w0"]


@pytest.mark.parametrize(
    ("gibibytes", "core_count", "expected"), [(24, 2, 4), (6, 2, 3), (1, 2, 1), (0, 1, 1), (256, 64, 128)]
)
def test_places_are_bounded_by_memory_and_cores(gibibytes: int, core_count: int, expected: int) -> None:
    assert places(NodeMemory(gibibytes * GIB, gibibytes * GIB), core_count) == expected


def test_what_others_use_is_no_place_for_streams_and_a_reserve_stays_free() -> None:
    assert places(NodeMemory(32 * GIB, 6 * GIB), 64) == 1
    assert places(NodeMemory(8 * GIB, 6 * GIB), 64) == 3


def test_all_places_together_fit_the_memory_with_room_left() -> None:
    for gibibytes in range(3, 200):
        memory = gibibytes * GIB
        assert places_by_memory(NodeMemory(memory, memory)) * PLACE_BYTES < 0.9 * memory


def test_this_machine_has_cores() -> None:
    assert cores() >= 1
