"""A pytest plugin: a test that is a coroutine is run on an event loop of its own, and bounded.

A fixture that several tests share, and that lives on a loop, has it as its `runner`: they run there, too.
"""

from __future__ import annotations

import asyncio
import inspect

import pytest

from helpers.waiting import WHOLE_S


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run it with its fixtures."""
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
