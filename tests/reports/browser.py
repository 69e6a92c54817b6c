"""Headless Chromium driven over its debugging pipe: the DevTools protocol without a library."""

import contextlib
import importlib.util
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
in_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="needs chromium (apt-get install chromium)"
)
_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--hide-scrollbars", "--remote-debugging-pipe",
)  # fmt: skip
_PATIENCE = 60.0  # [s] for an answer


class Browser:
    """One page of a browser of its own.

    Attributes:
        requests: addresses that it has asked for.
        said: console messages, exceptions and violations of the security policy.
    """

    def __init__(self, read, write):
        self._read, self._write, self._last, self._rest = read, write, 0, b""
        self.requests, self.said, self._loaded = [], [], 0
        target = self._call("Target.createTarget", {"url": "about:blank"}, session=None)["targetId"]
        attach = {"targetId": target, "flatten": True}
        self._session = self._call("Target.attachToTarget", attach, session=None)["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self._call(f"{domain}.enable")

    def open(self, path, *, width=1280, height=900, dark=False):
        """Open a file, offline, and wait until it is there."""
        self.resize(width, height, dark=dark)
        self._call("Network.emulateNetworkConditions", {
            "offline": True, "latency": 0, "downloadThroughput": -1, "uploadThroughput": -1,
        })  # fmt: skip
        self.requests.clear()
        before = self._loaded
        self._call("Page.navigate", {"url": Path(path).as_uri()})
        deadline = time.monotonic() + _PATIENCE
        while self._loaded == before and time.monotonic() < deadline:
            self._take(0.05)
        assert self._loaded > before, "the page did not load"

    def resize(self, width, height, *, dark=False):
        """Another window, light or dark."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self._call("Emulation.setDeviceMetricsOverride", size)
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self._call("Emulation.setEmulatedMedia", {"features": features})

    def run(self, script):
        """The value of a JavaScript expression, of a promise what it resolves to."""
        asked = {"expression": script, "awaitPromise": True, "returnByValue": True}
        found = self._call("Runtime.evaluate", asked)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def press(self, key, *, shift=False):
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            event = {"type": kind, "key": key, "code": key, "modifiers": 8 if shift else 0}
            self._call("Input.dispatchKeyEvent", event)

    def mouse(self, kind, x, y):
        """A mouse event of the left button: mousePressed, mouseMoved or mouseReleased."""
        event = {"type": kind, "x": x, "y": y, "button": "left", "clickCount": 1}
        self._call("Input.dispatchMouseEvent", event | {"buttons": int(kind != "mouseReleased")})

    def violations(self):
        """What axe finds that people who cannot see would miss, everything opened."""
        package = importlib.util.find_spec("pytest_playwright_axe")
        if package is None:
            pytest.skip("needs axe: make test has it in .environments")
        axe = Path(package.origin).parent / "resources" / "axe.min.js"
        self.run("document.querySelectorAll('details').forEach((one) => (one.open = true))")
        self.run(axe.read_text(encoding="utf-8") + "; 0")
        found = self.run("axe.run()")["violations"]
        return [(one["id"], [node["html"][:200] for node in one["nodes"]]) for one in found]

    def picture(self):
        """The whole page as PNG, base64."""
        return self._call("Page.captureScreenshot", {"captureBeyondViewport": True, "clip": {
            "x": 0, "y": 0, "scale": 1, "width": self.run("innerWidth"),
            "height": self.run("document.documentElement.scrollHeight"),
        }})["data"]  # fmt: skip

    def _call(self, method, parameters=None, session=""):
        self._last += 1
        message = {"id": self._last, "method": method, "params": parameters or {}}
        if session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + _PATIENCE
        while time.monotonic() < deadline:
            for answer in self._take(0.5):
                if answer.get("id") == self._last:
                    assert "error" not in answer, (method, answer["error"])
                    return answer["result"]
        raise TimeoutError(method)

    def _take(self, wait):
        """Messages that have arrived; events are noted."""
        if not select.select([self._read], [], [], wait)[0]:
            return []
        *whole, self._rest = (self._rest + os.read(self._read, 1 << 20)).split(b"\0")
        messages = [json.loads(text) for text in whole]
        for message in messages:
            self._note(message.get("method"), message.get("params", {}))
        return messages

    def _note(self, method, about):
        if method == "Network.requestWillBeSent":
            self.requests.append(about["request"]["url"])
        elif method == "Page.loadEventFired":
            self._loaded += 1
        elif method == "Runtime.consoleAPICalled":
            self.said.append(str(about["args"]))
        elif method == "Runtime.exceptionThrown":
            self.said.append(json.dumps(about["exceptionDetails"])[:1000])
        elif method == "Log.entryAdded":
            self.said.append(about["entry"]["text"])


@contextlib.contextmanager
def browser():
    """A browser with a profile of its own, gone afterwards."""
    to_read, to_write = os.pipe()
    from_read, from_write = os.pipe()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [CHROMIUM, *_FLAGS, f"--user-data-dir={profile}", "about:blank"]
        # Chromium reads from 3 and writes to 4.
        shell = f'exec 3<&{to_read} 4>&{from_write}; exec "$@"'
        process = subprocess.Popen(
            ["bash", "-c", shell, "chromium", *command], pass_fds=(to_read, from_write),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_read)
        os.close(from_write)
        try:
            yield Browser(from_read, to_write)
        finally:
            process.terminate()
            process.wait(timeout=20)
            os.close(to_write)
            os.close(from_read)
