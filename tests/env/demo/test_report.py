"""The report is one file that loads nothing, and in a browser everything in it moves together."""

import json
import math
import os
import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest
from playwright.sync_api import expect, sync_playwright

from env.demo.episode import Episode, SeenEntity, Step
from env.demo.report import Focus, Provenance, write_report
from sfol.errors import UsageError

GROUPS = {"efficiency": ["efficiency1", "efficiency2"], "safety": ["safe1", "removed"]}
PROVENANCE = Provenance("crossing", "3f9a1c77d2e4", "a test")
FOCUS = Focus(episode=1, step=12, explanation="reward −0.4\n└─ safety <because> & so")
HOSTILE = "</script><script>window.hacked = true</script><!--"
STEPS = (40, 30)
CHARTS = 9


def seen(name, weight):
    return SeenEntity(name, "pedestrian", 0.8, (90, 60, 130, 80), weight, (f"OnRoad({name})",))


def step(index, rng, distance):
    v = 8 * math.sin(index / 10) ** 2
    confidences = {
        "efficiency1": 0.9,
        "efficiency2": index / 50,
        "safe1": 0.5 if index > 9 else 0.0,
        "other": 0.0,
    }
    weights = {"efficiency": 0.3, "safety": confidences["safe1"] / 3}
    terms = {"safety": -weights["safety"] * v, "efficiency": 0.15 * v, "comfort": -0.01}
    return Step(
        time=0.1 * index,
        position=0.5 * index,
        speed=v,
        speed_next=v,
        action=math.cos(index / 5),
        distance=distance,
        ttc=distance / v if v else math.inf,
        frame=rng.integers(0, 256, (14, 14), np.uint8).repeat(16, axis=0).repeat(16, axis=1),
        classes=rng.integers(0, 28, (14, 14), np.uint8).repeat(16, axis=0).repeat(16, axis=1),
        entities=(seen("pedestrian1", 1.0), seen(HOSTILE, 0.5)),
        facts=f"Vehicle(ego).\nPedestrian(pedestrian1): [0.{index + 10}, 0.9].",
        reward=sum(terms.values()),
        terms=terms,
        weights=weights,
        confidences=confidences,
        descriptor=np.zeros(8, np.float32),
    )


def drive(driver, count, distances, ending="success"):
    rng = np.random.default_rng(count)
    steps = tuple(step(index, rng, distances(index)) for index in range(count))
    return Episode(driver, "high", "full", "sudden", count, 0.1, steps, ending, {})


@pytest.fixture(scope="module")
def episodes():
    return [
        drive(f"cautious {HOSTILE}", STEPS[0], lambda index: math.inf),
        drive("ttc", STEPS[1], lambda index: 20 - index if 5 < index < 20 else math.nan),
    ]


@pytest.fixture(scope="module")
def report(episodes, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "runs" / "report.html"
    write_report(path, episodes, GROUPS, FOCUS, PROVENANCE)
    return path


class Elements(HTMLParser):
    """What the page's markup says, apart from the data."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes, self.texts = [], [], {}
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs).get("type")))
        self.attributes += attrs

    def handle_data(self, text):
        self.texts.setdefault(self.tags[-1] if self.tags else None, []).append(text)

    @property
    def data(self):
        return json.loads("".join(self.texts["script", "application/json"]))


@pytest.fixture(scope="module")
def elements(report):
    return Elements(report.read_text(encoding="utf-8"))


# ── The file ─────────────────────────────────────────────────────────────────────────────────


def test_report_is_the_only_file(report):
    assert [path.name for path in report.parent.iterdir()] == ["report.html"]


def test_page_names_nothing_that_a_browser_would_load(elements):
    links = [value for name, value in elements.attributes if name in {"src", "href", "srcset"}]
    assert links == ["data:,"]
    assert not re.search(r"url\(|@import", "".join(elements.texts["style", None]))
    assert not re.search(
        r"\bimport\b|\bfetch\b|XMLHttpRequest", "".join(elements.texts["script", None])
    )


def test_hostile_names_stay_data(elements):
    assert elements.tags.count(("script", None)) == 1
    assert elements.data["episodes"][0]["driver"] == f"cautious {HOSTILE}"
    assert elements.data["focus"]["explanation"] == FOCUS.explanation


def test_infinity_and_nan_become_gaps(elements):
    first, second = (episode["signals"]["distance"] for episode in elements.data["episodes"])
    assert set(first) == {None}
    assert second[:8] == [None] * 6 + [14.0, 13.0]


def test_every_curve_has_one_value_a_step(elements):
    for episode, count in zip(elements.data["episodes"], STEPS, strict=True):
        for curves in ("signals", "confidences", "weights", "terms"):
            assert {len(values) for values in episode[curves].values()} == {count}
        assert len(episode["frames"]) == len(episode["moments"]) == count


def test_head_without_rules_is_zero(elements):
    assert set(elements.data["episodes"][0]["confidences"]["removed"]) == {0.0}


def test_summary_is_that_of_the_steps(episodes, elements):
    summary = elements.data["episodes"][1]["summary"]
    assert summary["duration"] == pytest.approx(3.0)
    assert summary["distance"] == 1.0
    assert summary["return"] == pytest.approx(sum(s.reward for s in episodes[1].steps), rel=1e-4)
    assert sum(summary["terms"].values()) == pytest.approx(summary["return"], rel=1e-3)
    assert sum(summary["shares"].values()) == pytest.approx(1, rel=1e-3)


def test_frames_keep_to_the_budget(monkeypatch, elements, episodes, tmp_path):
    def size(page):
        return sum(len(frame) for episode in page.data["episodes"] for frame in episode["frames"])

    budget = 8 * size(elements) // 10
    monkeypatch.setattr("env.demo.report.FRAME_BUDGET", budget)
    write_report(tmp_path / "small.html", episodes, GROUPS, FOCUS, PROVENANCE)
    assert size(Elements((tmp_path / "small.html").read_text())) < 1.05 * budget


@pytest.mark.parametrize(
    ("shown", "focus"),
    [(slice(0), (0, 0)), (slice(2), (2, 0)), (slice(2), (1, 30)), (slice(2), (0, -1))],
)
def test_what_cannot_be_shown_is_refused_and_leaves_no_file(episodes, tmp_path, shown, focus):
    with pytest.raises(ValueError, match=r"at least one|focus names"):
        write_report(tmp_path / "r.html", episodes[shown], GROUPS, Focus(*focus, ""), PROVENANCE)
    assert not list(tmp_path.iterdir())


def test_failed_write_keeps_the_old_report(monkeypatch, episodes, tmp_path):
    path = tmp_path / "report.html"
    path.write_text("old")
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(UsageError, match="full"):
        write_report(path, episodes, GROUPS, FOCUS, PROVENANCE)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("report.html", "old")]


# ── The page in a browser ────────────────────────────────────────────────────────────────────

MISSING = (
    "no Chromium found: the report was not opened in a browser "
    "(install Debian's chromium, or set SFOL_CHROMIUM)"
)
QUIET = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)


@pytest.fixture(scope="module")
def browser():
    program = (
        os.environ.get("SFOL_CHROMIUM")
        or shutil.which("chromium")
        or shutil.which("chromium-browser")
    )
    if program is None:
        required = os.environ.get("SFOL_REQUIRE_BROWSER") == "1"
        (pytest.fail if required else pytest.skip)(MISSING)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(QUIET))
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def context(browser):
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.set_offline(True)
    return context


@pytest.fixture
def open_report(context, report):
    """Open the report offline; whatever it complains of or asks for fails the test."""
    complaints, requests, pages = [], [], []

    def open_at(address=""):
        page = context.new_page()
        pages.append(page)
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(report.as_uri() + address)
        settled(page)
        return page

    yield open_at
    for page in pages:
        page.close()
    assert complaints == []
    assert {url.split(":")[0] for url in requests} <= {"file", "data", "blob"}


@pytest.fixture
def page(open_report):
    return open_report("#episode=0&step=5")


def settled(page):
    page.wait_for_function("d => d.frame === `${d.episode}:${d.step}`", arg=page_state(page))


def page_state(page):
    return page.evaluate_handle("document.documentElement.dataset")


def where(page):
    return tuple(page.evaluate("(d => [Number(d.episode), Number(d.step)])", page_state(page)))


def shown(page):
    """All that has to move with the time."""
    settled(page)
    return page.evaluate(
        """() => {
          const all = (selector, read) => [...document.querySelectorAll(selector)].map(read);
          const text = (id) => document.getElementById(id).textContent;
          return {
            slider: Number(document.getElementById("scrubber").value),
            frame: document.getElementById("camera").toDataURL(),
            cursors: all(".chart .cursor", (line) => line.x1.baseVal.value),
            legend: all(".legend .value", (value) => value.textContent),
            stats: text("stats"),
            facts: text("facts"),
            clock: text("clock"),
          };
        }"""
    )


def assert_all_moved(before, after):
    assert len(set(after["cursors"])) == 1, "the cursors stand at different times"
    assert len(after["cursors"]) == CHARTS
    assert [part for part in before if before[part] == after[part]] == []


def plot_point(page, chart, step, steps):
    """Where a step lies in a chart; the cursor at both ends tells the scale."""
    plot = page.locator(f'[data-chart="{chart}"] > svg')
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    ends = []
    for key in ("Home", "End"):
        page.keyboard.press(key)
        ends.append(shown(page)["cursors"][0])
    share = step / (steps - 1)
    return box["x"] + ends[0] + share * (ends[1] - ends[0]), box["y"] + box["height"] / 2


def test_page_opens_at_the_focus(open_report):
    page = open_report()
    assert where(page) == (1, 12)
    expect(page.locator("#proof")).to_have_text(FOCUS.explanation)


def test_page_opens_where_its_address_says(open_report):
    assert where(open_report("#episode=0&step=7")) == (0, 7)
    assert where(open_report("#episode=0&step=999")) == (0, STEPS[0] - 1)
    assert where(open_report("#episode=nonsense")) == (1, 12)


def test_address_follows_the_moment(page):
    page.keyboard.press("ArrowRight")
    page.wait_for_function("() => location.hash === '#episode=0&step=6'")


def test_hostile_name_is_only_text(page):
    assert page.evaluate("window.hacked") is None
    expect(page.locator("#seen")).to_contain_text(HOSTILE)


@pytest.mark.parametrize("focused", ["body", "#scrubber"])
def test_keys_move_everything(page, focused):
    if focused != "body":
        page.focus(focused)
    for key, step in [
        ("ArrowRight", 6),
        ("Shift+ArrowRight", 16),
        ("ArrowLeft", 15),
        ("Shift+ArrowLeft", 5),
        ("Shift+ArrowLeft", 0),
        ("End", STEPS[0] - 1),
        ("Home", 0),
    ]:
        before = shown(page)
        page.keyboard.press(key)
        assert where(page) == (0, step)
        assert_all_moved(before, shown(page))


def test_dragging_the_slider_moves_everything(page):
    page.locator("#scrubber").scroll_into_view_if_needed()
    before = shown(page)
    box = page.locator("#scrubber").bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] * 0.3, middle)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.5, middle, steps=4)
    page.mouse.up()
    after = shown(page)
    assert after["slider"] == where(page)[1] == pytest.approx(STEPS[0] / 2, abs=1)
    assert_all_moved(before, after)


def test_thumb_stands_where_the_cursors_stand(page):
    for key in ("Home", "End"):
        page.keyboard.press(key)
        bar = page.locator(".slider").bounding_box()
        thumb = bar["x"] + (bar["width"] if key == "End" else 0)
        plot = page.locator('[data-chart="speed"] > svg').bounding_box()
        assert plot["x"] + shown(page)["cursors"][0] == pytest.approx(thumb, abs=1)


@pytest.mark.parametrize("chart", ["speed", "rules-safety", "terms"])
def test_click_and_drag_in_a_chart_move_everything(page, chart):
    x, y = plot_point(page, chart, 20, STEPS[0])
    before = shown(page)
    page.mouse.click(x, y)
    assert where(page) == (0, 20)
    assert_all_moved(before, shown(page))
    page.mouse.down()
    page.mouse.move(plot_point(page, chart, 10, STEPS[0])[0], y, steps=3)
    page.mouse.up()
    assert where(page) == (0, 10)


def test_hover_reads_a_chart_without_moving(page):
    x, y = plot_point(page, "weights", 20, STEPS[0])
    page.keyboard.press("Home")
    page.mouse.move(x, y)
    expect(page.locator("#tooltip")).to_contain_text("2.0 s")
    expect(page.locator("#tooltip")).to_contain_text("safety0.167")
    assert where(page) == (0, 0)
    page.mouse.move(5, 5)
    expect(page.locator("#tooltip")).to_be_hidden()


def test_choosing_an_episode(page):
    before = shown(page)
    page.get_by_role("button", name="ttc").click()
    assert where(page) == (1, 0)
    expect(page.locator('[data-row="1"]')).to_have_attribute("aria-current", "true")
    expect(page.locator("#counter")).to_have_text(f"step 0 of {STEPS[1] - 1}")
    assert shown(page)["frame"] != before["frame"]


@pytest.mark.parametrize("button", ["#jump", "#jump-from-proof"])
def test_jump_to_the_most_dangerous_moment(page, button):
    expect(page.locator("#flag")).to_be_hidden()
    page.click(button)
    assert where(page) == (1, 12)
    expect(page.locator("line.danger")).to_have_count(CHARTS)


def test_play_and_pause_with_the_space_bar(page):
    page.keyboard.press("Space")
    page.wait_for_function("d => d.step >= 8", arg=page_state(page))
    page.keyboard.press("Space")
    stopped = where(page)
    page.wait_for_timeout(250)
    assert where(page) == stopped


def test_playing_ends_with_the_drive_and_starts_again(page):
    page.select_option("#speed", "4")
    page.keyboard.press("End")
    page.click("#play")
    page.wait_for_function("d => d.step === '39' && d.playing === 'false'", arg=page_state(page))


def test_nothing_plays_by_itself(page):
    page.wait_for_timeout(250)
    assert where(page) == (0, 5)


def test_boxes_and_labels_can_be_hidden(page):
    for layer, part in (("boxes", ".box"), ("labels", ".label")):
        expect(page.locator(part).last).to_be_visible()
        page.uncheck(f"#{layer}")
        expect(page.locator(part).last).to_be_hidden()


def test_pointing_at_an_entity_lights_its_box(page):
    page.hover("#seen tbody >> nth=1")
    assert page.locator(".entity.lit").get_attribute("data-name") == HOSTILE


@pytest.mark.parametrize("chart", ["rules-efficiency", "weights", "terms"])
def test_lines_differ_without_colour(page, chart):
    dashes = page.eval_on_selector_all(
        f'[data-chart="{chart}"] path.line',
        "lines => lines.map((line) => getComputedStyle(line).strokeDasharray)",
    )
    assert len(dashes) > 1
    assert len(set(dashes)) == len(dashes)


def test_charts_and_slider_have_names(page):
    for plot in page.locator(".chart > svg").all():
        assert "over time in s" in plot.get_attribute("aria-label")
    expect(page.locator("#scrubber")).to_have_attribute("aria-valuetext", "0.5 seconds, step 5")


def test_coverage_counts_steps(page):
    row = page.locator("#coverage tr", has_text="safe1")
    expect(row).to_contain_text("30 (75 %)")
    expect(row).to_contain_text("50 (71 %)")
    expect(page.locator("#coverage tr", has_text="other")).to_contain_text("never")


@pytest.mark.parametrize("width", [900, 1280, 1800])
def test_page_fits_the_window(page, width):
    page.set_viewport_size({"width": width, "height": 900})
    page.wait_for_function(
        "() => document.querySelector('.chart > svg').viewBox.baseVal.width"
        " === document.getElementById('charts').clientWidth"
    )
    assert page.evaluate("document.documentElement.scrollWidth") <= width
