"""The names of processes in Ray's lists: which part of which stream one is."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
import ray
from actor_fakes import FakeParts, FakeReader, RaySession, picture, run_to_end, spec

from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.pipeline import Node

pytestmark = pytest.mark.ray


def names_with(mark: str) -> list[str]:
    return [name for name in ray.util.list_named_actors() if mark in name]


def walking(folder: Path) -> FakeReader:
    return FakeReader([picture(t, live=[1]) for t in range(12)], folder)


def test_every_process_is_named_by_its_part_and_that_of_a_camera_by_its_stream(
    ray_session: RaySession, parts: FakeParts, tmp_path: Path
) -> None:
    before = set(ray.util.list_named_actors())
    node = Node(parts=parts, policy=PoolPolicy(spare=1))
    try:
        camera = replace(spec("gate, north", walking(tmp_path / "a")), live=True)
        stream = node.start(camera)
        [mark] = {name[-7:-1] for name in ray.util.list_named_actors() if "gate, north" in name}
        assert sorted(re.sub(r" \d+ ", " N ", name) for name in names_with(mark)) == [
            f"coordinator N ({mark})",
            f"gate, north, reader N ({mark})",
            f"pool N ({mark})",
            f"segmenter N ({mark})",
            f"sink N ({mark})",
        ]
        stream.stop(drain=False)
        run_to_end(node.start(spec("yard", walking(tmp_path / "b"))))
        others = set(ray.util.list_named_actors()) - before - set(names_with(mark))
        assert [name for name in others if re.fullmatch(r"layer process \d+ \([0-9a-f]{6}\)", name)]
    finally:
        node.close()
