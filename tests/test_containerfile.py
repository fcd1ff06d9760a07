"""The images: what their file says can be built, and what is built is no root's."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

from orchestrator.monitor import health

ROOT = Path(__file__).resolve().parents[1]

#: What a stage may consist of.
_KNOWN = {"FROM", "COPY", "RUN", "ENV", "USER", "WORKDIR", "EXPOSE", "HEALTHCHECK", "ENTRYPOINT", "CMD"}


@dataclass
class Stage:
    """One of a Containerfile: its base, its name and its instructions, in order."""

    base: str
    name: str
    steps: list[tuple[str, str]] = field(default_factory=list)

    def all(self, instruction: str) -> list[str]:
        return [words for name, words in self.steps if name == instruction]


@pytest.fixture(scope="module")
def stages() -> list[Stage]:
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    found: list[Stage] = []
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        if not line.strip():
            continue
        instruction, _, words = line.partition(" ")
        assert instruction in _KNOWN, line
        if instruction == "FROM":
            base, _, name = words.partition(" AS ")
            found.append(Stage(base, name))
        else:
            found[-1].steps.append((instruction, words.strip()))
    return found


def is_sent(path: str) -> bool:
    """Whether ``.dockerignore`` leaves a path in what an image is built from."""
    sent = True
    for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines():
        pattern = line.removeprefix("!")
        if (
            line
            and not line.startswith("#")
            and any(fnmatch(part, pattern) for part in (path, path.partition("/")[0]))
        ):
            sent = line.startswith("!")
    return sent


def test_every_base_has_a_version_and_a_registry(stages: list[Stage]) -> None:
    for stage in stages:
        assert re.fullmatch(r"docker\.io/[\w/-]+:\d[\w.-]*", stage.base), stage.base


def test_every_source_of_a_copy_is_there(stages: list[Stage]) -> None:
    named = {stage.name for stage in stages}
    for stage in stages:
        for words in stage.all("COPY"):
            *sources, _ = words.split()
            if sources[0].startswith("--from="):
                assert sources[0].removeprefix("--from=") in named
                continue
            for source in sources:
                assert (ROOT / source).exists(), source
                assert is_sent(source), source
    assert not is_sent(".venv")
    assert not is_sent("tests")


def test_the_wheel_is_built_from_all_that_its_description_names(stages: list[Stage]) -> None:
    copied = {source for words in stages[0].all("COPY") for source in words.split()[:-1]}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = {one.rstrip("*") for one in project["tool"]["setuptools"]["packages"]["find"]["include"]}
    data = {one for files in project["tool"]["setuptools"]["data-files"].values() for one in files}
    assert copied >= packages | {project["project"]["readme"], *project["project"]["license-files"]}
    assert all(Path(one).parts[0] in copied for one in data)


def test_images_install_the_wheel_with_the_tested_versions_of_their_python(stages: list[Stage]) -> None:
    for stage in stages[1:]:
        (version,) = re.findall(r"python:(3\.\d+)-|-py(3\d+)$", stage.base)
        short = version[0] or f"3.{version[1][1:]}"
        [requirements] = (words for words in stage.all("COPY") if words.startswith("requirements/"))
        assert requirements.split()[0] == f"requirements/python{short}.txt"
        [install] = (words for words in stage.all("RUN") if "pip install" in words)
        assert "--no-cache-dir" in install
        assert f"--constraint {requirements.split()[1]}" in install
        assert "/tmp/wheels/*.whl)[run,headless,object-storage]" in install
        if ":3" not in stage.base:  # it brings its own Ray
            pinned = (ROOT / requirements.split()[0]).read_text(encoding="utf-8")
            ray = stage.base.rpartition(":")[2].partition("-")[0]
            assert f"ray=={ray}\n" in pinned


def test_nothing_runs_as_root(stages: list[Stage]) -> None:
    for stage in stages[1:]:
        names = [name for name, _ in stage.steps]
        assert stage.all("USER")
        assert all(user.isdecimal() and int(user) > 0 for user in stage.all("USER"))
        assert "COPY" not in names[names.index("USER") :]


def test_the_kernels_are_compiled_by_whoever_will_run_them(stages: list[Stage]) -> None:
    command = stages[-1]
    at = [number for number, (_, words) in enumerate(command.steps) if "warm_up" in words]
    users = [number for number, (name, _) in enumerate(command.steps) if name == "USER"]
    assert users[-1] < at[0]
    assert any(words.startswith("XDG_CACHE_HOME=") for words in command.all("ENV"))


def test_the_command_is_the_entry_and_its_health_is_asked_for(stages: list[Stage]) -> None:
    command = stages[-1]
    assert json.loads(command.all("ENTRYPOINT")[0]) == ["mlbs-actors"]
    assert json.loads(command.all("CMD")[0]) == ["--help"]
    [check] = command.all("HEALTHCHECK")
    *words, port = json.loads(check.partition("CMD ")[2])
    assert words == ["python", "-m", health.__name__]
    assert command.all("EXPOSE") == [port]
