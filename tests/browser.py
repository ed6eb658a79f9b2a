"""A page of ours in Chromium, as a user sees it; it may say nothing on the console and ask for nothing but itself."""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


@contextlib.contextmanager
def opened(page: Path, width: int = 390, scheme: str = "dark") -> Iterator[Any]:
    """A tab with the page; the test is skipped where there is no browser."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("no Chromium on the path")
    playwright = pytest.importorskip("playwright.sync_api")
    said: list[str] = []
    requests: list[str] = []
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=chromium, args=list(ARGUMENTS))
        tab = browser.new_context(viewport={"width": width, "height": 844}, color_scheme=scheme).new_page()
        tab.set_default_timeout(60_000)  # a busy machine is no mistake
        tab.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
        tab.on("pageerror", lambda error: said.append(str(error)))
        tab.on("dialog", lambda dialog: said.append(dialog.message))
        tab.on("request", lambda request: requests.append(request.url))
        tab.goto(page.as_uri())
        yield tab
        browser.close()
    assert said == []
    assert {url.partition("#")[0] for url in requests if not url.startswith("data:")} == {page.as_uri()}
