"""The page in a real browser: no script errors, plots drawn, tables as in compare.json."""

from __future__ import annotations

import json
import shutil

import pytest

from hydrotwin.comparison import Wanted, acceptance, compare
from hydrotwin.report import write_report
from tests.comparison.toys import Toy, recording

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")

BROWSER = next((p for p in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if p), None)
DRIVER = shutil.which("chromedriver")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
READ_TABLES = """
return Object.fromEntries(Array.from(document.querySelectorAll("table[data-table]")).map(table => [
  table.dataset.table,
  Array.from(table.tBodies[0].rows).map(
    row => Array.from(row.cells).map(cell => cell.querySelector(".text").textContent)),
]));
"""
DRAWN = "return Array.from(document.querySelectorAll('.plot')).filter(p => p.dataset.drawn === 'yes').length"

pytestmark = pytest.mark.skipif(not (BROWSER and DRIVER), reason="no chromium with chromedriver on this machine")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}", "--window-size=1280,900"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def opened(browser, report):
    browser.get(report["html"].as_uri())
    wait_until(browser, f"{DRAWN} > 0")
    return browser


def wait_until(browser, condition, seconds=90):
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, seconds).until(lambda b: b.execute_script(condition))


def test_the_tables_a_reader_sees_are_those_of_compare_json(opened, report):
    data = json.loads(report["json"].read_text(encoding="utf-8"))
    expected = {k: [[c["shown"] for c in row.values()] for row in t["rows"]] for k, t in data["tables"].items()}
    assert opened.execute_script(READ_TABLES) == expected


def test_answer_and_headline_are_on_the_first_screen(opened, report):
    opened.execute_script("window.scrollTo({top: 0, behavior: 'instant'})")
    data = json.loads(report["json"].read_text(encoding="utf-8"))
    assert opened.execute_script("return document.querySelector('.answer').textContent") == data["answer"]
    bottom = opened.execute_script("return document.getElementById('table-headline').getBoundingClientRect().bottom")
    assert bottom < 900


def test_plots_are_drawn_when_they_come_into_view(opened):
    groups = opened.execute_script("return document.querySelectorAll('.group').length")
    for k in range(groups):
        opened.execute_script(f"document.querySelectorAll('.group')[{k}].scrollIntoView({{behavior: 'instant'}})")
        wait_until(
            opened, f"return document.querySelectorAll('.group')[{k}].querySelector('.plot').dataset.drawn === 'yes'"
        )
    curves = opened.execute_script("return document.querySelectorAll('.group .scatterlayer .js-line').length")
    assert curves >= 3 * 5


def test_a_plot_is_an_image_with_words_beside_its_buttons(opened):
    """A screen reader hears the picture once, as its sentence, and can reach the buttons: they are no part of it."""
    parts = "Array.from(document.querySelectorAll('.plot[data-drawn=yes]'))"
    images = opened.execute_script(
        f"return {parts}.map(p => Array.from(p.querySelectorAll('[role=img]')).map(i => i.ariaLabel))"
    )
    assert images and all(len(words) == 1 and words[0].startswith("Plot of ") for words in images)
    assert opened.execute_script(f"return {parts}.filter(p => p.role || p.ariaLabel).length") == 0
    unheard = f"{parts}.flatMap(p => Array.from(p.querySelectorAll('.main-svg:not([role=img])')))"
    assert opened.execute_script(f"return {unheard}.every(part => part.ariaHidden === 'true')")
    within = opened.execute_script(f"return {parts}.flatMap(p => Array.from(p.querySelectorAll('[role=img] button')))")
    assert within == []


def test_a_tab_shows_another_recording(opened):
    opened.execute_script("document.querySelectorAll('.group')[0].querySelectorAll('button')[1].click()")
    wait_until(
        opened, "return document.querySelectorAll('.group')[0].querySelectorAll('.plot')[1].dataset.drawn === 'yes'"
    )
    shown = opened.execute_script(
        "return Array.from(document.querySelectorAll('.group')[0].querySelectorAll('figure')).map(f => !f.hidden)"
    )
    assert shown == [k == 1 for k in range(len(shown))]


def test_one_model_has_one_colour_in_tables_and_plots(opened):
    swatch = opened.execute_script(
        "return Array.from(document.querySelectorAll('#table-headline tbody tr'))"
        ".map(r => [r.cells[0].textContent.trim(), r.querySelector('.swatch').style.background])"
    )
    lines = opened.execute_script(
        "return document.querySelector('.plot').data.filter(t => t.showlegend).map(t => [t.name, t.line.color])"
    )
    colours = {name: f"rgb({int(c[1:3], 16)}, {int(c[3:5], 16)}, {int(c[5:], 16)})" for name, c in lines}
    assert {name: colour for name, colour in swatch}.items() <= colours.items()


def test_a_narrow_screen_does_not_scroll_sideways(opened):
    metrics = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    wait_until(opened, "return document.documentElement.scrollWidth <= 390")
    opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_printing_opens_every_table(opened):
    opened.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    assert opened.execute_script("return Array.from(document.querySelectorAll('details')).every(d => d.open)")
    opened.execute_script("window.dispatchEvent(new Event('afterprint'))")


def test_printing_draws_every_plot_at_once_and_shows_every_tab(opened):
    opened.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    count = "document.querySelectorAll('.plot').length"
    assert opened.execute_script(f"return document.querySelectorAll('.plot .main-svg').length >= {count}")
    widths = opened.execute_script("return Array.from(document.querySelectorAll('.plot')).map(p => p.offsetWidth)")
    assert all(0 < width <= 700 for width in widths)
    heights = "return Array.from(document.querySelectorAll('.plot')).map(p => parseInt(p.style.height))"
    assert max(opened.execute_script(heights)) == 440  # two on a page
    opened.execute_script("window.dispatchEvent(new Event('afterprint'))")
    assert max(opened.execute_script(heights)) == 520


def test_a_still_picture_makes_way_for_its_plot(opened):
    both = "return Array.from(document.querySelectorAll('.plot[data-drawn]')).filter(p => p.querySelector('.thumb'))"
    assert not opened.execute_script(both)


def test_no_script_error_and_no_request_leaves_the_page(opened):
    assert [e for e in opened.get_log("browser") if e["level"] == "SEVERE"] == []
    sent = [json.loads(e["message"])["message"] for e in opened.get_log("performance")]
    requests = [m["params"] for m in sent if m["method"] == "Network.requestWillBeSent"]
    urls = [r["request"]["url"] for r in requests if r["documentURL"].startswith("file:")]
    assert urls
    assert [url for url in urls if not url.startswith(("file:", "data:", "blob:"))] == []


PAPER = 688  # CSS pixels of a line on A4 between its margins
CUT_OFF = f"""
const [low, high] = [0, {PAPER} + 1];
return Array.from(document.querySelectorAll("table")).filter(
  table => {{ const box = table.getBoundingClientRect(); return box.left < low || box.right > high; }}
).map(table => table.dataset.table);
"""


@pytest.fixture(scope="module")
def long_names(tmp_path_factory):
    """A page of models and recordings with long names."""
    long = "EHA_rig3_load250kg_stroke120mm_oil45degC_2026-11-28_run07_second_shift"
    records = [recording(k, duration=1.0, name=f"{long}_{k}") for k in (1, 2)]
    found = compare([Toy(f"{long}_model"), Toy(f"{long}_old", gain=130.0)], records, repeats=0, modes=("free run",))
    accepted = acceptance(found, Wanted((f"{long}_1: arm_angle.rmse < 900 deg",)))
    return write_report(found, tmp_path_factory.mktemp("long"), accepted=accepted)["html"].as_uri()


def test_long_names_do_not_make_a_narrow_screen_scroll_sideways(browser, long_names):  # last: it leaves the page
    metrics = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        browser.get(long_names)
        wait_until(browser, f"{DRAWN} > 0 || document.querySelectorAll('.thumb').length > 0")
        assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_long_names_push_no_numbers_off_the_paper(browser, long_names):
    """Tables were as wide as the longest name, and what stood behind it was not printed."""
    metrics = {"width": PAPER, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        browser.get(long_names)
        browser.execute_script("window.dispatchEvent(new Event('beforeprint'))")
        assert browser.execute_script(CUT_OFF) == []
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
