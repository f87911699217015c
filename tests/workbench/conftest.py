"""A running workbench, one whose commands answer at once, and a real browser to look at it with."""

from __future__ import annotations

import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pcalib.workbench import server, worker
from pcalib.workbench.server import Workbench

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture
def running(tmp_path) -> Iterator[tuple[int, Workbench]]:
    """Port and workbench."""
    served, bench = server.serve(tmp_path / "session")
    thread = threading.Thread(target=lambda: served.serve_forever(0.02), daemon=True)
    thread.start()
    yield served.server_address[1], bench
    served.shutdown()
    served.server_close()
    bench.worker.close()


@pytest.fixture
def canned(running, monkeypatch) -> tuple[int, Workbench]:
    """A workbench whose commands write at once what they would; they wait while the folder has a file 'hold'."""
    monkeypatch.setattr(worker, "PROGRAM", (sys.executable, str(Path(__file__).parent / "canned.py")))
    return running


@pytest.fixture(scope="session")
def browser() -> Iterator:
    """Debian's Chromium."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine (Debian: chromium)")
    with api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture
def look(browser) -> Iterator[Callable]:
    """look(running, **how the browser is set) → a page that shows the workbench; no script of it may fail."""
    contexts, wrong = [], []

    def noted(message) -> None:
        if "Content Security" in message.text:
            wrong.append(message.text)

    def show(running: tuple[int, Workbench], **how):
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 720}} | how)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", noted)
        page.goto(f"http://127.0.0.1:{running[0]}/{running[1].token}/")
        return page

    yield show
    for context in contexts:
        context.close()
    assert not wrong
