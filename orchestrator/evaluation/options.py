"""The command line of ``scripts/evaluate``, for which nothing has to be installed but Python."""

from __future__ import annotations

import argparse
from pathlib import Path

from orchestrator.option_values import LEAST_SIDE

__all__ = ["COMPARED_COLUMNS", "DATA_VARIABLE", "LATEX_COLUMNS", "SCRIPT", "evaluation_parser"]

#: What starts the command in this folder.
SCRIPT = "scripts/evaluate"

#: Environment variable that names the default folder of the sequences.
DATA_VARIABLE = "MLBS_DATA"

#: The columns of each method side by side, and of a sweep, unless others are asked for.
COMPARED_COLUMNS = ("j", "f", "track_j")

#: The columns of a LaTeX table of one method, unless others are asked for.
LATEX_COLUMNS = ("two_label_f", "j", "f", "j&f", "object_f", "track_j")

_DESCRIPTION = """\
Score label maps against truth.

  scripts/evaluate --run out --truth cars1=data/cars1/gt    the masks a run wrote in out/cars1/masks
  scripts/evaluate --run out --truth 'DAVIS/Annotations/480p/*'
                                                            those of its streams that have a folder's name
  scripts/evaluate --data data --masks out theirs           anybody's masks, side by side: theirs/cars1/*.png
  scripts/evaluate --data data                              the engine, in process, on every sequence below
                                                            data: frames/ and gt/, or as DAVIS, YouTube-VOS,
                                                            BMS-26 and FBMS come
  scripts/evaluate --sequences 'synthetic:demo?frames=60'   the engine on a scene with exact truth
  scripts/evaluate --data data --paper                      the tables of the paper, with our figures
  scripts/evaluate --data data --ablate                     what each stage of the method gives
  scripts/evaluate --data data --sweep layers.lookahead=0,4,8
                                                            the same with other values, and the differences
  scripts/evaluate --data data --disturb                    how much accidents of parameters and input cost
  scripts/evaluate --data data --sizes 480,960              what the engine finds in smaller or larger
                                                            pictures, and what that costs

Truth maps are PNG: 0 = background, 1 ... 254 = objects, 255 = not judged (an
object where 0 and 255 are the only values, as in DAVIS 2016). Figures are percent, except
extra (layers off the truth per 100 frames), ids_on (labels that lie mostly on an object in at least three
frames, mean over the objects), switches (of identity), delay (median frames from an object's entry until it
is found; synthetic scenes only), ms and cpu_ms (wall and CPU time a frame). false is the share of the frame
that is labelled but background, shared that of the found objects whose label another one has as well. These
matter most:

  two_label_f      moving against not moving: mean F of the frames;  j: the same with intersection over union
  f, j&f           F of DAVIS, of the boundaries of what moves; the mean of j and f
  object_f         every object of the truth on its own: mean F, 0 for a lost one
  track_j          one label for each object over all frames: mean intersection over union
  multi_f          the same, and a layer the truth does not know counts as a lost one too (the paper's text)
  multi_f_matlab   as the paper's table was made: the background takes part, surplus layers do not count
  precision, recall                moving against not moving, over the pixels of each frame
  f first ten, f after start       two_label_f of these frames only; object_f first ten, ... likewise
  j davis, f davis, j&f davis      without the first frame and the last, as DAVIS 2016 counts
  j recall davis, f recall davis   share of these frames in which it is above 50
  j decay davis, f decay davis     what is lost of it from the first quarter of these frames to the last
  j davis17, j recall davis17, ... one label for each object over all frames, as in DAVIS 2017's unsupervised
                                   task
"""


def evaluation_parser(program: str = SCRIPT) -> argparse.ArgumentParser:
    """Return the parser of the command, which its user has started by these words."""
    parser = argparse.ArgumentParser(
        prog=program,
        description=_DESCRIPTION.replace(SCRIPT, program),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--run", type=Path, metavar="OUT_DIR", help="score the masks of this finished run; needs --truth"
    )
    what.add_argument(
        "--masks",
        nargs="+",
        metavar="DIR",
        help="score label maps that are there, of any method: a folder each, or METHOD=DIR; in it are "
        "SEQUENCE/FRAME.png, SEQUENCE/masks/FRAME.png as in a run, or .npy; indexed, grey, or in the colours "
        "of DAVIS. Prints a table with the methods side by side, and their differences from the first",
    )
    what.add_argument(
        "--paper",
        action="store_true",
        help="run the engine on those of the paper's ten sequences that are there, and print the paper's "
        "tables 1 to 4 with our figures beside the published ones; --jobs 1 for times without contention",
    )
    what.add_argument(
        "--ablate",
        action="store_true",
        help="run the engine once for each stage of the method: first with all stages off, then with one "
        "more each time; then once for each of some parts that the whole method is left without; prints "
        "means, and two_label_f of each sequence",
    )
    what.add_argument(
        "--disturb",
        action="store_true",
        help="run the engine as it is, then disturbed: parameters 20 %% off, frames left out, mirrored, "
        "cropped by 3 px, because there is no seed to change, a frame lost, in new light, and with a clock, "
        "a logo, a bonnet or bars drawn over; prints the same and names the worst run. "
        "Each run is judged on the frames it has",
    )
    what.add_argument(
        "--sizes",
        type=_sides,
        metavar="PX,...",
        help="run the engine on the pictures as they are, then shrunk or enlarged to each of these longer "
        "sides; prints means of figures in the size of the truth, and the CPU time; --jobs 1 for times "
        "without contention",
    )
    what.add_argument(
        "--sweep",
        nargs="+",
        metavar="SECTION.KEY=A,B",
        help="run the engine as it is, then with each of these values, or each combination of several "
        "parameters; prints means, and their differences from the first run with a 95 %% interval",
    )
    add(
        "--truth",
        nargs="+",
        default=[],
        metavar="NAME=GT_DIR",
        help="a stream of the run and its truth: a folder of PNG label maps with the masks' stems, a folder "
        "of BMS-26 or FBMS, or a synthetic: URI; or a folder or quoted glob of folders, each for the stream "
        "of its name",
    )
    add(
        "--data",
        type=Path,
        metavar="ROOT",
        help="run the engine on the sequences below this folder "
        f"(default: the environment variable {DATA_VARIABLE})",
    )
    add(
        "--sequences",
        type=lambda text: [name for name in text.split(",") if name],
        metavar="NAME,...",
        help="only these: by their folders below ROOT, as in mlbs/cars1, also globs such as '480p/*', or "
        "synthetic:NAME?frames=60&seed=1",
    )
    add("--lookahead", type=int, metavar="N", help="the same as --set layers.lookahead=N")
    add("--config", type=Path, metavar="FILE", help="YAML file with parameters of the engine")
    add(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="parameters of the engine, after those of --config",
    )
    add(
        "--flow",
        type=Path,
        metavar="FOLDER",
        help="use stored flow in place of the engine's own: forward/NAME/STEM.flo from a frame to the next, "
        "backward/NAME/STEM.flo to the one before, or .npy",
    )
    add(
        "--tracks",
        type=Path,
        metavar="FOLDER",
        help="have trajectories follow stored points in place of the flow: NAME.npz with tracks (frames, "
        "points, 2) and visible (frames, points)",
    )
    add(
        "--reliability",
        action="store_true",
        help="also print how well the score of a mask says its intersection over union with the truth",
    )
    add(
        "--jobs",
        type=int,
        default=2,
        metavar="N",
        help="runs of the engine at the same time (default 2)",
    )
    add("--json", type=Path, metavar="FILE", help="write all figures there, also by range of frames")
    add("--csv", type=Path, metavar="FILE", help="write a row for each frame with truth there")
    add(
        "--summary",
        type=Path,
        metavar="FILE",
        help="write a CSV row for each sequence there, with all columns; in --masks and runs of several "
        "variants for each of them",
    )
    add("--latex", type=Path, metavar="FILE", help="write a table of the sequences there")
    add(
        "--columns",
        type=lambda text: [name.strip().lower() for name in text.split(",")],
        metavar="NAME,...",
        help="of the LaTeX table, of --masks and of --sweep, by their headings, as in 'J,J recall davis' "
        "(default "
        f"{','.join(LATEX_COLUMNS)}; of --masks and --sweep {','.join(COMPARED_COLUMNS)})",
    )
    add(
        "--plots",
        type=Path,
        metavar="DIR",
        help="write plots there, as PNG and PDF: j and f over the frames of each sequence, and precision and "
        "recall of the masks by their objects' score; needs matplotlib",
    )
    add("--sheets", type=Path, metavar="DIR", help="write contact sheets there: labels, truth, difference")
    return parser


def _sides(text: str) -> list[int]:
    sides = [int(one) if one.isdecimal() else 0 for one in text.split(",")]
    if min(sides) < LEAST_SIDE:
        raise argparse.ArgumentTypeError(f"{text!r} must be px, {LEAST_SIDE} or more each, as in 480,960")
    return sides
