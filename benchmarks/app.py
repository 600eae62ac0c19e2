"""Time from moving a control of ``pcnde app`` until the curves are drawn, in a browser.

Run ``python benchmarks/app.py MODEL [--moves 100] [--screenshot FILE.png]`` with a saved
model; Chromium and its driver must be installed.  Serves the page, presses an arrow key on
the control of the blockage, and measures the time between the key event and Plotly's
``plotly_afterplot`` of the later of both columns, whose curves must have changed; then the
same with several keys sent without waiting.  Prints median and maximum, and the load.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pcnde_bridge import PCNDE
from pcnde_bridge.app.server import make_server

CHROMIUM, DRIVER = ("chromium", "chromium-browser", "google-chrome"), ("chromedriver",)
WINDOW = (1400, 900)
_OPTIONS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
_TIMEOUT = 120

WATCH = """
const watched = { start: null, waiting: new Set(), last: {}, drawn: [], painted: [] };
window.watched = watched;
document.addEventListener("keydown", (event) => {
  watched.start = event.timeStamp;
  watched.waiting = new Set(["along", "over"]);
}, true);
for (const id of ["along", "over"]) {
  const graph = document.querySelector(`#${id} .js-plotly-plot`);
  const curve = () => JSON.stringify(graph.data[graph.data.length - 1].y);
  watched.last[id] = curve();
  graph.on("plotly_afterplot", () => {
    const now = curve();
    if (now === watched.last[id]) return;
    watched.last[id] = now;
    watched.waiting.delete(id);
    if (watched.waiting.size > 0 || watched.start === null) return;
    const start = watched.start;
    watched.drawn.push(performance.now() - start);
    requestAnimationFrame(() => setTimeout(() => watched.painted.push(performance.now() - start)));
  });
}
"""


def programs() -> tuple[str, str] | None:
    """Return the paths of Chromium and its driver, or None if one is missing."""
    found = [next(filter(None, map(shutil.which, names)), None) for names in (CHROMIUM, DRIVER)]
    return (found[0], found[1]) if found[0] and found[1] else None


@contextlib.contextmanager
def served(model: PCNDE, name: str) -> Iterator[str]:
    """Serve a model's page, and return its address."""
    server = make_server(model, name, port=0)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    """Start headless Chromium with an empty profile."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    found = programs()
    if found is None:
        raise SystemExit("Chromium and chromedriver are needed.")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = webdriver.ChromeOptions()
        options.binary_location = found[0]
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        for option in (*_OPTIONS, f"--user-data-dir={profile}"):
            options.add_argument(option)
        driver = webdriver.Chrome(options=options, service=Service(found[1]))
        try:
            driver.set_script_timeout(_TIMEOUT)
            resize(driver, *WINDOW)
            yield driver
        finally:
            driver.quit()


def resize(driver: Any, width: int, height: int) -> None:
    """Set the size of the page in pixels."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def wait_for(condition: Callable[[], Any], seconds: float = _TIMEOUT) -> Any:
    """Wait until a condition is true, and return its value."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.02)
    raise TimeoutError("The page did not change as expected.")


def curves(driver: Any, column: str) -> list[dict[str, Any]]:
    """Return name, x and y of every trace of a column, as the browser has drawn them."""
    return driver.execute_script(
        "const graph = document.querySelector(`#${arguments[0]} .js-plotly-plot`);"
        "return graph && graph.data ? graph.data.map(({name, x, y}) => ({name, x, y})) : []",
        column,
    )


def settled(driver: Any) -> bool:
    """Return whether all curves are drawn, including the interval and the 1D solver."""
    progress = [element.text for element in driver.find_elements("id", "progress")]
    drawn = [trace["y"] for column in ("along", "over") for trace in curves(driver, column)[-1:]]
    return (
        progress not in ([], [""])
        and "computing" not in progress[0]
        and len(drawn) == 2
        and all(drawn)
    )


def move(driver: Any, moves: int, *, wait: bool = True) -> dict[str, list[float]]:
    """Press arrow keys on the control of the blockage, ten to each side in turn.

    Returns
    -------
    dict of list of float
        Milliseconds from the key event until the curves are ``drawn``, and until the next
        frame is ``painted``; without waiting, from the last key event.
    """
    from selenium.webdriver.common.keys import Keys

    driver.execute_script(WATCH)
    thumb = driver.find_element("css selector", "#blockage [role=slider]")

    def done() -> list[float]:
        return driver.execute_script("return window.watched.painted")

    keys = [Keys.ARROW_RIGHT if number // 10 % 2 else Keys.ARROW_LEFT for number in range(moves)]
    if wait:
        for number, key in enumerate(keys, start=1):
            thumb.send_keys(key)
            wait_for(lambda number=number: len(done()) >= number)
    else:
        thumb.send_keys(keys)
        time.sleep(3)
    return driver.execute_script("return {drawn: watched.drawn, painted: watched.painted}")


def describe_times(name: str, times: list[float]) -> str:
    """Describe times by median, 95th percentile and maximum."""
    ordered = sorted(times)
    late = ordered[min(len(ordered) - 1, round(0.95 * len(ordered)))]
    return (
        f"{name}: median {statistics.median(ordered):.0f} ms, 95 % within {late:.0f} ms, "
        f"worst {ordered[-1]:.0f} ms, of {len(ordered)}"
    )


def main() -> None:
    """Measure the times and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--moves", type=int, default=100)
    parser.add_argument("--screenshot", type=Path)
    options = parser.parse_args()
    model = PCNDE.load(options.model, engine="jax")
    with served(model, options.model.stem) as address, browser() as driver:
        driver.get(address)
        wait_for(lambda: settled(driver))
        if options.screenshot:
            driver.save_screenshot(str(options.screenshot))
        move(driver, 10)
        driver.get(address)  # with empty caches of the page
        wait_for(lambda: settled(driver))
        print(f"load before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
        found = move(driver, options.moves)
        for name, times in found.items():
            print(describe_times(f"key to {name}", times))
        wait_for(lambda: settled(driver))
        burst = move(driver, 9, wait=False)
        print(describe_times("9 keys at once, last key to drawn", burst["drawn"][-1:]))
        print(f"load after: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
