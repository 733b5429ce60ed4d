"""The engines of browsers that pages are tested in: Chromium, Firefox, and WebKit, which every iPad has."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager

import pytest

from helpers.browser import Browser, browser
from helpers.firefox import PROGRAM, firefox
from helpers.webkit import IS_HERE as HAS_WEBKIT
from helpers.webkit import webkit

Opener = Callable[[], AbstractAsyncContextManager[Browser]]
ENGINES: dict[str, Opener] = {"chromium": browser, "firefox": firefox, "webkit": webkit}
IS_HERE = {
    "chromium": shutil.which("chromium") is not None,
    "firefox": shutil.which(PROGRAM) is not None,
    "webkit": HAS_WEBKIT,
}
BROWSERS = [
    pytest.param(opened, id=name, marks=pytest.mark.skipif(not IS_HERE[name], reason=f"no {name}"))
    for name, opened in ENGINES.items()
]
"""Parameters for tests that must hold in every one."""
