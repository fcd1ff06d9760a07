"""The names of processes in Ray's lists: which part of which stream one is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import ray
from actor_fakes import FakeParts, FakeReader, RaySession, picture, run_to_end, spec, wait_until

from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.pipeline import Node

pytestmark = pytest.mark.ray


def names_with(mark: str) -> list[str]:
    return [name for name in ray.util.list_named_actors() if mark in name]


def walking(folder: Path) -> FakeReader:
    return FakeReader([picture(t, live=[1]) for t in range(12)], folder)


def test_every_process_is_named_by_its_part_and_those_of_a_stream_by_one_number(
    ray_session: RaySession, parts: FakeParts, tmp_path: Path
) -> None:
    before = set(ray.util.list_named_actors())
    node = Node(parts=parts, policy=PoolPolicy(spare=1))
    try:
        stream = node.start(spec("gate, north", walking(tmp_path / "a")))
        [mark] = {name[-7:-1] for name in ray.util.list_named_actors() if "gate, north" in name}
        assert sorted(names_with(mark)) == [
            f"gate, north, coordinator 1 ({mark})",
            f"gate, north, reader 1 ({mark})",
            f"gate, north, segmenter 1 ({mark})",
            f"pool 1 ({mark})",
            f"sink 2 ({mark})",
        ]
        run_to_end(stream)
        wait_until(node.prepare)
        assert {f"coordinator 2 ({mark})", f"segmenter 2 ({mark})"} <= set(names_with(mark))
        second = node.start(spec("yard", walking(tmp_path / "b")))
        assert f"yard, reader 2 ({mark})" in names_with(mark)
        run_to_end(second)
        others = set(ray.util.list_named_actors()) - before - set(names_with(mark))
        assert [name for name in others if re.fullmatch(r"layer process \d+ \([0-9a-f]{6}\)", name)]
    finally:
        node.close()
