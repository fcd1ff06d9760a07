"""The exact versions that scripts/setup installs agree with the bounds in pyproject.toml."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS: dict[str, list[str]] = PROJECT["project"]["optional-dependencies"]
FILES = [*(f"python3.{minor}" for minor in range(10, 14)), "python3.10-oldest"]


def bounds(*extras: str) -> list[Requirement]:
    """What the package needs, with extras."""
    texts = [*PROJECT["project"]["dependencies"], *(text for extra in extras for text in EXTRAS[extra])]
    return [Requirement(text) for text in texts]


def versions(file: str) -> dict[str, Version]:
    """The exact versions of a file by name."""
    lines = (ROOT / f"requirements/{file}.txt").read_text(encoding="utf-8").splitlines()
    return {name: Version(version) for name, version in (line.split("==") for line in lines)}


def test_every_dependency_has_a_lower_and_an_upper_bound() -> None:
    building = [Requirement(text) for text in PROJECT["build-system"]["requires"]]
    for requirement in [*building, *bounds(*EXTRAS)]:
        assert sorted(one.operator for one in requirement.specifier) == ["<", ">="], requirement


def test_every_promised_python_has_a_file_and_no_other_has_one() -> None:
    assert {path.name for path in (ROOT / "requirements").iterdir()} == {f"{file}.txt" for file in FILES}
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "Python 3.10 to 3.13" in readme


@pytest.mark.parametrize("file", FILES)
def test_a_file_holds_names_and_versions_in_order_and_no_address(file: str) -> None:
    lines = (ROOT / f"requirements/{file}.txt").read_text(encoding="utf-8").splitlines()
    assert all(re.fullmatch(r"[a-z0-9-]+==[0-9][0-9a-z.]*", line) for line in lines)
    names = [line.partition("==")[0] for line in lines]
    assert names == sorted(set(names))


@pytest.mark.parametrize("file", FILES)
def test_a_file_has_every_direct_dependency_within_its_bounds(file: str) -> None:
    exact = versions(file)
    environment = {"python_version": re.sub(r"python|-oldest", "", file)}
    wanted = [
        one
        for one in bounds("run", "headless", "bench", "mqtt", "dev")
        if one.marker is None or one.marker.evaluate(environment)
    ]
    assert len(wanted) > 25
    for requirement in wanted:
        assert exact[canonicalize_name(requirement.name)] in requirement.specifier, requirement


def test_the_oldest_packages_are_the_lower_bounds_of_what_a_run_needs() -> None:
    exact = versions("python3.10-oldest")
    for requirement in bounds("run", "headless"):
        (least,) = (Version(one.version) for one in requirement.specifier if one.operator == ">=")
        assert exact[canonicalize_name(requirement.name)] == least, requirement


def test_what_builds_the_package_is_among_the_exact_versions() -> None:
    (backend,) = map(Requirement, PROJECT["build-system"]["requires"])
    assert all(versions(file)[backend.name] in backend.specifier for file in FILES)
