"""A page opened in a headless Chromium, as far as there is one on this machine."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@dataclass(frozen=True)
class Page:
    """What became of a page: its document after the scripts have run, and what it wrote to the console."""

    document: str
    console: list[str]


def open_page(url: str, *, seconds: float = 0.0) -> Page:
    """Open a page, wait for what it loads and, if asked to, so long in the page's own time; else skip."""
    program = next((path for name in _NAMES if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium on this machine: install the package chromium to look at pages")
    ended = subprocess.run(
        [
            program,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--enable-logging=stderr",
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
            *([f"--virtual-time-budget={round(1000 * seconds)}"] if seconds else []),
            "--dump-dom",
            url,
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    return Page(ended.stdout, re.findall(r"CONSOLE[^\]]*\] (.*)", ended.stderr))
