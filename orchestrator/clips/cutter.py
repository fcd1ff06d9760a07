"""A process that cuts clips, one after the other, at low priority.

A damaged video can abort the process that reads it, which must not be the run's.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import asdict

import av.error
import av.logging

from mlbs_actors.errors import MlbsError
from orchestrator.clips.cutting import CutRequest, cut
from orchestrator.module_path import PACKAGE_ROOT
from orchestrator.sources.libav import reason

__all__ = ["Cutter", "CutterLostError"]

_NICENESS = 10

#: Longest time that a clip may take, s.
_LONGEST_SECONDS = 60.0


class CutterLostError(Exception):
    """The process was lost before it answered, or ended because it had not in time.

    Attributes
    ----------
    was_late : bool
        Whether it had time enough.
    """

    def __init__(self, *, was_late: bool) -> None:
        late = f"the process that cuts it took more than {_LONGEST_SECONDS:g} s"
        super().__init__(late if was_late else "the process that cuts it was lost")
        self.was_late = was_late


class Cutter:
    """The process, from the point of view of the run; it is started when there is something to cut."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False

    def cut(self, request: CutRequest) -> str | None:
        """Make a clip; return why it could not be made.

        Raises
        ------
        CutterLostError
        """
        process = self._started()
        assert process.stdin is not None  # pipes
        assert process.stdout is not None
        answer, is_late = b"", threading.Event()

        def give_up() -> None:
            is_late.set()
            process.kill()

        timer = threading.Timer(_LONGEST_SECONDS, give_up)
        timer.daemon = True
        timer.start()
        with suppress(OSError):
            process.stdin.write(json.dumps(asdict(request)).encode() + b"\n")
            process.stdin.flush()
            answer = process.stdout.readline()
        timer.cancel()
        if not answer.endswith(b"\n"):
            self._end()
            raise CutterLostError(was_late=is_late.is_set())
        fault = json.loads(answer)
        return None if fault is None else str(fault)

    def close(self) -> None:
        """End the process, whatever it is at."""
        self._closed = True
        self._end()

    def _started(self) -> subprocess.Popen[bytes]:
        if self._closed:
            raise CutterLostError(was_late=False)
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__],
                cwd=PACKAGE_ROOT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # a signal to the command's group ends what it is at in order
            )
        return self._process

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            with suppress(OSError), process:  # closes the pipes, which it may have broken
                process.kill()


def _fault(request: CutRequest) -> str | None:
    try:
        with av.logging.Capture():
            return None if cut(request) else ""
    except MlbsError as error:
        return str(error)
    except (av.error.FFmpegError, OSError) as error:
        return reason(error)
    except ValueError:
        return "its codec cannot be put into an MP4 file"


def _serve() -> None:
    """Answer each request of standard input with a line: null, why there is no clip, or "" for no packets."""
    os.nice(_NICENESS)
    av.logging.set_level(av.logging.ERROR)
    for line in sys.stdin:
        fields = json.loads(line)
        print(json.dumps(_fault(CutRequest(**fields | {"paths": tuple(fields["paths"])}))), flush=True)


if __name__ == "__main__":
    _serve()
