"""A program of a user's own runs, and its types are checked against the package's."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from record_fakes import write_run, write_stream
from user_program import (
    areas_of_video,
    births,
    drawn,
    happenings,
    largest_box,
    made,
    motions,
    recorded,
    results_of,
)

import mlbs_actors
from mlbs_actors.scenes.synthetic import scene

PROGRAM = Path(__file__).parent / "fakes/user_program.py"
#: Uses of the package that are wrong, and words of what is said of them.
MISTAKES = {
    "subtractor.apply(frame, 3)": "Too many positional arguments",
    "result.label": 'has no attribute "label"',
    "result.mask('1')": 'incompatible type "str"',
    "mlbs_actors.MultilayerSubtractor('my.yaml')": 'incompatible type "str"',
    "mlbs_actors.segment": 'has no attribute "segment"',
    "mlbs_actors.MultilayerSubtractor(colour='grey')": "incompatible type \"Literal['grey']\"",
    "result.labels.astype(float).dtype.nothing": 'has no attribute "nothing"',
    "mlbs_actors.compile_kernels(3)": 'incompatible type "int"',
    "orchestrator.start('a.mp4', maxside=3)": 'Unexpected keyword argument "maxside"',
    "orchestrator.start('a.mp4', max_side='3')": "No overload variant",
    "next(orchestrator.start('a.mp4', references=True)).labels": 'has no attribute "labels"',
}


def strictly_typed(program: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run mypy as a user does: with no settings of this project, and silent about what is not the program."""
    return subprocess.run(
        [
            *(sys.executable, "-m", "mypy", "--strict", "--config-file=", "--follow-imports=silent"),
            *(f"--cache-dir={folder / 'cache'}", program),
        ],
        cwd=folder,
        env=os.environ | {"MYPYPATH": str(Path(mlbs_actors.__file__).parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.long
@pytest.mark.skipif(sys.version_info < (3, 11), reason="types are checked with Python 3.11 and later")
def test_a_program_passes_strict_type_checks_and_its_mistakes_are_found(tmp_path: Path) -> None:
    pytest.importorskip("mypy", reason="scripts/setup dev installs it")
    checked = strictly_typed(PROGRAM, tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    wrong = tmp_path / "wrong.py"
    wrong.write_text(
        "import mlbs_actors\nimport numpy as np\nimport orchestrator\n"
        "def program(subtractor: mlbs_actors.MultilayerSubtractor, result: mlbs_actors.Result) -> None:\n"
        "    frame = np.zeros((48, 64, 3), np.uint8)\n" + "".join(f"    {line}\n" for line in MISTAKES)
    )
    lines = strictly_typed(wrong, tmp_path).stdout.splitlines()
    for line, (code, words) in enumerate(MISTAKES.items(), 6):
        assert any(f"wrong.py:{line}:" in one and words in one for one in lines), (code, lines)


# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_the_program_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    video = scene("pan", frames=60, width=160, height=120)
    results = results_of(video.frame(index) for index in range(8))
    assert set(births(results)) == {layer.layer for one in results for layer in one.layers}
    assert largest_box(results[-1]) is not None
    assert areas_of_video(tmp_path / "none.mp4") == {}
    assert "a source There is no video" in capsys.readouterr().out
    assert {one.kind for one in happenings(results)} >= {"born", "entered", "rule", "left", "ended"}
    assert drawn(video.frame(7), results[7]).shape == (120, 160, 3)
    assert set(motions(made(6))) == {0}
    write_run(tmp_path, [write_stream(tmp_path / "yard", frozenset({"parquet"}))])
    assert set(recorded(tmp_path)["yard"]) == {3, 5}
