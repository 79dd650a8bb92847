"""The page in a real browser against real nodes: every control, read back from the graph."""

import itertools
import re
import signal
import time
from pathlib import Path

import pytest

from tests.page.browser import Shown, launched, needs_chromium

needs_chromium()

pytest.importorskip("rclpy")

from axe_playwright_python.sync_playwright import Axe  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from playwright.sync_api import sync_playwright  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from squeal_rig.experiments.engine import RUN_ENDED, RUN_STARTED, STEP_BEGUN, STEP_ENDED  # noqa: E402
from squeal_rig.graph import qos  # noqa: E402
from squeal_rig.graph.conversions import OK, WARN, diagnostics, status, status_values  # noqa: E402
from squeal_rig.page.access import Access  # noqa: E402
from squeal_rig.page.recorded import RecordedPicture  # noqa: E402
from squeal_rig.page.server import PageServer  # noqa: E402
from squeal_rig.page.sound import Sound  # noqa: E402
from tests.graph.processes import PATIENT, PATIENT_RIG, parameters  # noqa: E402

# Low, so that a busy machine keeps up: the page is what is tried here.
_RATE = 12800


def arguments(config_file, **values):
    return ["--params-file", str(config_file), *parameters(**values)]


@pytest.fixture(scope="module")
def config_file():
    from squeal_rig.configuration.files import config_directory

    return config_directory() / "rig.yaml"


@pytest.fixture(scope="module")
def bench(compiled, processes, observer, config_file, tmp_path_factory):
    """Rig, recorder, squeal detector, supervisor and page; the page's address."""
    folder = tmp_path_factory.mktemp("bags")
    nodes = {
        "simulator": processes.node(
            "simulator", *arguments(config_file, sample_rate=_RATE, supervisor_required=False, **PATIENT_RIG)
        ),
        "recorder": processes.node("recorder", *arguments(config_file, autostart=False), cwd=folder),
        "squeal_detector": processes.node("squeal_detector", *arguments(config_file)),
        "supervisor": processes.node("supervisor", *arguments(config_file, nodes=["rig"], **PATIENT)),
        "page": processes.node("page", *arguments(config_file, port=0, control=True)),
    }
    page = nodes["page"]
    observer.wait_for(lambda: "http://" in page.errors or not page.running, "the page's address", 300.0)
    assert page.running, page.errors
    url = re.search(r"http://\S+?/", page.errors)[0]
    observer.wait_for(lambda: observer.state() == "active", "an active rig", 300.0)
    return url, nodes, folder


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as playwright:
        found = launched(playwright)
        yield found
        found.close()


@pytest.fixture
def shown(bench, browser):
    page = Shown(browser, bench[0])
    yield page
    assert not page.troubles
    page.context.close()


def test_every_control_has_its_effect_on_the_graph(shown, bench, observer, config_file):
    _, _, folder = bench
    # Set points, by keyboard; the number in force follows.
    shown.until("page.frame() !== null")
    assert "preload = 60" in shown.set("preload", 60)
    assert observer.get(["preload"]) == {"preload": 60.0}
    assert "belt_speed = 1.5" in shown.set("belt_speed", "1,5")
    assert observer.get(["belt_speed"]) == {"belt_speed": 1.5}
    assert "mu0 = 0.2" in shown.set("mu0", 0.2)
    assert observer.get(["mu0"]) == {"mu0": 0.2}
    assert "impact_impulse = 0.01" in shown.set("impact_impulse", 0.01)
    assert observer.get(["impact_impulse"]) == {"impact_impulse": 0.01}
    shown.until("Math.abs(page.frame().preload - 60) < 1e-6")
    # A value out of bounds, no number, a value that the rig itself refuses.
    assert "2000 N" in shown.set("preload", 1e6)
    assert "not a number" in shown.set("preload", "much")
    assert observer.get(["preload"]) == {"preload": 60.0}
    blocks = observer.follow_samples("daq/samples")
    observer.wait_for(lambda: blocks, "samples")  # before the hit, whose ringing dies down
    assert "impact of" in shown.press("impact")
    observer.wait_for(
        lambda: blocks and max(abs(b.samples["x"] - b.samples["x"].mean()).max() for b in blocks) > 1e-7,
        "the pad rings",
    )
    assert "equilibrium" in shown.press("reset")
    assert "subtracted from now on" in shown.press("zero")
    assert observer.description().tare
    assert "paused" in shown.press("pause")
    observer.wait_for(lambda: time.time_ns() - blocks[-1].stamp_ns > 5e8, "no more blocks")
    assert "running" in shown.press("resume")
    assert "did not activate" in shown.press("activate")  # it is
    assert "deactivated" in shown.press("deactivate")
    assert observer.state() == "inactive"
    assert "activated" in shown.press("activate")
    assert observer.state() == "active"
    count = len(blocks)
    observer.wait_for(lambda: len(blocks) > count, "blocks again")
    assert "recording" in shown.press("record_start")
    observer.wait_for(lambda: list(folder.rglob("*.mcap")), "a bag")
    assert "snapshot" in shown.press("snapshot")  # refused in the recorder's own words: it records all the time
    assert "closed" in shown.press("record_stop")
    with shown.tab.expect_download() as download:
        shown.tab.click("[aria-label='Save the picture Spectrum']")
    assert download.value.suggested_filename.startswith("squeal_rig_spectrum")
    shown.until("document.getElementById('node-list').children.length >= 3")


def test_what_others_name_their_things_is_text_on_the_page(shown, observer):
    evil = "<img src=x onerror=document.title='pwned'><script>document.title='pwned'</script>"
    publisher = observer.node.create_publisher(DiagnosticArray, "/diagnostics", qos.EVENTS)
    observer.wait_for(lambda: publisher.get_subscription_count() > 0, "the page listens")
    publisher.publish(diagnostics(time.time_ns(), status(WARN, evil, evil, {})))
    shown.until("document.getElementById('node-list').textContent.includes('onerror')")
    assert shown.tab.title() == "squeal_rig"
    assert not shown.tab.query_selector("#node-list img")


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
def test_axe_finds_nothing_serious_and_the_keyboard_reaches_everything(bench, browser, scheme):
    shown = Shown(browser, bench[0], color_scheme=scheme)
    found = Axe().run(shown.tab).response["violations"]
    serious = [f"{one['id']}: {one['nodes'][0]['html']}" for one in found if one["impact"] in ("serious", "critical")]
    assert not serious
    wanted = set(
        shown.tab.eval_on_selector_all(
            "button:enabled, input, select, summary, .scroll",
            "all => all.filter(e => e.checkVisibility()).map((e, k) => { e.dataset.place = k; return String(k); })",
        )
    )
    reached = set()
    for _ in range(2 * len(wanted)):
        shown.tab.keyboard.press("Tab")
        reached.add(shown.tab.evaluate("document.activeElement.dataset.place || ''"))
    assert wanted <= reached
    shown.context.close()


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (1280, 800), (390, 844)])
def test_nothing_is_cut_off_or_lies_over_another(bench, browser, width, height):
    shown = Shown(browser, bench[0])
    shown.tab.set_viewport_size({"width": width, "height": height})
    shown.until("!document.getElementById('limits').hidden")
    shown.tab.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    assert shown.tab.evaluate("document.documentElement.scrollWidth") <= width
    boxes = shown.tab.eval_on_selector_all(
        "main section",
        "all => all.filter(e => e.checkVisibility()).map(e => { const b = e.getBoundingClientRect();"
        " return [e.id || e.innerText.slice(0, 20), b.left, b.top, b.right, b.bottom, e.scrollWidth - e.clientWidth];"
        " })",
    )
    for k, (name, left, top, right, bottom, over) in enumerate(boxes):
        assert left >= 0, name
        assert right <= width, name
        assert over <= 0, name
        for other, x0, y0, x1, y1, _ in boxes[k + 1 :]:
            assert min(right, x1) <= max(left, x0) or min(bottom, y1) <= max(top, y0), (name, other)
    tables = "[...document.querySelectorAll('.scroll')].every((one) => one.scrollWidth <= one.clientWidth)"
    assert shown.tab.evaluate(tables)
    shown.tab.evaluate("scrollTo(0, 1e6)")
    assert shown.tab.locator("#emergency-stop").is_visible()
    box = shown.tab.locator("#emergency-stop").bounding_box()
    assert 0 <= box["y"] <= height - box["height"]
    shown.context.close()


def test_a_squeal_is_a_row_of_the_table_until_it_ends(shown, observer):
    for name, value in (("preload", 300), ("mu0", 0.4), ("k1", 6e7), ("k2", 6e7)):
        assert f"{name} = " in shown.set(name, value)
    shown.press("impact")
    shown.until("document.getElementById('squeal-state').textContent.startsWith('SQUEAL')")
    row = "[...document.querySelectorAll('#squeal-rows tr:first-child td')].map((cell) => cell.textContent)"
    shown.until(f"{row}[1] === 'goes on'")
    shown.until("page.state().numbers.tones !== 'none' && page.state().numbers.events > 0")
    for name, value in (("mu0", 0.1), ("k1", 4e7), ("k2", 4e7), ("preload", 60)):
        assert f"{name} = " in shown.set(name, value)
    # Squeal that is there stays where it would not begin: reset, once the set point is in force.
    # Or once the supervisor has ramped the rig down, because the machine lost samples.
    arrived = "Math.abs(page.state().numbers.preload - 60) < 1"
    tripped = "page.state().told.supervisor.level >= 2"
    shown.until(f"{arrived} || ({tripped})")
    shown.press("reset")
    shown.until(f"{row}[1] !== 'goes on'")
    begin, end, frequency, level, preload, speed = shown.tab.evaluate(row)
    assert begin < end
    assert 500.0 < float(frequency) < 5000.0
    assert float(level) > -12.0
    assert 0.0 <= float(preload) <= 300.0
    assert float(speed) == pytest.approx(observer.get(["belt_speed"])["belt_speed"])


def test_what_a_campaign_tells_is_its_progress_on_the_page(shown, observer):
    publisher = observer.node.create_publisher(DiagnosticArray, "run/events", qos.RUN_EVENTS)
    observer.wait_for(lambda: publisher.get_subscription_count() > 0, "the page listens")

    def tell(what, **facts):
        named = {name.replace("_", " "): value for name, value in facts.items()}
        publisher.publish(diagnostics(time.time_ns(), status(OK, "run", what, named)))

    tell(RUN_STARTED, campaign="<b>Smoke</b>", points=24, done_before=4)
    tell(STEP_BEGUN, step=5, of=24, title="preload = 30")
    said = "document.getElementById('run-state').textContent"
    shown.until(f"{said}.includes('campaign <b>Smoke</b>, 4 of 24 points done; point 5: preload = 30')")
    assert shown.tab.locator("#run-progress").get_attribute("value") == "4"
    shown.tab.fill("#springs-fitted input", "stiff")
    answer = shown.answer_to(lambda: shown.tab.press("#springs-fitted input", "Enter"))
    assert "nobody offers console/set_parameters" in answer  # what tells of a run here is no console
    tell(STEP_ENDED, step=5, of=24, title="preload = 30", outcome="done", verdict="squeal")
    shown.until(f"{said}.includes('5 of 24') && {said}.includes('left')")
    assert "verdict squeal" in shown.tab.text_content("#run-last")
    observer.node.destroy_publisher(publisher)
    shown.until(f"{said}.includes('it is gone')")
    publisher = observer.node.create_publisher(DiagnosticArray, "run/events", qos.RUN_EVENTS)
    observer.wait_for(lambda: publisher.get_subscription_count() > 0, "the page listens")
    tell(RUN_ENDED, outcome="done")
    shown.until(f"{said}.includes('ended: done')")
    assert not shown.tab.is_visible("#springs-fitted")
    observer.node.destroy_publisher(publisher)


def test_what_is_heard_comes_piece_after_piece(shown):
    shown.tab.evaluate("sound.record(true)")
    shown.tab.click("#sound")
    shown.until("sound.counts().pieces > 100")
    pieces = shown.tab.evaluate("sound.received.map((one) => [one.origin, one.first, one.samples.length])")
    for (origin, first, count), (other, following, _) in itertools.pairwise(pieces):
        assert (origin, first + count) == (other, following) or other > origin  # the rig itself began anew
    # A busy machine loses a block now and then; what begins anew with every piece is no sound.
    assert len({origin for origin, _, _ in pieces}) < len(pieces) / 5
    # Whether all came in time to be played is the machine's to say: the page counts what did not.
    shown.until("document.getElementById('sound-state').textContent.includes('gaps')")
    shown.tab.click("#sound")
    assert shown.tab.get_attribute("#sound", "aria-pressed") == "false"


def test_a_bag_opens_in_the_same_page_with_a_slider_of_time(browser):
    recorded = RecordedPicture(Path(__file__).parents[2] / "bags" / "reference")
    server = PageServer(recorded.picture, Sound(), Access("127.0.0.1"), seek=recorded.at)
    server.start("127.0.0.1", 0)
    try:
        shown = Shown(browser, f"http://127.0.0.1:{server.port}/")
        assert not shown.tab.locator("#emergency-stop").is_visible()
        assert not shown.tab.locator("#controls").is_visible()
        early = shown.tab.text_content("#time-shown")
        assert not shown.tab.evaluate("page.state().numbers.squealing")
        shown.tab.focus("#time")
        shown.tab.keyboard.press("End")
        shown.until("page.state().numbers.squealing")
        assert shown.tab.text_content("#time-shown") != early
        shown.until("document.querySelectorAll('#squeal-rows tr').length === 1")
        assert shown.tab.evaluate("page.state().counts.mu.means") > 0.0
        assert not shown.troubles
        shown.context.close()
    finally:
        server.close()


def test_the_emergency_stop_acts_by_mouse_and_by_keyboard_and_the_page_leads_back(shown, observer):
    states, requests, latches = [], [], []
    subscribe = observer.node.create_subscription
    subscribe(DiagnosticArray, "rig/safe", lambda m: states.append(status_values(m.status[0])), qos.LATCHED)
    subscribe(String, "emergency_stop", lambda m: requests.append(m.data), qos.EVENTS)
    subscribe(DiagnosticArray, "supervisor/state", lambda m: latches.append(status_values(m.status[0])), qos.LATCHED)
    observer.wait_for(lambda: states and latches, "rig/safe and supervisor/state")
    assert states[-1]["stopped"] == "false"
    told = shown.answer_to(lambda: shown.tab.click("#emergency-stop"))
    observer.wait_for(lambda: states[-1]["stopped"] == "true" and states[-1]["accepted"] == "true", "the safe command")
    assert "emergency stop" in told
    shown.until("document.getElementById('rig-state').textContent.startsWith('STOPPED')")
    count = len(requests)
    shown.answer_to(lambda: shown.tab.press("#set-preload", "Escape"))
    observer.wait_for(lambda: len(requests) > count, "another request")
    # Back to work, in the order that the page tells.
    observer.wait_for(lambda: latches[-1]["latched"] == "emergency stop", "the supervisor's latch")
    shown.until("document.getElementById('supervisor-state').textContent.startsWith('emergency stop')")
    shown.until("document.getElementById('trips').textContent.includes('asked for by page')")
    assert shown.tab.locator("#way-back").is_visible()
    assert "latch" in shown.press("reset")
    shown.tab.fill("[name=reason]", "<i>a test</i>")
    assert "released: <i>a test</i>" in shown.answer_to(lambda: shown.tab.press("[name=reason]", "Enter"))
    observer.wait_for(lambda: latches[-1]["latched"] == "ok", "no latch")
    assert "set points of preload and belt speed are zero" in shown.press("reset")
    observer.wait_for(lambda: states[-1]["stopped"] == "false", "the rig free again")
    assert observer.get(["preload", "belt_speed"]) == {"preload": 0.0, "belt_speed": 0.0}
    shown.until("document.getElementById('way-back').hidden")
    assert "2000" in shown.tab.evaluate("document.getElementById('limit-rows').textContent").replace(" ", "")


@pytest.mark.slow
def test_the_page_comes_back_after_the_server_and_the_rig_were_killed(shown, bench, processes, observer, config_file):
    url, nodes, _ = bench
    port = int(re.search(r":(\d+)/", url)[1])
    for name, more in (
        ("page", {"port": port, "control": True}),
        ("simulator", {"sample_rate": _RATE, "supervisor_required": False, **PATIENT_RIG}),
    ):
        nodes[name].send(signal.SIGKILL)
        nodes[name].wait()
        if name == "page":
            shown.until("document.getElementById('link').textContent.includes('no connection')")
        else:
            shown.until("document.getElementById('rig-state').textContent === 'rig: GONE'")
            assert shown.tab.locator("#silence").is_visible()
        nodes[name] = processes.node(name, *arguments(config_file, **more))
        count = shown.tab.evaluate("page.frames()")
        shown.until(f"page.frames() > {count} + 5")
    shown.until("document.getElementById('link').textContent === 'connected'")
    observer.wait_for(lambda: "preload = 55" in shown.set("preload", 55), "the rig's answer")
