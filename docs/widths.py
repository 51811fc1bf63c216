"""Says which pages of a site or a report are wider than a screen, and which code is wider than its box.

    python -m docs.widths site                    # after `make docs`, which runs it
    python -m docs.widths runs/cornell_reflectance

Chromium opens each page in frames of 1280 and 390 pixels; boxes of code are measured at 1280, but for those of plugins and
reports. Without Chromium nothing is looked at, and a line says so.
"""

from __future__ import annotations

import functools
import json
import shutil
import subprocess
import sys
import tempfile
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Queue
from threading import Thread

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
WIDTHS = (1280, 390)
LIMIT = 300  # seconds
SCRIPT = """<!doctype html><body><script>
function sticksOut(element, width) {  // and not in a box that scrolls by itself
  if (element.getBoundingClientRect().right <= width + 1) return false;
  for (let box = element; box; box = box.parentElement)
    if (/auto|scroll/.test(getComputedStyle(box).overflowX)) return false;
  return true;
}
async function look(page, width) {
  const frame = document.createElement("iframe");
  frame.style = `border: 0; height: 800px; width: ${width}px`;
  frame.src = page;
  await new Promise(loaded => { frame.onload = loaded; document.body.append(frame); });
  const root = frame.contentDocument.documentElement;
  const found = [];
  const beyond = [...root.querySelectorAll("article *, main *")].filter(e => sticksOut(e, width)).at(-1);
  if (root.scrollWidth > width || beyond)
    found.push(`wider than the screen, ${root.scrollWidth} pixels: ${beyond ? beyond.outerHTML.slice(0, 120) : ""}`);
  if (width == WIDE && !/^.plugins.|report.html$/.test(page))
    for (const box of root.querySelectorAll("pre"))
      if (box.scrollWidth > box.clientWidth) {
        const lines = box.textContent.split("\\n");
        found.push("code is wider than its box: " + lines.reduce((a, b) => b.length > a.length ? b : a));
      }
  frame.remove();
  return found.map(what => `${page} at ${width} pixels: ${what}`);
}
(async () => {
  const found = [];
  for (const page of PAGES) for (const width of SIZES) found.push(...await look(page, width));
  await fetch("/found", {method: "POST", body: JSON.stringify(found)});
})();
</script>"""


class Site(SimpleHTTPRequestHandler):
    """Serves a folder and the page that measures its pages, and takes what that finds."""

    def __init__(self, *request: object, measuring: str, found: Queue[list[str]], directory: str):
        self.measuring, self.found = measuring, found
        super().__init__(*request, directory=directory)

    def do_GET(self) -> None:
        if self.path != "/measure":
            return super().do_GET()
        self.answer("text/html; charset=utf-8", self.measuring.encode())

    def do_POST(self) -> None:
        self.found.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.answer("text/plain", b"")

    def answer(self, kind: str, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *message: object) -> None:
        """Keeps quiet."""


def too_wide(folder: Path, pages: list[str]) -> list[str]:
    """What is too wide on pages of a folder, a line for each; empty if everything fits.

    Raises:
        queue.Empty: if Chromium has not answered in time.
    """
    values = {"PAGES": json.dumps([f"/{page}" for page in pages]), "SIZES": json.dumps(WIDTHS), "WIDE": str(WIDTHS[0])}
    measuring = functools.reduce(lambda text, name: text.replace(name, values[name]), values, SCRIPT)
    found: Queue[list[str]] = Queue()
    with ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Site, measuring=measuring, found=found,
                                                                 directory=str(folder))) as server, \
            tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        Thread(target=server.serve_forever, daemon=True).start()
        browser = subprocess.Popen(
            [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}",
             "--remote-debugging-port=0", f"http://127.0.0.1:{server.server_port}/measure"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            return found.get(timeout=LIMIT)
        finally:
            browser.terminate()
            browser.wait()
            server.shutdown()


def main(folder: Path) -> int:
    """Prints what is too wide in a folder; 1 if anything is."""
    if CHROMIUM is None:
        print("widths of pages were not looked at: Chromium is not installed")
        return 0
    pages = sorted(page.relative_to(folder).as_posix() for page in folder.rglob("*.html"))
    found = too_wide(folder, pages)
    print(*found, f"{len(pages)} pages, of which {len({each.split()[0] for each in found})} are too wide", sep="\n")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
