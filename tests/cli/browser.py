"""A headless Chromium that the tests drive: the DevTools protocol over a web socket, with the standard library alone.

    with browser.open_page(path_of_html, width, height) as page:
        page.evaluate("document.title")
        page.drag((100, 100), (150, 120))
        rows = page.screenshot(folder / "shot.png")
    page.problems lists console errors and exceptions.
"""

import base64
import json
import os
import pathlib
import secrets
import shutil
import socket
import struct
import subprocess
import tempfile
import time
import urllib.request

import support

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


def find():
    """The program, or the test is skipped."""
    for name in [os.environ.get("SVOKIT_CHROMIUM", "")] + list(NAMES):
        path = shutil.which(name) if name else None
        if path:
            return path
    support.skip("NO BROWSER: install chromium (Debian package chromium) or set SVOKIT_CHROMIUM; the page of svo-dump --html was not drawn")


class Socket:
    """As much of RFC 6455 as a client of one server needs."""

    def __init__(self, url, timeout):
        host, _, path = url[len("ws://"):].partition("/")
        name, _, port = host.partition(":")
        self.s = socket.create_connection((name, int(port)), timeout=timeout)
        key = base64.b64encode(secrets.token_bytes(16)).decode()
        self.s.sendall(("GET /%s HTTP/1.1\r\nHost: %s\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: %s\r\n"
                        "Sec-WebSocket-Version: 13\r\n\r\n" % (path, host, key)).encode())
        self.buffer = b""
        while b"\r\n\r\n" not in self.buffer:
            self.buffer += self.s.recv(65536)
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        support.check(b" 101 " in head.split(b"\r\n")[0], head)

    def take(self, n):
        while len(self.buffer) < n:
            more = self.s.recv(1 << 20)
            support.check(more, "the browser hung up")
            self.buffer += more
        out, self.buffer = self.buffer[:n], self.buffer[n:]
        return out

    def send(self, text):
        data, mask = text.encode(), secrets.token_bytes(4)
        n = len(data)
        head = b"\x81" + (bytes([0x80 | n]) if n < 126 else struct.pack(">BH", 0xFE, n) if n < 65536 else struct.pack(">BQ", 0xFF, n))
        self.s.sendall(head + mask + bytes(b ^ mask[i & 3] for i, b in enumerate(data)))

    def receive(self):
        whole = b""
        while True:
            a, b = self.take(2)
            n = b & 127
            n = struct.unpack(">H", self.take(2))[0] if n == 126 else struct.unpack(">Q", self.take(8))[0] if n == 127 else n
            data = self.take(n)
            if a & 15 in (0, 1, 2):
                whole += data
                if a & 0x80:
                    return whole.decode()
            elif a & 15 == 8:
                raise support.Failure("the browser closed the connection")


class Page:
    def __init__(self, process, profile, socket_):
        self.process, self.profile, self.socket, self.count, self.problems = process, profile, socket_, 0, []

    def call(self, method, **params):
        self.count += 1
        self.socket.send(json.dumps({"id": self.count, "method": method, "params": params}))
        while True:
            message = json.loads(self.socket.receive())
            if message.get("id") == self.count:
                support.check("error" not in message, "%s: %s" % (method, message.get("error")))
                return message["result"]
            self.event(message)

    def event(self, message):
        method, params = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.problems.append(params["exceptionDetails"].get("exception", {}).get("description") or params["exceptionDetails"]["text"])
        elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning", "assert"):
            self.problems.append(" ".join(str(a.get("value", a.get("description"))) for a in params["args"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
            text = params["entry"]["text"]
            if "GPU stall due to ReadPixels" not in text and "Automatic fallback to software WebGL" not in text:
                self.problems.append(text)
        elif method == "Network.requestWillBeSent" and not params["request"]["url"].startswith(("file:", "data:", "blob:")):
            self.problems.append("request over the network: " + params["request"]["url"])

    def evaluate(self, text):
        r = self.call("Runtime.evaluate", expression=text, returnByValue=True, awaitPromise=True)
        support.check("exceptionDetails" not in r, "%s: %s" % (text, r.get("exceptionDetails")))
        return r["result"].get("value")

    def wait(self, text, seconds=120):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.evaluate(text):
                return
            time.sleep(0.05)
        raise support.Failure("%s never came true; %s" % (text, self.problems))

    def mouse(self, kind, x, y, **more):
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, begin, end, button="left", modifiers=0):
        buttons = {"left": 1, "right": 2}[button]
        self.mouse("mousePressed", *begin, button=button, buttons=buttons, clickCount=1, modifiers=modifiers)
        for i in range(1, 5):
            self.mouse("mouseMoved", *(b + (e - b) * i / 4 for b, e in zip(begin, end)), button=button, buttons=buttons, modifiers=modifiers)
        self.mouse("mouseReleased", *end, button=button, buttons=0, clickCount=1, modifiers=modifiers)

    def wheel(self, x, y, delta):
        self.mouse("mouseWheel", x, y, deltaX=0, deltaY=delta)

    def screenshot(self, path):
        pathlib.Path(path).write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
        return support.read_png(path)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill() # this one process; its children end with it
        self.process.wait()
        shutil.rmtree(self.profile, ignore_errors=True)


def open_page(path, width=640, height=480, timeout=180):
    program = find()
    profile = tempfile.mkdtemp(prefix="svokit-browser-")
    command = [program, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars",
               "--force-device-scale-factor=1", "--force-color-profile=srgb", "--no-first-run", "--disable-background-networking", "--disable-extensions",
               "--disable-component-update", "--user-data-dir=" + profile, "--window-size=%d,%d" % (width, height), "--remote-debugging-port=0",
               "--remote-allow-origins=*", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port_file, end = pathlib.Path(profile) / "DevToolsActivePort", time.monotonic() + timeout
        while not port_file.exists() or len(port_file.read_text().split("\n")) < 2:
            support.check(process.poll() is None, "the browser did not start")
            support.check(time.monotonic() < end, "the browser did not answer")
            time.sleep(0.05)
        port = int(port_file.read_text().split("\n")[0])
        while True:
            with urllib.request.urlopen("http://127.0.0.1:%d/json/list" % port, timeout=timeout) as r:
                targets = [t for t in json.load(r) if t["type"] == "page"]
            if targets:
                break
            time.sleep(0.05)
        page = Page(process, profile, Socket(targets[0]["webSocketDebuggerUrl"], timeout))
        for domain in ("Runtime", "Log", "Page", "Network"):
            page.call(domain + ".enable")
        page.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        page.call("Page.navigate", url=pathlib.Path(path).resolve().as_uri())
        page.wait("document.readyState === 'complete' && document.body && (document.body.dataset.ready === 'yes' || document.getElementById('problem') !== null && "
                  "!document.getElementById('problem').hidden)", timeout)
        problem = page.evaluate("document.getElementById('problem').textContent")
        support.check(problem == "", "the page says: %s" % problem)
        return page
    except BaseException:
        process.kill()
        process.wait()
        shutil.rmtree(profile, ignore_errors=True)
        raise
