"""Pages as a browser shows them."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
_LISTEN = """<script>
const troubles = [];
addEventListener("error", (event) => troubles.push(event.message));
console.error = (...words) => troubles.push(words.join(" "));
// Frames hardly come where time is virtual.
window.requestAnimationFrame = (draw) => setTimeout(draw, 10);
</script>"""


def probe(
    page: str, script: str, folder: Path, *, real_time: bool = False, more: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Run a script in a page; returns what it writes to `found`, and the `troubles` reported.

    The script ends with `document.body.dataset.found = JSON.stringify(found)`. In real time it must
    do so before the page has loaded. `more` are further options of the browser.
    """
    probed = folder / "probed.html"
    script = f"<script>\nconst found = {{troubles}};\n{script}</script></body>"
    probed.write_text(page.replace("<head>", f"<head>{_LISTEN}").replace("</body>", script))
    options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", *more]
    options += [] if real_time else ["--virtual-time-budget=10000"]
    done = dump(probed.as_uri(), *options)
    found = re.search(r'<body data-found="([^"]*)"', done.stdout)
    assert found, done.stderr[-2000:]
    values: dict[str, Any] = json.loads(found[1].replace("&quot;", '"').replace("&amp;", "&"))
    return values


def dump(address: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Load an address in a browser without a window, and print the document that results."""
    if CHROMIUM is None:
        pytest.skip("no chromium or chrome here; install the package chromium")
    return subprocess.run(
        [CHROMIUM, "--headless=new", "--no-sandbox", "--dump-dom", *options, address],
        capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip


def probe_phone(page: str, script: str, folder: Path, *more: str) -> dict[str, Any]:
    """Run a script beside a page that is 390 pixels wide, as on a phone, once it has loaded.

    Windows of the browser are wider, so that the page is in a frame; the script has its `inside`,
    the document. It fills `found`. Scroll bars take no room, as on a phone.
    """
    source = json.dumps(page).replace("</", "<\\/")
    outside = "<!doctype html><html><head></head><body></body></html>"
    show = (
        f"const frame = document.createElement('iframe');\nframe.srcdoc = {source};\n"
        "frame.style = 'width: 390px; height: 844px; border: 0';\n"
        "frame.addEventListener('load', () => setTimeout(() => {\n"
        "const inside = frame.contentDocument;\n"
        f"{script}\ndocument.body.dataset.found = JSON.stringify(found);\n"
        "}, 1000));\ndocument.body.append(frame);\n"
    )
    return probe(outside, show, folder, more=("--hide-scrollbars", *more))
