"""The manifest of a cluster on Kubernetes; its fields are those of KubeRay's ``ray.io/v1``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from mlbs_actors.actors.node.memory import NodeMemory
from orchestrator.run.admission import places
from orchestrator.run.need import STREAMS_A_CORE

REPOSITORY = Path(__file__).parents[1]

_FIELDS = {"rayVersion", "enableInTreeAutoscaling", "autoscalerOptions", "headGroupSpec", "workerGroupSpecs"}
_GROUP_FIELDS = {"groupName", "replicas", "minReplicas", "maxReplicas", "rayStartParams", "template"}


@pytest.fixture(scope="module")
def documents() -> list[dict[str, Any]]:
    text = (REPOSITORY / "configs/kuberay.yaml").read_text(encoding="utf-8")
    return list(yaml.safe_load_all(text))


@pytest.fixture(scope="module")
def spec(documents: list[dict[str, Any]]) -> dict[str, Any]:
    [cluster] = (one["spec"] for one in documents if one["kind"] == "RayCluster")
    assert isinstance(cluster, dict)
    return cluster


def containers(spec: dict[str, Any]) -> list[dict[str, Any]]:
    groups = [spec["headGroupSpec"], *spec["workerGroupSpecs"]]
    return [one for group in groups for one in group["template"]["spec"]["containers"]]


def test_every_field_is_one_that_kuberay_knows(spec: dict[str, Any]) -> None:
    assert spec.keys() <= _FIELDS
    assert spec["headGroupSpec"].keys() <= {"rayStartParams", "template"}
    for group in spec["workerGroupSpecs"]:
        assert group.keys() <= _GROUP_FIELDS
        assert {"groupName", "minReplicas", "maxReplicas", "template"} <= group.keys()
        assert group["minReplicas"] <= group["replicas"] <= group["maxReplicas"]
    parameters = [spec["headGroupSpec"], *spec["workerGroupSpecs"]]
    assert all(isinstance(value, str) for one in parameters for value in one["rayStartParams"].values())


def test_the_head_takes_no_streams_and_all_pods_share_image_and_folder(
    spec: dict[str, Any], documents: list[dict[str, Any]]
) -> None:
    assert spec["headGroupSpec"]["rayStartParams"]["num-cpus"] == "0"
    first, *others = [(one["image"], one["volumeMounts"]) for one in containers(spec)]
    assert all(one == first for one in others)
    [claim] = (one for one in documents if one["kind"] == "PersistentVolumeClaim")
    assert claim["spec"]["accessModes"] == ["ReadWriteMany"]
    for group in (spec["headGroupSpec"], *spec["workerGroupSpecs"]):
        [volume] = group["template"]["spec"]["volumes"]
        assert volume["persistentVolumeClaim"]["claimName"] == claim["metadata"]["name"]


def test_a_worker_has_memory_for_as_many_streams_as_its_cpus_take(spec: dict[str, Any]) -> None:
    for one in containers(spec)[1:]:
        limits = one["resources"]["limits"]
        memory = int(limits["memory"].removesuffix("Gi")) * 2**30
        cpus = int(limits["cpu"])
        assert places(NodeMemory(memory, memory - 2**30), cpus) == cpus * STREAMS_A_CORE
