"""What all tests share: a Ray session, a finished run and a labelled clip, which take seconds to make."""

from __future__ import annotations

import gc
import logging
import os
import secrets
import signal
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
import ray
from actor_fakes import ON_RAY, FakeParts, RaySession
from hypothesis import settings
from labelled_clip import LabelledClip
from thread_host import threads
from whole_run import FinishedRun, run_mixed_sources

from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.pipeline import Node
from orchestrator.early_signals import exit_on_signals
from orchestrator.interruption import Interruption

_OBJECT_STORE_BYTES = 100_000_000
_SIGNALS = (signal.SIGINT, signal.SIGTERM)

# How long an example takes says nothing on a machine that does other things, too.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.hookimpl(tryfirst=True)  # pytest-xdist reads the marks in its own hook
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave all tests of what takes seconds to make to one process, so that it is made once."""
    for item in items:
        for shared in ("ray_session", "finished_run", "video_run", "clip"):
            if isinstance(item, pytest.Function) and shared in item.fixturenames:
                # The cases on Ray ask for its session while they run; their mark says where.
                group = "ray" if shared == "ray_session" else shared
                item.add_marker(pytest.mark.xdist_group(group))


@pytest.fixture(scope="session")
def ray_session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RaySession]:
    """An embedded Ray session on this machine, with a token of its own; never one that runs already."""
    token = tmp_path_factory.mktemp("ray") / "token"
    token.write_text(secrets.token_hex(32))
    with pytest.MonkeyPatch.context() as environment:
        environment.delenv("RAY_ADDRESS", raising=False)
        environment.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else Ray warns
        environment.setenv("RAY_AUTH_TOKEN_PATH", str(token))
        for folder in ("actors/stream", "actors/node", "actors", "fakes"):  # what processes unpickle
            environment.setenv("PYTHONPATH", str(Path(__file__).parent / folder), prepend=os.pathsep)
        context = ray.init(
            address="local",
            num_cpus=2,
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
            object_store_memory=_OBJECT_STORE_BYTES,
        )
        yield RaySession(Path(vars(context)["address_info"]["session_dir"]), _OBJECT_STORE_BYTES)
        ray.shutdown()
        with warnings.catch_warnings():
            # Ray drops the handles of the processes it has ended without waiting for them.
            warnings.simplefilter("ignore", ResourceWarning)
            gc.collect()


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """A run of the command over good, damaged and missing sources; its files must stay as they are."""
    return run_mixed_sources(tmp_path_factory.mktemp("finished"))


@pytest.fixture(scope="session")
def clip() -> LabelledClip:
    """Forty frames of a moving camera and two moving objects, as the engine labels them."""
    return LabelledClip.of("demo", frames=40, width=320, height=240)


@pytest.fixture
def signals_exit() -> Iterator[None]:
    """Let SIGINT and SIGTERM do what they do in the command once its streams have ended."""
    handlers, hook = {number: signal.getsignal(number) for number in _SIGNALS}, sys.unraisablehook
    exit_on_signals()
    with Interruption(lambda words: None):
        pass
    yield
    exit_on_signals()  # which forgets the signals of the test
    sys.unraisablehook = hook
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.fixture
def parts(tmp_path: Path) -> FakeParts:
    """Parts of a stream that do next to nothing; a test that wants others has a fixture of its own."""
    folder = tmp_path / "parts"
    folder.mkdir()
    return FakeParts(folder)


@pytest.fixture(scope="session")
def ray_node(ray_session: RaySession, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Node]:
    """This machine, for tests that leave its processes as they are: to start these takes seconds."""
    node = Node(parts=FakeParts(tmp_path_factory.mktemp("parts")), policy=PoolPolicy(spare=2))
    yield node
    node.close()


@pytest.fixture(
    params=[
        "threads",
        pytest.param("ray", marks=(*ON_RAY, pytest.mark.long)),
    ]
)
def host(request: pytest.FixtureRequest) -> Iterator[str]:
    """What runs the actors: threads, which start at once, and among the long tests Ray."""
    name: str = request.param
    if name == "ray":
        request.getfixturevalue("ray_session")
        yield name
    else:
        with threads():
            yield name


@pytest.fixture
def node(host: str, request: pytest.FixtureRequest, parts: FakeParts) -> Iterator[Node]:
    """This machine, for tests that leave its processes as they are."""
    if host == "ray":
        yield request.getfixturevalue("ray_node")
        return
    node = Node(parts=parts, policy=PoolPolicy(spare=2))
    yield node
    node.close()


@pytest.fixture
def own_node(host: str, parts: FakeParts) -> Iterator[Node]:
    """This machine, for one test, with one spare layer process."""
    node = Node(parts=parts, policy=PoolPolicy(spare=1, idle_seconds=0.5))
    yield node
    node.close()
