"""Fixtures: seeded random numbers, OpenGL contexts with leak checks, X servers, shared data.

A missing OpenGL context or X server fails the tests instead of skipping them, because the product needs both.
"""

import gc
import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import av
import moderngl
import numpy as np
import pytest
import scipy.linalg  # noqa: F401 (its BLAS, beside numpy's, is there to be limited)
from threadpoolctl import threadpool_limits

from counterlight.gl.context import headless_context
from counterlight.media.decoding.child import all_ended
from counterlight.media.decoding.opening import log_natively
from tests import screens
from tests.gl_objects import live_objects
from tests.media import rings
from tests.programs import PATIENCE_S, descendants
from tests.warm_start import compile_one_at_a_time

ROOT = Path(__file__).resolve().parents[1]
MEMORY, ROOM_BYTES = Path("/dev/shm"), 1 << 30  # bytes that must be free there; a whole run uses a fifth


def _keeps_files(folder: Path) -> bool:
    """Whether a folder has enough free space for the tests and allows programs in it to run."""
    if not folder.is_dir():
        return False
    found = os.statvfs(folder)
    return not found.f_flag & os.ST_NOEXEC and found.f_bavail * found.f_frsize >= ROOM_BYTES


# The product calls fsync before it reports success, which takes longer than everything else on a busy disk.
if _keeps_files(MEMORY):
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))

# BLAS threads wait by spinning: a small matrix takes ten times as long on a busy core, and a program on an idle machine
# loses a third of its processor time. test_wheel.py runs commands with a user's number of threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

compile_one_at_a_time()
log_natively(av.logging.ERROR)  # tests encode in this process

# A script's background jobs ignore Ctrl-C. Tests send Ctrl-C, so restore its handler for pytest and its children.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # nohup ignores SIGHUP; tests close terminals
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


# Files that take a worker long, longest first, so that no worker runs alone at the end.
LONGEST_FIRST = (
    "test_lint.py", "gl/test_audience.py", "test_acquisition.py", "test_supervisor.py", "test_segments.py",
    "test_cluster.py", "test_full_disk.py", "test_unweighted_optimum.py", "gl/test_window.py", "test_study.py",
    "test_import_pairs.py", "test_player.py", "test_factoring.py", "test_playback.py", "gl/test_remote_of_a_show.py",
    "test_worth.py", "test_writing.py", "test_curve.py", "gl/test_player_walk.py", "test_acquiring_several.py",
    "test_real.py", "test_acquisition_bands.py", "gl/test_opening_beside_the_show.py", "test_api.py",
    "gl/test_remote_page.py", "gl/test_in_step_shows.py", "test_averaging.py", "test_hard_cases.py",
    "test_displays.py", "test_watching.py", "test_watching_joint.py", "test_verify_projection.py",
    "test_camera_commands.py", "test_pictures_first.py", "test_questions.py", "gl/test_displays.py",
    "gl/test_memory_of_a_show.py", "gl/test_watched_room.py", "gl/test_drift_of_a_show.py",
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put files of LONGEST_FIRST first; xdist distributes files in this order (--no-loadscope-reorder)."""
    rank = {ROOT / "tests" / name: number for number, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: rank.get(item.path, len(rank)))


@pytest.fixture(scope="module", autouse=True)
def frozen() -> None:
    """Exclude objects of earlier modules from garbage collection, which every test with OpenGL runs.

    Collecting half a million objects takes 0.13 s; after most of the tests there are more than a million.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread in this process, which imported numpy before OPENBLAS_NUM_THREADS was set."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers with a fixed seed."""
    return np.random.default_rng(20060504)


@pytest.fixture
def gl_context() -> Iterator[moderngl.Context]:
    """Fresh OpenGL context through EGL (5 ms each), current in this thread.

    Fails the test if it leaves an OpenGL error or an unreleased object.
    """
    with headless_context() as context, context:
        # moderngl must not release objects by itself: context.objects grows with every object that Python drops.
        context.gc_mode = "context_gc"
        assert context.error == "GL_NO_ERROR"
        before = live_objects()
        yield context
        with context:  # the test may have made another context current
            error, after = context.error, live_objects()
        assert error == "GL_NO_ERROR"
        assert after == before, "OpenGL objects were not released"
        gc.collect()  # moderngl needs the context to drop its objects
    gc.freeze()  # the next collection need not visit the objects that are left


@pytest.fixture(scope="module")
def xvfb(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """DISPLAY of a 1280x720 screen (Xvfb), for programs that tests start.

    Each module has its own server, which starts in 0.2 s. Other modules count this process's children and must find
    none.
    """
    with screens.one_screen(tmp_path_factory.mktemp("xvfb")) as display:
        yield display


@pytest.fixture(scope="module")
def two_monitors(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """DISPLAY of a desktop with DUMMY0, 1280x720 at 0,0 (primary), and DUMMY1, 1024x768 at 1280,0."""
    with screens.two_monitors(tmp_path_factory.mktemp("two_monitors")) as display:
        yield display


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of large test data next to the checkout; it may be absent."""
    return ROOT.parent / "shared" / "data"


@pytest.fixture
def nothing_is_left() -> Iterator[None]:
    """Fail a test that leaves memory of decoded frames or a decoder process."""
    yield
    all_ended()
    assert rings() == []
    assert descendants(os.getpid()) == set()


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    """Socket of a service manager at tmp_path/notify."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as inbox:
        inbox.bind(str(tmp_path / "notify"))
        inbox.settimeout(PATIENCE_S)
        yield inbox
