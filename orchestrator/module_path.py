"""Where the modules of a run come from: never from the working folder, which may hold anything.

``python -m`` looks for modules in the working folder first. A file ``queue.py`` beside a video, perhaps from
somebody else, would be run instead of the module that is meant.
"""

import sys

__all__ = ["PACKAGE_ROOT", "is_being_started", "leave_working_folder"]

#: The folder in which this package lies.
PACKAGE_ROOT = __file__.rpartition("/")[0].rpartition("/")[0]


def is_being_started(argv: list[str], words: list[str]) -> bool:
    """Whether ``python -m`` is looking for a module of this package, to run it.

    Parameters
    ----------
    argv : list of str
        ``sys.argv``, which begins with ``-m`` as long as the module is looked for.
    words : list of str
        ``sys.orig_argv``.
    """
    package = __name__.partition(".")[0]
    named = [word.removeprefix("-m").partition(".")[0] for word in words]
    return argv[:1] == ["-m"] and package in named


def leave_working_folder() -> None:
    """Stop looking for modules in the working folder; look in the package's own one instead, last.

    Nothing may be imported before, except what Python has imported itself: it could come from that folder.
    """
    if not (sys.flags.isolated or getattr(sys.flags, "safe_path", False)):  # safe_path: from Python 3.11
        del sys.path[0]
    if PACKAGE_ROOT not in sys.path:
        sys.path.append(PACKAGE_ROOT)
