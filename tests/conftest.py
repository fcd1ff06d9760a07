"""One Ray session for all tests: starting one takes seconds."""

from __future__ import annotations

import gc
import logging
import secrets
import warnings
from collections.abc import Iterator

import pytest
import ray


@pytest.fixture(scope="session")
def ray_session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """An embedded Ray session on this machine, with a token of its own; never one that runs already."""
    token = tmp_path_factory.mktemp("ray") / "token"
    token.write_text(secrets.token_hex(32))
    with pytest.MonkeyPatch.context() as environment:
        environment.delenv("RAY_ADDRESS", raising=False)
        environment.setenv("RAY_AUTH_TOKEN_PATH", str(token))
        ray.init(
            address="local",
            num_cpus=2,
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
            object_store_memory=200_000_000,
        )
        yield
        ray.shutdown()
        with warnings.catch_warnings():
            # Ray drops the handles of the processes it has ended without waiting for them.
            warnings.simplefilter("ignore", ResourceWarning)
            gc.collect()
