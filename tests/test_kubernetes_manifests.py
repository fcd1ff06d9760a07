"""The manifests for Kubernetes ask for what exists, and their parts fit together.

Their fields are held against those that are listed here, so that a misspelt one is found. With
``MLBS_KUBERAY_CRDS``, the folder ``ray-operator/config/crd/bases`` of a copy of KubeRay, they are checked by
its schemas, which contain those of pods, services and claims, too.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import pytest
import yaml
from jsonschema import Draft7Validator

from mlbs_actors.actors.node.memory import NodeMemory
from orchestrator.command_line import parse
from orchestrator.monitor.address import TOKEN_VARIABLE
from orchestrator.run.admission import places
from orchestrator.run.need import STREAMS_A_CORE

CONFIGS = Path(__file__).parents[1] / "configs"
CRDS = os.environ.get("MLBS_KUBERAY_CRDS")
FILES = ("kuberay.yaml", "kuberay-job.yaml", "kubernetes-cameras.yaml")

#: The type of a value; of an object by name, of a list's items in a list; None: texts by names of one's own.
_Fields: TypeAlias = "type | dict[str, Any] | list[Any] | None"

_META: _Fields = {"name": str, "generateName": str, "labels": None, "annotations": None}
_RESOURCES: _Fields = {"requests": None, "limits": None}
_PROBE: _Fields = {
    "httpGet": {"path": str, "port": str},
    "periodSeconds": int,
    "timeoutSeconds": int,
    "failureThreshold": int,
}
_CONTAINER: _Fields = {
    "name": str,
    "image": str,
    "command": [str],
    "args": [str],
    "env": [{"name": str, "value": str, "valueFrom": {"secretKeyRef": {"name": str, "key": str}}}],
    "ports": [{"name": str, "containerPort": int}],
    "startupProbe": _PROBE,
    "livenessProbe": _PROBE,
    "readinessProbe": _PROBE,
    "securityContext": {
        "allowPrivilegeEscalation": bool,
        "readOnlyRootFilesystem": bool,
        "capabilities": {"drop": [str]},
    },
    "resources": _RESOURCES,
    "volumeMounts": [{"name": str, "mountPath": str, "readOnly": bool}],
}
_POD: _Fields = {
    "automountServiceAccountToken": bool,
    "enableServiceLinks": bool,
    "terminationGracePeriodSeconds": int,
    "restartPolicy": str,
    "securityContext": {
        "runAsNonRoot": bool,
        "runAsUser": int,
        "runAsGroup": int,
        "fsGroup": int,
        "fsGroupChangePolicy": str,
        "seccompProfile": {"type": str},
    },
    "initContainers": [_CONTAINER],
    "containers": [_CONTAINER],
    "volumes": [
        {
            "name": str,
            "secret": {"secretName": str, "items": [{"key": str, "path": str}]},
            "persistentVolumeClaim": {"claimName": str},
            "emptyDir": {"medium": str, "sizeLimit": str},
        }
    ],
}
_TEMPLATE: _Fields = {"metadata": _META, "spec": _POD}
_CLUSTER: _Fields = {
    "rayVersion": str,
    "enableInTreeAutoscaling": bool,
    "autoscalerOptions": {"version": str, "idleTimeoutSeconds": int},
    "headGroupSpec": {"rayStartParams": None, "template": _TEMPLATE},
    "workerGroupSpecs": [
        {
            "groupName": str,
            "replicas": int,
            "minReplicas": int,
            "maxReplicas": int,
            "rayStartParams": None,
            "template": _TEMPLATE,
        }
    ],
}
_SPECS: dict[tuple[str, str], _Fields] = {
    ("ray.io/v1", "RayCluster"): _CLUSTER,
    ("ray.io/v1", "RayJob"): {
        "entrypoint": str,
        "backoffLimit": int,
        "shutdownAfterJobFinishes": bool,
        "ttlSecondsAfterFinished": int,
        "submissionMode": str,
        "rayClusterSpec": _CLUSTER,
    },
    ("apps/v1", "Deployment"): {
        "replicas": int,
        "strategy": {"type": str},
        "selector": {"matchLabels": None},
        "template": _TEMPLATE,
    },
    ("v1", "Service"): {"selector": None, "ports": [{"name": str, "port": int, "targetPort": str}]},
    ("v1", "PersistentVolumeClaim"): {"accessModes": [str], "resources": _RESOURCES},
}


def faults(value: object, fields: _Fields, place: str) -> Iterator[str]:
    """Yield what a value has that is not to be there."""
    match fields:
        case None:
            if not (isinstance(value, dict) and all(isinstance(one, str) for one in value.values())):
                yield f"{place} is no mapping of texts"
        case dict():
            if not isinstance(value, dict):
                yield f"{place} is no mapping"
                return
            for name, one in value.items():
                if name in fields:
                    yield from faults(one, fields[name], f"{place}.{name}")
                else:
                    yield f"{place}.{name} is not known"
        case [item]:
            if not isinstance(value, list):
                yield f"{place} is no list"
                return
            for number, one in enumerate(value):
                yield from faults(one, item, f"{place}.{number}")
        case type():
            if type(value) is not fields:
                yield f"{place} is no {fields.__name__}"


def documents(name: str) -> list[dict[str, Any]]:
    return list(yaml.safe_load_all((CONFIGS / name).read_text(encoding="utf-8")))


def of_kind(name: str, kind: str) -> dict[str, Any]:
    [found] = (one for one in documents(name) if one["kind"] == kind)
    assert isinstance(found, dict)
    return found


def cluster(name: str) -> dict[str, Any]:
    if name == "kuberay.yaml":
        spec = of_kind(name, "RayCluster")["spec"]
    else:
        spec = of_kind(name, "RayJob")["spec"]["rayClusterSpec"]
    assert isinstance(spec, dict)
    return spec


def pods(name: str) -> list[dict[str, Any]]:
    if name == "kubernetes-cameras.yaml":
        return [of_kind(name, "Deployment")["spec"]["template"]["spec"]]
    spec = cluster(name)
    return [one["template"]["spec"] for one in (spec["headGroupSpec"], *spec["workerGroupSpecs"])]


def containers(name: str) -> list[dict[str, Any]]:
    return [one for pod in pods(name) for one in (*pod.get("initContainers", ()), *pod["containers"])]


@pytest.mark.parametrize("name", FILES)
def test_every_field_is_known(name: str) -> None:
    for one in documents(name):
        fields = _SPECS[one["apiVersion"], one["kind"]]
        assert one.keys() == {"apiVersion", "kind", "metadata", "spec"}
        assert list(faults(one["metadata"], _META, "metadata")) == []
        assert list(faults(one["spec"], fields, "spec")) == []


def test_a_misspelt_field_is_found() -> None:
    assert list(faults({"containers": [{"imag": "x"}]}, _POD, "pod")) == [
        "pod.containers.0.imag is not known"
    ]
    assert list(faults({"restartPolicy": True}, _POD, "pod")) == ["pod.restartPolicy is no str"]


def strict(schema: Any) -> Any:
    """Refuse fields that a schema does not name, as the server of Kubernetes does when it is asked to."""
    if isinstance(schema, list):
        return [strict(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    made = {key: strict(one) for key, one in schema.items() if key not in ("description", "format")}
    if made.get("x-kubernetes-int-or-string"):
        made.pop("type", None)
    if "type" in made and isinstance(made.get("properties"), dict):
        made["additionalProperties"] = False
    return made


@pytest.mark.skipif(CRDS is None, reason="MLBS_KUBERAY_CRDS names no folder of KubeRay's schemas")
def test_the_schemas_of_kuberay_accept_every_document() -> None:
    def schema(plural: str) -> dict[str, Any]:
        text = Path(str(CRDS), f"ray.io_{plural}.yaml").read_text(encoding="utf-8")
        [version] = (one for one in yaml.safe_load(text)["spec"]["versions"] if one["name"] == "v1")
        made = strict(version["schema"]["openAPIV3Schema"])
        assert isinstance(made, dict)
        return made

    ray_cluster, ray_job = (schema(plural)["properties"]["spec"] for plural in ("rayclusters", "rayjobs"))
    group = ray_cluster["properties"]["headGroupSpec"]["properties"]
    volume = group["template"]["properties"]["spec"]["properties"]["volumes"]["items"]["properties"]
    claim = volume["ephemeral"]["properties"]["volumeClaimTemplate"]["properties"]["spec"]
    schemas = {
        "RayCluster": (ray_cluster, ("spec",)),
        "RayJob": (ray_job, ("spec",)),
        "Deployment": (group["template"], ("spec", "template")),
        "Service": (group["headService"]["properties"]["spec"], ("spec",)),
        "PersistentVolumeClaim": (claim, ("spec",)),
    }
    for name in FILES:
        for one in documents(name):
            expected, path = schemas[one["kind"]]
            for step in path:
                one = one[step]
            if "metadata" in one:
                one = {key: value for key, value in one.items() if key != "metadata"}
            assert [error.message for error in Draft7Validator(expected).iter_errors(one)] == []


@pytest.mark.parametrize("name", FILES)
def test_no_container_is_root_or_may_become_it(name: str) -> None:
    for pod in pods(name):
        assert pod["securityContext"]["runAsNonRoot"] is True
        assert pod["securityContext"]["runAsUser"] > 0
        assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    for one in containers(name):
        assert one["securityContext"]["allowPrivilegeEscalation"] is False
        assert one["securityContext"]["capabilities"] == {"drop": ["ALL"]}
        assert {"requests", "limits"} == one["resources"].keys()
        assert not one["image"].endswith(":latest")


@pytest.mark.parametrize("name", FILES)
def test_what_is_mounted_is_there(name: str) -> None:
    claims = {
        one["metadata"]["name"]
        for file in FILES
        for one in documents(file)
        if one["kind"] == "PersistentVolumeClaim"
    }
    for pod in pods(name):
        volumes = {one["name"]: one for one in pod["volumes"]}
        for one in (*pod.get("initContainers", ()), *pod["containers"]):
            assert {mount["name"] for mount in one["volumeMounts"]} <= volumes.keys()
        for volume in volumes.values():
            if "persistentVolumeClaim" in volume:
                assert volume["persistentVolumeClaim"]["claimName"] in claims


# Ray clusters


@pytest.mark.parametrize("name", ["kuberay.yaml", "kuberay-job.yaml"])
def test_the_head_takes_no_streams_and_all_pods_share_image_and_folder(name: str) -> None:
    assert cluster(name)["headGroupSpec"]["rayStartParams"]["num-cpus"] == "0"
    first, *others = [(one["image"], one["volumeMounts"]) for one in containers(name)]
    assert all(one == first for one in others)
    [claim] = (one for one in documents("kuberay.yaml") if one["kind"] == "PersistentVolumeClaim")
    assert claim["spec"]["accessModes"] == ["ReadWriteMany"]
    for pod in pods(name):
        [volume] = pod["volumes"]
        assert volume["persistentVolumeClaim"]["claimName"] == claim["metadata"]["name"]
    for group in cluster(name)["workerGroupSpecs"]:
        assert group["minReplicas"] <= group["replicas"] <= group["maxReplicas"]


def test_a_job_has_the_cluster_of_the_other_file() -> None:
    assert cluster("kuberay-job.yaml") == cluster("kuberay.yaml")


@pytest.mark.parametrize("name", ["kuberay.yaml", "kuberay-job.yaml"])
def test_a_worker_has_memory_for_as_many_streams_as_its_cpus_take(name: str) -> None:
    for one in containers(name)[1:]:
        limits = one["resources"]["limits"]
        memory = int(limits["memory"].removesuffix("Gi")) * 2**30
        cpus = int(limits["cpu"])
        assert places(NodeMemory(memory, memory - 2**30), cpus) == cpus * STREAMS_A_CORE


def test_a_job_continues_what_another_try_has_begun_and_has_time_to_stop() -> None:
    command, *words = shlex.split(of_kind("kuberay-job.yaml", "RayJob")["spec"]["entrypoint"])
    arguments = parse(words)
    assert command == "mlbs-actors"
    assert (arguments.address, arguments.resume) == ("auto", True)
    head = containers("kuberay-job.yaml")[0]
    [wait] = (one["value"] for one in head["env"] if one["name"] == "RAY_JOB_STOP_WAIT_TIME_S")
    assert float(wait) >= 30


# Cameras


def test_the_cameras_are_a_service_of_one_pod_with_its_page_and_probes() -> None:
    deployment = of_kind("kubernetes-cameras.yaml", "Deployment")
    [container] = deployment["spec"]["template"]["spec"]["containers"]
    arguments = parse(container["args"])
    assert (arguments.resume, arguments.watch) == (True, True)
    assert (deployment["spec"]["replicas"], deployment["spec"]["strategy"]) == (1, {"type": "Recreate"})
    assert deployment["spec"]["template"]["spec"]["terminationGracePeriodSeconds"] >= 60
    assert [one["name"] for one in container["env"]] == [TOKEN_VARIABLE]
    [port] = container["ports"]
    assert arguments.monitor is not None
    assert port["containerPort"] == arguments.monitor.port
    asked = {one: container[one]["httpGet"]["path"] for one in container if one.endswith("Probe")}
    assert asked == {"startupProbe": "/healthz", "livenessProbe": "/healthz", "readinessProbe": "/readyz"}
    service = of_kind("kubernetes-cameras.yaml", "Service")["spec"]
    labels = deployment["spec"]["template"]["metadata"]["labels"]
    assert deployment["spec"]["selector"]["matchLabels"] == labels == service["selector"]
    assert service["ports"] == [{"name": "page", "port": port["containerPort"], "targetPort": port["name"]}]


def test_the_cameras_write_to_volumes_alone() -> None:
    [pod] = pods("kubernetes-cameras.yaml")
    for one in containers("kubernetes-cameras.yaml"):
        assert one["securityContext"]["readOnlyRootFilesystem"] is True
    [container] = pod["containers"]
    mounted = {mount["mountPath"] for mount in container["volumeMounts"] if not mount.get("readOnly")}
    arguments = parse(container["args"])
    assert mounted >= {"/tmp", "/dev/shm", str(arguments.output.parent)}
    containerfile = (CONFIGS.parent / "Containerfile").read_text(encoding="utf-8")
    [cache] = (line.partition("=")[2] for line in containerfile.splitlines() if "ENV XDG_CACHE_HOME" in line)
    assert cache in mounted
    [copies] = pod["initContainers"]
    assert copies["command"][-2:] == [f"{cache}/.", copies["volumeMounts"][0]["mountPath"]]


@pytest.mark.parametrize("name", ["kubernetes-cameras.yaml", "kuberay-job.yaml"])
def test_the_scratch_folder_that_is_named_for_an_object_store_is_on_a_volume_of_all_pods(name: str) -> None:
    text = (CONFIGS / name).read_text(encoding="utf-8")
    (scratch,) = re.findall(r"--scratch[ =](\S+?),? ", text)
    for pod in pods(name):
        lasting = {one["name"] for one in pod["volumes"] if "persistentVolumeClaim" in one}
        for container in pod["containers"]:
            places = [one["mountPath"] for one in container["volumeMounts"] if one["name"] in lasting]
            assert any(Path(scratch).is_relative_to(place) for place in places)
