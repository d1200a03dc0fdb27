"""Copies of an interpreter that has imported the product behave like a newly started program."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.copies import Copy, read_early

SCRIPT = """
import counterlight.maps.products
import atexit, json, multiprocessing.process, os, resource, signal, sys, tempfile, threading
print(json.dumps({
    "name": __name__, "file": globals().get("__file__"), "words": sys.argv, "path": sys.path, "flags": list(sys.flags),
    "folder": [os.getcwd(), multiprocessing.process.ORIGINAL_DIR], "temporary": tempfile.gettempdir(),
    "environment": dict(os.environ), "open": [n for n in range(99) if os.path.exists(f"/proc/self/fd/{n}")],
    "umask": os.umask(0), "limit": resource.getrlimit(resource.RLIMIT_CORE), "threads": threading.active_count(),
    "signals": [str(signal.getsignal(n)) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE)],
    "streams": [[each.encoding, each.errors, each.isatty(), each.line_buffering] for each in (sys.stdout, sys.stderr)],
    "tests": [name for name in sys.modules if name.partition(".")[0] == "tests"],
}))
print("to stderr", file=sys.stderr)
atexit.register(print, "at exit", file=sys.stderr)
threading.Thread(target=lambda: (threading.main_thread().join(), print("a thread", file=sys.stderr))).start()
sys.exit(int(sys.argv[1]))
"""


@pytest.mark.parametrize("program", [["FOLDER/script.py"], ["-m", "script"], ["-c", SCRIPT]], ids=["", "-m", "-c"])
def test_a_copy_finds_what_a_program_started_anew_finds(program: list[str], tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    program = [word.replace("FOLDER", str(tmp_path)) for word in program]
    variables = os.environ | {"TMPDIR": str(tmp_path), "XDG_CONFIG_HOME": "elsewhere"}
    assert not read_early(variables)
    copy = Copy([*program, "7", "ü"], variables, tmp_path, subprocess.PIPE)
    found, errors = copy.communicate(timeout=60)
    words = [sys.executable, *program, "7", "ü"]
    anew = subprocess.run(words, env=variables, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert json.loads(found) == json.loads(anew.stdout)
    assert (errors, copy.returncode, copy.wait()) == (anew.stderr, 7, 7)


def test_a_copy_that_is_killed_says_so_and_its_text_is_there(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text("import time\nprint('begun', flush=True)\ntime.sleep(1000)\n")
    copy = Copy([str(tmp_path / "script.py")], os.environ, tmp_path, None)
    assert copy.stdout.readline() == "begun\n"
    assert copy.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        copy.wait(0.01)
    copy.kill()
    assert copy.communicate() == copy.communicate() == ("", None)
    assert copy.returncode == -signal.SIGKILL
    copy.kill()  # must not kill another process that has this number now


LOOP = """
import numpy as np
from counterlight.passes import combine
loaded = len(combine.combined.dispatcher.signatures)
out, one = np.zeros((2, 6), np.float32), np.ones((2, 6), np.float32)
combine.combined(np.float32(2), one, np.float32(3), one, False, out)
print(loaded, out.sum())
"""


def test_a_copy_has_what_others_have_compiled_and_runs_its_loops(tmp_path: Path) -> None:
    for loaded in ("01", "1"):  # the first copy may have to compile the function
        copy = Copy(["-c", LOOP], os.environ, tmp_path, None)
        found, _ = copy.communicate(timeout=60)
        assert (found[0] in loaded, found[1:], copy.returncode) == (True, " 60.0\n", 0)


def test_what_is_read_during_import_needs_a_new_interpreter() -> None:
    assert read_early(os.environ | {"OPENBLAS_NUM_THREADS": "3"})
    assert read_early({})
