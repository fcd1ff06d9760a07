"""Whether a node of a cluster can be used, and how many streams it takes."""

from __future__ import annotations

from pathlib import Path

import pytest

from mlbs_actors.errors import ConfigError
from orchestrator.run.need import Need
from orchestrator.run.node_check import node_places
from orchestrator.run.versions import installed_versions


def test_a_node_that_does_not_see_the_output_folder_takes_no_stream(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="put it on a file system that all nodes share"):
        node_places(tmp_path, installed_versions(), Need(), 1.0)
    (tmp_path / "run.json").touch()
    assert node_places(tmp_path, installed_versions(), Need(), 1.0) >= 1


@pytest.mark.parametrize("package", ["numpy", "source"])
def test_a_node_with_other_versions_takes_no_stream(tmp_path: Path, package: str) -> None:
    (tmp_path / "run.json").touch()
    versions = installed_versions() | {package: "0.1"}
    with pytest.raises(ConfigError, match=rf"{package} .+ instead of 0\.1; install the same versions there"):
        node_places(tmp_path, versions, Need(), 1.0)


def test_a_node_takes_no_more_than_two_streams_for_each_cpu_that_ray_has_there(tmp_path: Path) -> None:
    (tmp_path / "run.json").touch()
    assert node_places(tmp_path, installed_versions(), Need(), 1.0) <= 2


def test_a_node_takes_as_many_streams_as_have_what_each_needs(tmp_path: Path) -> None:
    (tmp_path / "run.json").touch()
    assert node_places(tmp_path, installed_versions(), Need(0.25, 2**20), 2.0) == 8
    assert node_places(tmp_path, installed_versions(), Need(0.25, 2**60), 2.0) == 1
