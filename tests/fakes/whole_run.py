"""Whole runs of the command, and one over good, damaged and missing sources that tests share."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2

from mlbs_actors.scenes.synthetic import scene

REPOSITORY = Path(__file__).resolve().parents[2]

#: Frames of each stream of the shared run, their size in px, and the frame of ``folder`` that is no image.
FRAMES, SIZE, DAMAGED = 12, (160, 120), 4

#: Names of modules that a run imports, of packages and of Python itself.
PLANTED = ("av", "cv2", "yaml", "queue", "select", "secrets")

#: A password in the shared run's list, which nothing that the run writes may contain.
SECRET = "hunter2"


@dataclass(frozen=True, slots=True)
class FinishedRun:
    """A run of the command that has ended, to be looked at only.

    Attributes
    ----------
    sources : Path
        Folder of the list and of the files that it names, where the command was given. It has modules with
        the names ``PLANTED``, which leave a file ``NAME.was-run`` when they are imported.
    output : Path
        Folder of the record.
    exit_status : int
    stdout, stderr : str
    """

    sources: Path
    output: Path
    exit_status: int
    stdout: str
    stderr: str


def run_whole(
    *arguments: str | Path, folder: Path = REPOSITORY, timeout: float = 400
) -> subprocess.CompletedProcess[str]:
    """Run the command to its end, in a folder."""
    return subprocess.run(
        [sys.executable, "-m", "orchestrator", *map(str, arguments)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


def run_mixed_sources(folder: Path) -> FinishedRun:
    """Run over four streams with all that can be saved, and with JSON lines.

    ``demo`` is whole, ``folder`` has an image that cannot be decoded, ``gone`` has no file, and nothing
    listens at the address of the camera ``door``.
    """
    width, height = SIZE
    still = scene("no-mover", frames=FRAMES, width=width, height=height)
    (folder / "folder").mkdir()
    for index in range(FRAMES):
        cv2.imwrite(str(folder / f"folder/p{index}.png"), still.frame(index))
    (folder / f"folder/p{DAMAGED}.png").write_bytes(b"damaged")
    (folder / "list.txt").write_text(
        f"demo 'synthetic:demo?frames={FRAMES}&width={width}&height={height}'\n"
        "folder\n"
        "gone none.mp4\n"
        f"door rtsp://bob:{SECRET}@127.0.0.1:9/door\n"
    )
    for name in PLANTED:
        mark = repr(str(folder / f"{name}.was-run"))
        (folder / f"{name}.py").write_text(f"open({mark}, 'w').close()\n")
    output = folder / "out"
    ended = run_whole(
        *("--streams", folder / "list.txt", "--output", output, "--give-up-after", "5"),
        *("--log", "json"),
        *("--save", "masks,parquet,overlay,background,cutouts"),
        folder=folder,
    )
    return FinishedRun(folder, output, ended.returncode, ended.stdout, ended.stderr)
