"""The reports in a real browser: charts draw and zoom, nothing leaves the page, print shows stills.

Runs where a Chromium is installed (Debian's package `chromium`); the suite of the repository installs it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import report_samples as samples
from playwright.sync_api import Browser, Page, sync_playwright
from smts_validate.pipeline import report
from smts_validate.pipeline.report_blocks import charts_of
from smts_validate.pipeline.report_campaign import write_campaign_report
from smts_validate.pipeline.report_campaign_parts import parts_of
from smts_validate.pipeline.result import read_result, write_result

FOUND = [path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))]
OPTIONS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip
DESKTOP, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}

pytestmark = pytest.mark.slow
Opener = Callable[..., "Opened"]


@dataclass
class Opened:
    """A page with what it said and asked for."""

    page: Page
    messages: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)


@pytest.fixture(scope="module", params=FOUND[:1], ids=["chromium"][: len(FOUND)])
def browser(request: pytest.FixtureRequest) -> Iterator[Browser]:
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=request.param, args=OPTIONS)
        yield started
        started.close()


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(tmp_path_factory.mktemp("browser") / "out", samples.pass_result(), report.finish)


@pytest.fixture
def opened(browser: Browser, out: Path) -> Iterator[Opener]:
    contexts: list[Any] = []

    def start(path: Path = out / "report.html", **options: Any) -> Opened:
        options.setdefault("viewport", DESKTOP)
        context = browser.new_context(**options)
        contexts.append(context)
        found = Opened(context.new_page())
        found.page.on("console", lambda message: found.messages.append(message.text))
        found.page.on("pageerror", lambda error: found.messages.append(str(error)))
        found.page.on("request", lambda request: found.requests.append(request.url))
        found.page.goto(path.as_uri())
        found.page.wait_for_load_state("load")
        return found

    yield start
    for context in contexts:
        context.close()


def test_campaigns_report_draws_too_and_leads_to_its_passes(opened: Opener, tmp_path: Path) -> None:
    folder = samples.campaign_folder(tmp_path / "out")
    charts = charts_of(parts_of(write_campaign_report(folder)))
    report.finish(folder / "passes" / "a-east-1")
    found = opened(folder / "report.html")
    assert found.page.evaluate("document.documentElement.dataset.charts") == str(len(charts))
    for chart in charts:
        assert found.page.locator(f"#figure-{chart.key} canvas").first.evaluate(INK) > 500, chart.key
    found.page.get_by_role("link", name="a-east-1").click()
    assert found.page.title() == "Adequacy report: a-east-1"
    assert found.messages == []
    assert [url for url in found.requests if not url.startswith(("file:", "data:"))] == []


def _interactive(out: Path) -> list[str]:
    return [c.key for c in charts_of(report.sections_of(read_result(out))) if not c.to_scale]


def _shown(page: Page, key: str) -> tuple[float, float]:
    data = page.locator(f"#figure-{key}").evaluate("f => [Number(f.dataset.low), Number(f.dataset.high)]")
    return float(data[0]), float(data[1])


INK = """canvas => {
  const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  let drawn = 0;
  for (let i = 3; i < data.length; i += 4) drawn += data[i] > 0;
  return drawn;
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("viewport", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_every_chart_draws_without_a_word_or_a_request(
    opened: Opener, out: Path, viewport: dict[str, int], scheme: str, tmp_path: Path
) -> None:
    found = opened(viewport=viewport, color_scheme=scheme)
    keys = _interactive(out)
    assert found.page.evaluate("document.documentElement.dataset.charts") == str(len(keys))
    for key in keys:
        canvases = found.page.locator(f"#figure-{key} canvas")
        assert canvases.count() >= 1
        for index in range(canvases.count()):
            assert canvases.nth(index).evaluate(INK) > 500, key
    assert found.messages == []
    assert [url for url in found.requests if not url.startswith(("file:", "data:"))] == []
    found.page.screenshot(path=tmp_path / "page.png", full_page=True)
    assert (tmp_path / "page.png").stat().st_size > 20_000


@pytest.mark.parametrize("viewport", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_page_never_scrolls_sideways(opened: Opener, viewport: dict[str, int]) -> None:
    found = opened(viewport=viewport)
    assert found.page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]


def test_dragging_zooms_every_panel_and_double_click_shows_the_whole(opened: Opener) -> None:
    page = opened().page
    whole = _shown(page, "trajectories")
    over = page.locator("#figure-trajectories .u-over").first
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 42, steps=5)
    page.mouse.up()
    low, high = _shown(page, "trajectories")
    assert low == pytest.approx(whole[0] + 0.25 * (whole[1] - whole[0]), abs=1.0)
    assert high == pytest.approx(whole[0] + 0.50 * (whole[1] - whole[0]), abs=1.0)
    scales = page.evaluate("Array.from(document.querySelectorAll('#figure-trajectories .u-legend')).length")
    assert scales == 2
    over.dblclick(position={"x": 100.0, "y": 40.0})
    assert _shown(page, "trajectories") == pytest.approx(whole)


def test_buttons_zoom_and_move_and_return(opened: Opener) -> None:
    page = opened().page
    figure = page.locator("#figure-yaw")
    whole = _shown(page, "yaw")
    figure.get_by_role("button", name="zoom in").click()
    zoomed = _shown(page, "yaw")
    assert zoomed[1] - zoomed[0] == pytest.approx(0.5 * (whole[1] - whole[0]))
    figure.get_by_role("button", name="move right").click()
    assert _shown(page, "yaw")[0] > zoomed[0]
    for _ in range(6):
        figure.get_by_role("button", name="move right").click()
    assert _shown(page, "yaw")[1] <= whole[1] + 1e-9
    figure.get_by_role("button", name="whole").click()
    assert _shown(page, "yaw") == pytest.approx(whole)


def test_arrow_keys_read_values_for_those_who_do_not_see_them(opened: Opener) -> None:
    page = opened().page
    chart = page.locator("#figure-trajectories .chart")
    chart.focus()
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    words = page.locator("#figure-trajectories .read").text_content() or ""
    assert "distance along the row" in words
    assert "measured" in words
    assert any(sign.isdigit() for sign in words)
    page.keyboard.press("+")
    whole, zoomed = _shown(page, "yaw"), _shown(page, "trajectories")
    assert zoomed[1] - zoomed[0] < 0.8 * (whole[1] - whole[0])


def test_without_script_every_still_picture_is_there(opened: Opener, out: Path) -> None:
    page = opened(java_script_enabled=False).page
    stills = page.locator(".still svg")
    assert stills.count() == len(charts_of(report.sections_of(read_result(out))))
    for index in range(stills.count()):
        assert stills.nth(index).is_visible()
    assert page.locator(".tools").first.is_hidden()


def test_print_shows_stills_and_no_buttons(opened: Opener) -> None:
    page = opened().page
    page.emulate_media(media="print")
    assert page.locator("#figure-trajectories .still svg").is_visible()
    assert page.locator("#figure-trajectories .tools").is_hidden()
    assert page.locator("#figure-trajectories .chart").is_hidden()


def test_charts_follow_the_width_of_the_window(opened: Opener) -> None:
    page = opened().page
    page.set_viewport_size(PHONE)
    page.wait_for_timeout(400)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    width = page.locator("#figure-yaw canvas").first.evaluate("c => c.getBoundingClientRect().width")
    assert width < PHONE["width"]


def test_every_control_has_a_name(opened: Opener) -> None:
    page = opened().page
    names = page.evaluate(
        "Array.from(document.querySelectorAll('button, [role], a')).map("
        "e => (e.getAttribute('aria-label') || e.textContent || '').trim())"
    )
    assert names
    assert all(names)


def test_manifests_script_does_not_run(opened: Opener) -> None:
    dialogs: list[str] = []
    found = opened()
    found.page.on("dialog", lambda dialog: dialogs.append(dialog.message))
    found.page.reload()
    assert dialogs == []
    assert found.page.locator("text=alert(1)").count() >= 1
