# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium, driven by its DevTools protocol over a WebSocket."""

import base64
import itertools
import json
import re
import shutil
import subprocess
from contextlib import contextmanager

import cv2
import numpy as np
from websockets.sync.client import connect

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
                None)
# A profile of its own; 3D in software, as build machines have no GPU.
_OPTIONS = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-first-run",
            "--disable-background-networking", "--disable-extensions", "--disable-sync",
            "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
            "--remote-debugging-port=0", "--remote-allow-origins=*"]
_TIMEOUT_S = 200.0


class Page:
    """One tab.

    Attributes:
        requests: URLs that were asked for, in order, but for those of data.
        errors: what the console and the policy complained about.
    """

    def __init__(self, socket):
        self.requests, self.errors = [], []
        self._socket, self._numbers, self._loads = socket, itertools.count(1), 0
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method, **params):
        """Returns the result of a command; notes what happens meanwhile."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while (message := self._next_message()).get("id") != number:
            pass
        assert "error" not in message, message
        return message["result"]

    def _next_message(self):
        """Returns the next message, and notes what it says happened."""
        message = json.loads(self._socket.recv(timeout=_TIMEOUT_S))
        method, params = message.get("method"), message.get("params", {})
        if method == "Network.requestWillBeSent":
            url = params["request"]["url"]
            if not url.startswith(("data:", "blob:")):
                self.requests.append(url)
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])
        elif method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(params["exceptionDetails"]))
        self._loads += method == "Page.loadEventFired"
        return message

    def look(self, width, height=900, dark=False, script=True, media="screen"):
        """Sets what the page is looked at with; before it is opened."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=width < 600)
        self.call("Emulation.setScriptExecutionDisabled", value=not script)
        self.call("Emulation.setEmulatedMedia", media=media, features=[
            {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}])

    def open(self, path):
        """Opens a file, forgets what was noted before, and waits until the page is there."""
        self.requests, self.errors, before = [], [], self._loads
        self.call("Page.navigate", url=path.as_uri())
        while self._loads == before:
            self._next_message()

    def value(self, expression):
        """Returns the value of a JavaScript expression, awaited."""
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True,
                           returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def screenshot(self, selector):
        """Returns (h, w, 3) uint8 BGR of an element, as far as the window shows it."""
        left, top, right, bottom = self.value(
            f"(() => {{ const shown = document.querySelector('{selector}'); "
            "shown.scrollIntoView(); const b = shown.getBoundingClientRect(); "
            "return [b.left, b.top, b.right, b.bottom].map(Math.round); })()")
        picture = self._captured()
        return picture[max(top, 0):bottom, max(left, 0):right]

    def whole_page(self):
        """Returns (h, w, 3) uint8 BGR of the whole page, however long."""
        return self._captured(captureBeyondViewport=True)

    def _captured(self, **how):
        data = self.call("Page.captureScreenshot", **how)["data"]
        return cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)

    def pdf(self):
        """Returns the bytes of the page as a PDF, in the size that its style sheet says."""
        return base64.b64decode(self.call("Page.printToPDF", preferCSSPageSize=True,
                                          printBackground=True)["data"])


@contextmanager
def browser_page(profile):
    """Starts the browser with a profile in a folder; gives one page, and ends the browser."""
    process = subprocess.Popen([CHROMIUM, *_OPTIONS, f"--user-data-dir={profile}", "about:blank"],
                               stderr=subprocess.PIPE, text=True)
    try:
        port = next(found[1] for line in process.stderr
                    if (found := re.search(r"DevTools listening on ws://[^:]+:(\d+)/", line)))
        with connect(f"ws://127.0.0.1:{port}{_target(port)}", max_size=None,
                     compression=None) as socket:
            yield Page(socket)
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


def _target(port):
    """The path of the only tab's socket."""
    import urllib.request

    with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=30) as answer:
        return next(tab["webSocketDebuggerUrl"] for tab in json.load(answer)
                    if tab["type"] == "page").split(str(port), 1)[1]
