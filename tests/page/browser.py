"""Chromium, where there is one, with the page of real nodes in it."""

import os
import shutil
import time

import pytest

#: Set where the tests in a browser must run, as in CI.
NEEDED = "SQUEAL_RIG_NEEDS_BROWSER"
_NAMES = ("chromium", "chromium-browser", "google-chrome")


def chromium():
    """Path of a Chromium; None where there is none, or nothing to drive it with."""
    try:
        import playwright  # noqa: F401
    except ImportError:
        return None
    return next((path for name in _NAMES if (path := shutil.which(name))), None)


def needs_chromium():
    """Leaves a module out where there is no Chromium; fails where there must be one."""
    if chromium() is None:
        if os.environ.get(NEEDED):
            pytest.fail("the page's tests must run here, and there is no Chromium with playwright", pytrace=False)
        pytest.skip(
            "no Chromium with playwright here: the page's tests in a browser are left out", allow_module_level=True
        )


def launched(playwright):
    """A headless browser."""
    # Without its own sandbox: it is denied to root, and shows nothing but our page.
    return playwright.chromium.launch(
        executable_path=chromium(), args=["--no-sandbox", "--disable-gpu"], timeout=180_000
    )


class Shown:
    """The page in a tab, as an operator uses it."""

    def __init__(self, browser, url, **options):
        self.context = browser.new_context(viewport={"width": 1280, "height": 800}, **options)
        self.tab = self.context.new_page()
        self.troubles = []
        self.tab.on("pageerror", lambda error: self.troubles.append(str(error)))
        self.tab.goto(url, timeout=120_000)
        self.until("page.state() !== null")

    def until(self, expression, patience=120.0):
        """Wait until an expression holds, asked from here: the page's policy forbids what playwright would plant."""
        deadline = time.monotonic() + patience
        while not self.tab.evaluate(expression):
            assert time.monotonic() < deadline, expression
            self.tab.wait_for_timeout(50)

    def answer_to(self, act):
        """What the page tells after an act."""
        self.tab.evaluate("document.getElementById('answer').textContent = ''")
        act()
        text = "document.getElementById('answer').textContent"
        self.until(f"!['', 'EMERGENCY STOP: sent, no answer yet'].includes({text})")
        return self.tab.text_content("#answer")

    def press(self, name):
        return self.answer_to(lambda: self.tab.click(f"[data-do={name}]"))

    def set(self, name, value):
        def act():
            field = self.tab.locator(f"#set-{name}")
            if not field.is_visible():
                self.tab.click("#set-points summary")
            field.fill(str(value))
            field.press("Enter")

        return self.answer_to(act)
