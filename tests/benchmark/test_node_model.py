"""The model of a node: it keeps to what can be reckoned by hand."""

from __future__ import annotations

import pytest

from benchmark.measurements.node_model import StageCosts, most_cameras, simulate
from benchmark.measurements.streams import fleet_table

COSTS = StageCosts(reader=2.0, coordinator=10.0, layers=(6.0, 2.0), segmenter=5.0, sink=4.0, other=1.0)


def test_one_core_is_always_busy_with_files() -> None:
    for streams in (1, 3):
        assert simulate(COSTS, streams, 1).frames_a_second == pytest.approx(1e3 / COSTS.together, rel=0.02)


def test_alone_on_many_cores_a_stream_is_as_fast_as_its_slowest_chain() -> None:
    # Layers and segmenter must follow each other; the coordinator works beside them.
    assert simulate(COSTS, 1, 8).frames_a_second == pytest.approx(1e3 / (6.0 + 5.0), rel=0.02)
    slow_tracking = StageCosts(2.0, 40.0, (6.0, 2.0), 5.0, 4.0, 1.0)
    assert simulate(slow_tracking, 1, 8).frames_a_second == pytest.approx(1e3 / 40.0, rel=0.02)


def test_a_single_sink_bounds_all_streams_of_its_node() -> None:
    slow_sink = StageCosts(2.0, 10.0, (6.0, 2.0), 5.0, 50.0, 1.0)
    run = simulate(slow_sink, 6, 7)
    assert run.frames_a_second == pytest.approx(20.0, rel=0.03)
    assert run.sink_busy == pytest.approx(1.0, abs=0.02)
    assert simulate(slow_sink, 6, 8).frames_a_second > 35.0  # eight cores have two


def test_cameras_lose_pictures_only_beyond_what_the_cores_can_do() -> None:
    slow = simulate(COSTS, 4, 2, camera_rate=5.0)
    assert slow.dropped == 0.0
    assert slow.frames_a_second == pytest.approx(20.0, rel=0.03)
    many = simulate(COSTS, 40, 2, camera_rate=5.0)
    assert many.dropped > 0.5
    assert many.frames_a_second < 2e3 / COSTS.together


def test_as_many_cameras_are_served_as_nearly_fill_the_cores() -> None:
    cameras = most_cameras(COSTS, 16, 20.0)
    by_hand = 16e3 / (20.0 * COSTS.together)
    assert 0.85 * by_hand <= cameras <= 1.02 * by_hand


def test_costs_come_from_the_measured_kinds_and_nothing_is_lost() -> None:
    measured = {
        "reader": 2.0, "coordinator": 10.0, "background layer": 6.0, "object layer": 6.0, "segmenter": 5.0,
        "sink": 4.0, "Ray's own": 0.7, "driver": 0.3,
    }  # fmt: skip
    costs = StageCosts.of(measured, 3)
    assert costs.layers == (6.0, 2.0, 2.0, 2.0)
    assert costs.together == pytest.approx(sum(measured.values()))


def test_the_fleet_table_tells_nodes_for_a_thousand_cameras() -> None:
    rows = fleet_table("demo", COSTS, nodes=(2,)).splitlines()
    cameras, nodes = rows[1].split()[1], rows[1].split()[-1]
    assert (cameras, nodes) == ("13", "77")
