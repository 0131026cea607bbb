"""A headless Chromium, spoken to through two pipes in its DevTools protocol: no library is needed for that."""

import base64
import fcntl
import itertools
import json
import os
import select
import shutil
import subprocess
import time
from os import PathLike
from typing import Any, Self

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
    "--remote-debugging-pipe",
)  # fmt: skip


def find() -> str | None:
    """The path of a Chromium, or None."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """One page of a browser of its own, which ends with the block."""

    def __init__(self, profile: str | PathLike[str], width: int = 1400, height: int = 900, dark: bool = False) -> None:
        reads, self._to = (self._high(fd) for fd in os.pipe())
        self._from, writes = (self._high(fd) for fd in os.pipe())

        def connect() -> None:
            os.dup2(reads, 3)
            os.dup2(writes, 4)

        command = [
            find() or NAMES[0],
            *_OPTIONS,
            f"--user-data-dir={profile}",
            f"--window-size={width},{height}",
            "about:blank",
        ]
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen(command, preexec_fn=connect, pass_fds=(3, 4), stdout=quiet, stderr=quiet)
        os.close(reads)
        os.close(writes)
        self._numbers, self._rest = itertools.count(1), b""
        self.events: list[Any] = []
        self._session: str | None = None
        target = next(t for t in self.call("Target.getTargets")["targetInfos"] if t["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = attached["sessionId"]
        self.call("Page.enable")
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        if dark:
            scheme = [{"name": "prefers-color-scheme", "value": "dark"}]
            self.call("Emulation.setEmulatedMedia", features=scheme)

    @staticmethod
    def _high(fd: int) -> int:
        """A copy whose number is neither 3 nor 4, which the browser takes for the pipes."""
        high = fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 10)
        os.close(fd)
        return high

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def call(self, method: str, **parameters: Any) -> Any:
        """Send a command and return its result; what happens meanwhile goes to `events`."""
        number = next(self._numbers)
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next(60.0)
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self.events.append(answer)

    def open(self, url: str, seconds: float) -> None:
        """Load a page and let it draw for some seconds."""
        self.call("Page.navigate", url=url)
        self.wait(seconds)

    def wait(self, seconds: float) -> None:
        """Let the page go on."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            if (event := self._next(left, needed=False)) is not None:
                self.events.append(event)

    def screenshot(self) -> bytes:
        """The page as it is, as the content of a PNG file."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def _next(self, seconds: float, needed: bool = True) -> Any:
        end = time.monotonic() + seconds
        while b"\0" not in self._rest:
            left = max(end - time.monotonic(), 0.0)
            if not select.select([self._from], [], [], left)[0]:
                if needed:
                    raise TimeoutError(f"the browser did not answer within {seconds:.0f} s")
                return None
            content = os.read(self._from, 1 << 20)
            if not content:
                raise RuntimeError("the browser has ended")
            self._rest += content
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)
