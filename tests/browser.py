"""A headless Chromium that a test drives through its DevTools protocol, and that remembers what went wrong."""

import json
import shutil
import subprocess
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, sleep
from typing import Any
from urllib.request import ProxyHandler, build_opener

import pytest

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--remote-debugging-port=0",
)  # fmt: skip
KEYS = {"Enter": ("\r", 13), "Tab": ("\t", 9), "ArrowDown": ("", 40), "ArrowUp": ("", 38)}
PATIENCE_s = 60.0
APART = """(() => {
  const boxes = (parts) => [...document.querySelectorAll(parts)].map((part) => part.getBoundingClientRect());
  const meet = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  const names = boxes("#plot .annotation-text"), marks = boxes("#plot .points path"), width = document.body.clientWidth;
  return [names.length, names.filter((name, i) => names.some((other, j) => i < j && meet(name, other))).length,
    names.filter((name) => marks.some((mark) => meet(name, mark)) || name.left < 0 || name.right > width).length];
})()"""
"""The names of points in a plot: how many there are, how many meet another name, and a mark or the edge of the page."""


class Browser:
    """Complaints are console errors and exceptions; `requests` the addresses that the page last opened asked for."""

    def __init__(self, socket: Any):
        self._socket = socket
        self._calls = 0
        self.complaints: list[str] = []
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._calls += 1
        self._socket.send(json.dumps({"id": self._calls, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=PATIENCE_s))
            if message.get("id") == self._calls:
                assert "error" not in message, message
                return message["result"]
            self._hear(message)

    def _hear(self, message: dict[str, Any]) -> None:
        what, parameters = message.get("method"), message.get("params", {})
        if what == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])
        elif what == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(parameters["exceptionDetails"]))
        elif what == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "warning", "assert"):
            self.complaints.append(json.dumps(parameters["args"]))
        elif what == "Log.entryAdded" and parameters["entry"]["level"] in ("error", "warning"):
            self.complaints.append(parameters["entry"]["text"])

    def open(
        self, page: Path | str, width: int, height: int = 900, scheme: str = "light", motion: str = "reduce"
    ) -> None:
        self.requests.clear()
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        features = [
            {"name": "prefers-color-scheme", "value": scheme},
            {"name": "prefers-reduced-motion", "value": motion},
        ]
        self.call("Emulation.setEmulatedMedia", features=features)
        self.call("Page.navigate", url=page if isinstance(page, str) else page.as_uri())
        self.wait_for("document.readyState === 'complete'")

    def evaluate(self, script: str) -> Any:
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait_for(self, condition: str) -> None:
        end = monotonic() + PATIENCE_s
        while not self.evaluate(f"Boolean({condition})"):
            assert monotonic() < end, f"never came true: {condition}; complaints: {self.complaints}"
            sleep(0.05)

    def assert_accessible(self) -> None:
        """Every part of the page, opened, passes the checks of axe; skips where there is no axe."""
        axe = pytest.importorskip("axe_core_python", reason="no axe here; pip install axe-core-python")
        self.evaluate(Path(axe.__file__).with_name("axe.min.js").read_text(encoding="utf-8") + ";0")
        self.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
        found = self.evaluate("axe.run().then(({ violations }) => JSON.stringify(violations))")
        assert [(each["id"], [node["html"] for node in each["nodes"]]) for each in json.loads(found)] == []

    def click(self, x: float, y: float) -> None:
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        sleep(0.2)  # plotly hovers before it takes a click
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def press(self, key: str) -> None:
        text, code = KEYS[key]
        given = {"key": key, "code": key, "windowsVirtualKeyCode": code}
        self.call("Input.dispatchKeyEvent", type="keyDown", **given, **({"text": text} if key == "Enter" else {}))
        self.call("Input.dispatchKeyEvent", type="keyUp", **given)

    def screenshot(self, path: Path, whole: bool = False) -> None:
        shot = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(b64decode(shot["data"]))


@contextmanager
def browser(profile: Path) -> Iterator[Browser]:
    """A browser with a new profile; the test is skipped where there is no Chromium or no websockets."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("no chromium on this machine; install one to test pages")
    client = pytest.importorskip("websockets.sync.client", reason="no websockets here; pip install websockets")
    process = subprocess.Popen(
        [chromium, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        port = _port(profile / "DevToolsActivePort", process)
        with client.connect(_page_address(port), max_size=None, proxy=None) as socket:
            yield Browser(socket)
    finally:
        process.terminate()
        process.wait(timeout=PATIENCE_s)


def _port(path: Path, process: subprocess.Popen) -> int:
    end = monotonic() + PATIENCE_s
    while not (path.is_file() and path.read_text().strip()):
        assert process.poll() is None, "chromium ended before it could be reached"
        assert monotonic() < end, "chromium did not open its DevTools"
        sleep(0.05)
    return int(path.read_text().split()[0])


def _page_address(port: int) -> str:
    with build_opener(ProxyHandler({})).open(f"http://127.0.0.1:{port}/json", timeout=PATIENCE_s) as answer:
        return next(target["webSocketDebuggerUrl"] for target in json.load(answer) if target["type"] == "page")
