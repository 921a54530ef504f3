"""The report in a real browser: every figure is there, nothing complains, nothing is fetched, names do nothing."""

import re

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model, effects, response, tell

from browser import Browser, chromium

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium on the path")
HOSTILE = (
    "<script>document.title='broken'</script>",
    '"><img src=x onerror="document.title=\'broken\'">',
    "</style></title><svg onload=\"document.title='broken'\">",
    "$\\frac{1}{0}$ _^&amp;",
    "\u202egnihton\u202c",
)
SPEEDS = np.linspace(900.0, 2900.0, 5)


@pytest.fixture(scope="module")
def story():
    """Five runs with such names, and a probe with one."""
    model, rng = (
        Model(Jeffcott(0.9, [5e4, 4.5e4], [0.02, 0.02]), layout=Layout(probes=("X", HOSTILE[1]))),
        np.random.default_rng(0),
    )
    count = len(HOSTILE)
    unbalance = 1e-5 * np.repeat(rng.standard_normal((count, 1, 2)), len(SPEEDS), axis=0)
    conditions = Conditions.at_rpm(np.tile(SPEEDS, count), unbalance=unbalance)
    z = np.asarray(response(model + effects.ResidualUnbalance(5.8e-6, 6.9e-6), conditions))
    z = z + 3e-7 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    run = np.repeat(np.arange(count), len(SPEEDS))
    measurement = Measurement.from_arrays(z, conditions, run=run, runs=HOSTILE, probes=model.layout.probes, sigma=3e-7)
    return tell(model, measurement, [effects.ResidualUnbalance()])


def test_a_report_in_a_browser(story, tmp_path):
    path = story.report(tmp_path / "report.html", title=HOSTILE[0])
    figures = len(re.findall("<figure>", path.read_text(encoding="utf-8")))
    assert figures >= 7
    with Browser(tmp_path / "profile") as browser:
        browser.open(path)
        shown = browser.value(
            "Promise.all([...document.images].map(i => i.decode().then(() => [i.naturalWidth, i.clientWidth, i.alt])))"
        )
        assert len(shown) == figures
        assert all(natural > 100 and drawn > 100 and caption for natural, drawn, caption in shown)
        assert {caption.split(":")[0] for *_, caption in shown} >= {"Orbit", "Campbell diagram"}
        # Nothing in a name became part of the page.
        assert browser.value("document.title") == HOSTILE[0]
        assert browser.value("document.querySelectorAll('script, svg, img[src=x], [onerror], [onload]').length") == 0
        assert browser.value("document.body.innerText.includes('onerror=')")
        # A phone shows it without scrolling sideways.
        browser.ask("Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=True)
        assert browser.value("document.documentElement.scrollWidth") <= 390
        requests = {event["request"]["url"].split(":")[0] for event in browser.events("Network.requestWillBeSent")}
        assert requests <= {"file", "data"}
        for complaint in (
            "Runtime.consoleAPICalled",
            "Runtime.exceptionThrown",
            "Log.entryAdded",
            "Page.javascriptDialogOpening",
        ):
            assert browser.events(complaint) == []


def test_the_browser_would_tell(tmp_path):
    """What the test above looks for is seen where it is there."""
    page = tmp_path / "page.html"
    page.write_text("<script>console.log('heard'); missing()</script><img src='http://127.0.0.1:9/x.png'>")
    with Browser(tmp_path / "profile") as browser:
        browser.open(page)
        assert browser.events("Runtime.consoleAPICalled")
        assert browser.events("Runtime.exceptionThrown")
        assert browser.events("Log.entryAdded")
        assert "http" in {
            event["request"]["url"].split(":")[0] for event in browser.events("Network.requestWillBeSent")
        }
