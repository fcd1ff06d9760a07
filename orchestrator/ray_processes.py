"""Starts Ray on this machine and ends it with standard input; run by :mod:`orchestrator.ray_head`.

It imports nothing but Ray, since a run waits for it.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any

__all__: list[str] = []


def _serve(options: dict[str, Any]) -> None:
    """Start Ray, say where, and end it with standard input."""
    import ray

    # What Ray prints must not be taken for the answer.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        ray.init(address="local", include_dashboard=False, log_to_driver=False, **options)
    except Exception as error:
        print(json.dumps({"error": str(error) or type(error).__name__}), file=answers, flush=True)
        return
    print(json.dumps({"address": ray.get_runtime_context().gcs_address}), file=answers, flush=True)
    sys.stdin.read()
    ray.shutdown()


if __name__ == "__main__":
    _serve(json.loads(sys.argv[1]))
