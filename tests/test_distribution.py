"""The package without its repository: the wheel, the sdist, the container."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("mlbs_actors", "orchestrator")
CONTAINER = (ROOT / "Containerfile").read_text(encoding="utf-8")
COPIED = [words.split() for words in re.findall(r"^COPY (.*)$", CONTAINER, re.MULTILINE)]

WITHOUT = shutil.ignore_patterns(
    *(".*", "__pycache__", "*.egg-info", "out", "out-*", "build", "dist"),
)


def build(source: Path, output: Path) -> None:
    pytest.importorskip("build", reason="scripts/setup dev installs it")
    subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", output, source],
        capture_output=True,
        text=True,
        check=True,
    )


def contents(folder: Path) -> dict[str, bytes]:
    """The files of the wheel in a folder, without the notes about them."""
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist() if ".dist-info/" not in name}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist and the wheel, which is built from it."""
    folder = tmp_path_factory.mktemp("built")
    shutil.copytree(ROOT, folder / "source", ignore=WITHOUT)
    build(folder / "source", folder / "dist")
    return folder / "dist"


@pytest.fixture(scope="module")
def installed(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder into which the wheel is installed, without what it needs."""
    folder = tmp_path_factory.mktemp("installed")
    (wheel,) = built.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--target"]
    subprocess.run([*pip, str(folder), str(wheel)], capture_output=True, check=True)
    return folder


def command(installed: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the installed command in a folder."""
    return subprocess.run(
        [installed / "bin/mlbs-actors", *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.long
def test_the_wheel_holds_all_of_both_packages_and_the_configurations_and_nothing_else(built: Path) -> None:
    expected = {
        str(path.relative_to(ROOT)): path.read_bytes()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    held = contents(built)
    data = {name: held.pop(name) for name in list(held) if name not in expected}
    assert held == expected
    assert {name.partition(".data/")[2]: content for name, content in data.items()} == {
        f"data/share/mlbs-actors/{path.name}": path.read_bytes() for path in (ROOT / "configs").iterdir()
    }


@pytest.mark.long
def test_the_wheel_is_pure_typed_and_without_anything_that_was_compiled_or_tests(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    assert wheel.name.endswith("-py3-none-any.whl")
    held = contents(built)
    assert {f"{package}/py.typed" for package in PACKAGES} <= held.keys()
    assert not [
        name for name in held if re.search(r"__pycache__|\.py[co]$|\.nb[ci]$|\.so$|(^|/)tests?/", name)
    ]


@pytest.mark.long
def test_the_packages_that_are_installed_fit_together() -> None:
    checked = subprocess.run(
        [sys.executable, "-m", "pip", "check"], capture_output=True, text=True, check=False
    )
    assert checked.returncode == 0, checked.stdout


@pytest.mark.long
def test_the_sdist_holds_the_tests_and_the_scripts(built: Path) -> None:
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        for name in ("scripts/run", "tests/conftest.py", "docs/command_line.md", "Containerfile", "LICENSE"):
            held = archive.extractfile(f"{sdist.name.removesuffix('.tar.gz')}/{name}")
            assert held is not None
            assert held.read() == (ROOT / name).read_bytes()


@pytest.mark.long
def test_the_installed_command_reads_nothing_of_the_repository(installed: Path, tmp_path: Path) -> None:
    asked = command(installed, tmp_path, "--help")
    assert asked.stdout.startswith("usage: mlbs-actors COMMAND ...")
    refused = command(installed, tmp_path, "none.mp4")
    assert (refused.returncode, refused.stderr) == (
        2,
        f"There is no file or folder {tmp_path / 'none.mp4'}; check the path.\n",
    )


@pytest.mark.long
@pytest.mark.ray
@pytest.mark.timeout(900)
def test_the_installed_command_compiles_and_runs_the_demo(installed: Path, tmp_path: Path) -> None:
    ended = command(installed, tmp_path, "demo", "--max-frames", "8", "--save", "masks,overlay")
    assert ended.returncode == 0, ended.stderr
    assert "1 of 1 stream complete" in ended.stderr
    assert len(list((tmp_path / "out/street/masks").iterdir())) == 8
    assert (tmp_path / "out/report.html").stat().st_size
    assert list((installed / "mlbs_actors").rglob("*.nbi"))  # it was this copy that ran


@pytest.mark.long
def test_what_the_container_copies_is_all_that_the_package_is_built_from(built: Path, tmp_path: Path) -> None:
    source = tmp_path / "src"
    source.mkdir()
    for *paths, target in COPIED:
        place = tmp_path / target.lstrip("/")
        for path in paths:
            if (ROOT / path).is_dir():
                shutil.copytree(ROOT / path, place, ignore=WITHOUT)
            else:
                shutil.copy(ROOT / path, place)
    build(source, tmp_path / "dist")
    assert contents(tmp_path / "dist") == contents(built)


def test_the_container_is_built_and_run_as_the_documentation_says() -> None:
    page = (ROOT / "docs/python_api.md").read_text(encoding="utf-8")
    for line in re.findall(r"^# (podman .*)$", CONTAINER, re.MULTILINE):
        assert f"\n{line}" in page
    extras = re.search(r"pip install .*\[(.*)\]", CONTAINER)
    assert extras is not None
    assert f"`[{extras[1]}]`" in page
