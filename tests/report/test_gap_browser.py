"""The gap report in a real browser: the answer on the first screen, plots drawn, nothing wider than a phone."""

from __future__ import annotations

import json

import pytest

from hydrotwin.report.gap import write_gap_report
from tests.report.gap_discoveries import ALL
from tests.report.test_browser import BROWSER, DRAWN, DRIVER, FLAGS, READ_TABLES, wait_until, webdriver

pytestmark = pytest.mark.skipif(not (BROWSER and DRIVER), reason="no chromium with chromedriver on this machine")


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}", "--window-size=1280,900"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module", params=ALL)
def paths(request, tmp_path_factory):
    return write_gap_report(ALL[request.param](), tmp_path_factory.mktemp(request.param), command="hydrotwin gap")


@pytest.fixture(scope="module")
def opened(chromium, paths):
    chromium.get_log("browser")
    chromium.get(paths["html"].as_uri())
    wait_until(chromium, "return document.readyState === 'complete'")
    return chromium


def test_the_answer_and_its_picture_are_on_the_first_screen(opened, paths):
    data = json.loads(paths["json"].read_text(encoding="utf-8"))
    assert opened.execute_script("return document.querySelector('.answer').textContent") == data["answer"]
    opened.execute_script("window.scrollTo({top: 0, behavior: 'instant'})")
    bottom = opened.execute_script("return document.querySelector('header figure').getBoundingClientRect().bottom")
    assert bottom < 900


def test_the_tables_a_reader_sees_are_those_of_gap_json(opened, paths):
    data = json.loads(paths["json"].read_text(encoding="utf-8"))
    expected = {k: [[c["shown"] for c in row.values()] for row in t["rows"]] for k, t in data["tables"].items()}
    assert opened.execute_script(READ_TABLES) == expected


def test_printing_draws_every_plot_and_no_script_fails(opened):
    count = "document.querySelectorAll('.plot').length"
    opened.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    wait_until(opened, f"{DRAWN} >= {count}")
    opened.execute_script("window.dispatchEvent(new Event('afterprint'))")
    assert [e for e in opened.get_log("browser") if e["level"] == "SEVERE"] == []


def test_a_phone_does_not_scroll_sideways(opened):
    metrics = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    wait_until(opened, "return document.documentElement.scrollWidth <= 390")
    opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
