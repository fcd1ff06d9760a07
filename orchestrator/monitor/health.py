"""``python -m orchestrator.monitor.health PORT``: whether the command of this container lives.

It is the image's health check. A command without ``--monitor`` cannot be asked; it lives as long as it runs,
and a container ends with it.
"""

from __future__ import annotations

import sys
from urllib.error import HTTPError, URLError
from urllib.request import ProxyHandler, build_opener

__all__ = ["main"]

_SECONDS = 5.0


def main(port: str) -> int:
    """Ask ``/healthz``; return the exit status: 0 it lives or is not to be asked, 1 it does not answer."""
    try:
        build_opener(ProxyHandler({})).open(f"http://127.0.0.1:{port}/healthz", timeout=_SECONDS).close()
    except HTTPError:
        return 1
    except URLError as error:
        return 0 if isinstance(error.reason, ConnectionRefusedError) else 1
    except OSError:  # no answer in time
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
