"""Runs commands in copies of an interpreter that has imported the product. Small commands spend their time on imports.

    python tests/warm_start.py SOCKET      # file descriptor of the requests; the server ends when it is closed

Each request is forked: a process with its own arguments, environment, folder, limits and streams runs a script, a
module (-m) or code (-c) as Python does, and ends as Python does. The server has imported modules and loaded compiled
functions, and called nothing. copies.py uses the server. FRESH=1 runs every command in a new interpreter; test_wheel.py
always does so.
"""

import atexit
import contextlib
import fcntl
import gc
import importlib
import json
import multiprocessing.process
import os
import pkgutil
import resource
import runpy
import selectors
import signal
import socket
import sys
import tempfile
import threading
import types
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

LIBRARIES = (
    "numpy", "scipy.sparse.csgraph", "scipy.sparse.linalg", "scipy.linalg", "scipy.ndimage", "scipy.optimize",
    "numba", "cv2", "av", "OpenEXR", "PIL.ImageFont", "moderngl", "glfw",
    "threadpoolctl", "tqdm", "argcomplete", "importlib.metadata", "skimage.metrics", "colour",
)  # fmt: skip
PRODUCT = "counterlight"
LIMITS = [value for name, value in sorted(vars(resource).items()) if name.startswith("RLIMIT_")]
MOST_BYTES = 1 << 18
STREAMS = 3
Request = dict[str, Any]


def import_all() -> dict[str, str]:
    """Import libraries and the product; returns the environment variables that the product has set."""
    for name in LIBRARIES:
        importlib.import_module(name)
    before = dict(os.environ)
    importlib.import_module(PRODUCT)
    for module in pkgutil.walk_packages(sys.modules[PRODUCT].__path__, f"{PRODUCT}."):
        if not module.name.endswith(".__main__"):
            importlib.import_module(module.name)
    from numba.core.registry import cpu_target

    cpu_target.typing_context.refresh()  # the first compiled function would do the same
    cpu_target.target_context.refresh()
    gc.collect()
    gc.freeze()  # copies share the memory pages
    return {name: value for name, value in os.environ.items() if before.get(name) != value}


def compile_one_at_a_time() -> None:
    """Let one process at a time compile functions that Numba caches. The others wait, and load what it has compiled."""
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    compile_here = Dispatcher.compile
    is_locked = False

    def compile_alone(self: Any, signature: Any) -> Any:
        nonlocal is_locked
        with global_compiler_lock:
            # the function that is compiled also compiles those that it calls
            if is_locked or not self.stats.cache_path:
                return compile_here(self, signature)
            with open(__file__, "rb") as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                is_locked = True
                try:
                    return compile_here(self, signature)
                finally:
                    is_locked = False

    Dispatcher.compile = compile_alone


class Kernels:
    """The product's compiled functions, loaded from Numba's cache once for all copies. Loading takes 0.1 to 0.5 s."""

    def __init__(self) -> None:
        from numba.core.dispatcher import Dispatcher
        from numba.np.ufunc import parallel

        from counterlight.passes.kernel import dispatchers

        parallel._backend_init_process_lock = (
            contextlib.nullcontext()
        )  # a copy that is killed must hold no lock of others
        modules = [module for name, module in sys.modules.items() if name.partition(".")[0] == PRODUCT]
        found = {id(each): each for module in modules for each in _flat(vars(module).values())}
        found |= {id(each): each for each, _ in dispatchers()}
        self._functions: list[Any] = [
            each for each in found.values() if isinstance(each, Dispatcher) and each.stats.cache_path
        ]
        self._known: dict[Path, int] = {}
        os.register_at_fork(after_in_child=self._restart_threads)

    def load(self) -> None:
        """Load what other processes have compiled since the last call."""
        for function in self._functions:
            file = getattr(function, "_cache")._cache_file  # noqa: B009
            index = Path(file._index_path)
            with contextlib.suppress(OSError):
                if self._known.get(index) != (changed := index.stat().st_mtime_ns):
                    self._known[index] = changed
                    for signature, *_ in file._load_index():
                        function.compile(signature)

    def _restart_threads(self) -> None:
        """Let OpenMP start its threads in this process. None runs before the first loop, and no loop ran before."""
        from numba.np.ufunc import parallel

        if parallel._is_initialized:
            parallel._is_initialized = False
            parallel._launch_threads()


def _flat(values: Iterable[Any]) -> Iterator[Any]:
    for value in values:
        yield from value if isinstance(value, tuple) else (value,)


def request_here(words: list[str], environment: dict[str, str], folder: Path) -> bytes:
    """Return the settings that this process would pass to a program that it starts in a folder."""
    limits = [(which, *resource.getrlimit(which)) for which in LIMITS]
    umask = os.umask(0)
    os.umask(umask)
    made = {"words": words, "environment": environment, "folder": str(folder), "limits": limits, "umask": umask}
    return json.dumps(made).encode()


def served(requests: socket.socket) -> tuple[Request, list[int]] | None:
    """Fork for each request and report its exit; return in each copy, and without a request at the end."""
    kernels = Kernels()
    running: dict[int, tuple[int, int]] = {}
    with selectors.DefaultSelector() as selector:
        selector.register(requests, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.fd != requests.fileno():
                    selector.unregister(key.fd)
                    _tell_end(key.fd, *running.pop(key.fd))
                    continue
                data, descriptors, _, _ = socket.recv_fds(requests, MOST_BYTES, STREAMS + 1)
                if not data:
                    return None
                kernels.load()
                if not (pid := os.fork()):
                    return json.loads(data), descriptors[:STREAMS]
                *streams, reply = descriptors
                for descriptor in streams:
                    os.close(descriptor)
                _tell(reply, pid)
                running[watch := os.pidfd_open(pid)] = pid, reply
                selector.register(watch, selectors.EVENT_READ)


def _tell(reply: int, number: int) -> None:
    with contextlib.suppress(BrokenPipeError):  # the client has gone
        os.write(reply, b"%d\n" % number)


def _tell_end(watch: int, pid: int, reply: int) -> None:
    _tell(reply, os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
    os.close(reply)
    os.close(watch)


def become(request: Request, streams: list[int], imported: dict[str, str]) -> None:
    """Run a script as a freshly started program with only its streams open.

    imported : environment variables that the product set during import.
    """
    for number, descriptor in enumerate(streams):
        os.dup2(descriptor, number)
    os.closerange(STREAMS, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.clear()
    os.environ.update(imported | request["environment"])
    os.chdir(request["folder"])
    os.umask(request["umask"])
    for which, soft, hard in request["limits"]:
        resource.setrlimit(which, (soft, hard))
    multiprocessing.process.ORIGINAL_DIR = request["folder"]  # type: ignore[attr-defined]
    tempfile.tempdir = None
    try:
        _run(request["words"])
    except SystemExit as ending:
        _end(ending)
        raise


def _run(words: list[str]) -> None:
    """Run a script, `-m MODULE` or `-c CODE`, as `python` would with these words."""
    first, *rest = words
    if first == "-m":
        sys.argv, sys.path[0] = words[1:], os.getcwd()
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    elif first == "-c":
        sys.argv, sys.path[0] = ["-c", *rest[1:]], ""
        sys.modules["__main__"] = main = types.ModuleType("__main__")
        exec(rest[0], vars(main))
    else:
        sys.argv, sys.path[0] = words, os.path.dirname(first)
        runpy.run_path(first, run_name="__main__")


def _end(ending: SystemExit) -> None:
    """End as Python does, but release no objects: releasing copies the server's pages and takes 0.2 s.

    Returns if Python has an error to report at the end.
    """
    code = 0 if ending.code is None else ending.code
    if isinstance(code, int):
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
        # the disk is full, the reader has closed, or the stream is closed
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code & 0xFF)


def main() -> None:
    if os.fork():  # the server must not be a child of a test, because tests count their children
        os._exit(0)
    imported = import_all()
    compile_one_at_a_time()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the copies and the client
    with socket.socket(fileno=int(sys.argv[1])) as requests:
        wanted = served(requests)
    if wanted:
        become(*wanted, imported)


if __name__ == "__main__":
    main()
