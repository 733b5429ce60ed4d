"""A pytest plugin: runs each coroutine test on an event loop of its own, with a time limit.

A fixture shared by several tests that lives on a loop offers it as `runner`: its tests run there, too.
"""

from __future__ import annotations

import asyncio
import inspect

import pytest

from helpers.waiting import WHOLE_S


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a coroutine test with its fixtures."""
    test = pyfuncitem.obj
    if not inspect.iscoroutinefunction(test):
        return None
    asked = {name: pyfuncitem.funcargs[name] for name in inspect.signature(test).parameters}

    longer = pyfuncitem.get_closest_marker("takes")

    async def bounded() -> None:
        async with asyncio.timeout(WHOLE_S if longer is None else longer.args[0]):
            await test(**asked)

    found = (getattr(fixture, "runner", None) for fixture in asked.values())
    shared = next((runner for runner in found if isinstance(runner, asyncio.Runner)), None)
    (asyncio.run if shared is None else shared.run)(bounded())
    return True
