"""One thread for BLAS and OpenMP: limited, restored, and also for libraries that are loaded later."""

import sys
from types import ModuleType

import pytest
from threadpoolctl import ThreadpoolController, threadpool_info, threadpool_limits

from counterlight.tools import jobs


def threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info()]


def test_one_thread_is_a_limit_until_the_context_is_left() -> None:
    with threadpool_limits(limits=2):
        assert set(threads()) == {2}
        with jobs.one_thread():
            assert set(threads()) == {1}
        assert set(threads()) == {2}


def test_libraries_are_found_again_after_a_module_was_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []

    def controller() -> ThreadpoolController:
        found.append(ThreadpoolController())
        return found[-1]

    monkeypatch.setattr(jobs, "ThreadpoolController", controller)
    monkeypatch.setitem(sys.modules, "first", ModuleType("first"))
    for _ in range(2):
        with jobs.one_thread():
            assert len(found) == 1
    monkeypatch.setitem(sys.modules, "second", ModuleType("second"))
    with jobs.one_thread():
        assert len(found) == 2
