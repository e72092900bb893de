"""A person reads recordings as documents: by keys and by the pointer, with scopes, an image and a judged session."""

import math
import os
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_page import FILLED, Page, View, has, needs_browser, open_page, until
from made_sessions import FORCE_SCALE, STEP_S, Made
from page_walks import Keyboard, check_rules, look, step, theme
from scanned_image import LINE_NS, POINTS, SIZE_M, heights_m, scanned
from stack_rig import Rig

from telenano.afm.sample.surface import Surface
from telenano.sections.surface_files import read_surface

pytestmark = [pytest.mark.browser, needs_browser]

# when the tip jumps into contact in the session that is made up, for how long it is drawn to the sample, and how hard
JUMP_S, DRAWN_S, DRAWN_NN = 1.0, 0.1, -12.5
# and how it swings afterwards
SWING_HZ, SWING_N = 3.125, 0.5
# the number of the scope of the force on the tip, from 0
TIP_SCOPE = 2
PLACE = "telenano.cockpit.document.at(performance.now())"
EVERY_SAMPLE = "telenano.cockpit.document.between(0, 0) && telenano.scopes.shownWindow.width === 0"
HALF_SECOND = "telenano.scopes.shownWindow.to - telenano.scopes.shownWindow.from < 0.6"
TITLES = "telenano.scopes.specs.map((spec) => spec.title)"
PNG = b"\x89PNG\r\n\x1a\n"


def touched(time_s: float) -> float:
    """Return alpha_f F_s [N] at a time of a session [s]: nothing, a jump into contact, and a swing."""
    if time_s < JUMP_S:
        return 0.0
    if time_s < JUMP_S + DRAWN_S:
        return DRAWN_NN * 1e-9 * FORCE_SCALE
    return SWING_N * math.sin(2.0 * math.pi * SWING_HZ * time_s)


@pytest.fixture(scope="module")
def touch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[View]:
    """Serve a session in which the tip jumps into contact."""
    made = Made(tip_n=touched, in_contact=lambda time_s: time_s >= JUMP_S)
    with closing(View(dict(os.environ), str(made.write(tmp_path_factory.mktemp("touch"))))) as view:
        yield view


def open_read(chromium: Any, view: View) -> Page:
    """Open the page of a recording, and wait until all of it was read."""
    page = open_page(chromium, view.operator)
    page.until("telenano.cockpit.document.about?.read === 1", "a recording that was read")
    return page


def saved(page: Page, action: Any) -> Path:
    """Do something that saves a file, and return it."""
    with page.page.expect_download() as found:
        action()
    return Path(found.value.path())


def go_to_the_jump(page: Page) -> None:
    """Go by keys from the beginning, event by event, to where the tip jumps into contact."""
    page.page.keyboard.press("Home")
    page.until(f"{PLACE} === 0", "the beginning")
    for _ in range(40):
        before_s = page.value(PLACE)
        page.page.keyboard.press("e")
        page.until(f"{PLACE} > {before_s}", "the next event")
        page.page.wait_for_timeout(300.0)
        if "jumps into contact" in page.page.inner_text("#place-event"):
            return
    raise AssertionError(f"no jump into contact up to {page.value(PLACE)} s")


def jump_s(page: Page) -> float:
    """Return where in the recording the tip jumps [s]."""
    return float(page.value("telenano.cockpit.document.about.session_s[0]")) + JUMP_S


# The page of a recording, where the change touches it; beside it an image in a recording is in `make check` as well.
@pytest.mark.drawn(0.0, "services/viz_node/", "telenano/serving/")
def test_a_person_finds_the_jump_to_contact_by_keys_alone_and_measures_it(chromium: Any, touch: View) -> None:
    page = open_read(chromium, touch)
    by_keys(Keyboard(page))
    with step("the rules for readers with weak eyes, on every tab"):
        check_tabs(page)
    page.page.context.close()
    with step("the pointer, on a page that is opened after the end"):
        page = open_read(chromium, touch)
        by_pointer(page)
        assert page.faults == []
        page.page.context.close()


def by_keys(keys: Keyboard) -> None:
    page = keys.page
    with step("play and pause by the space bar"):
        page.value("telenano.connection.ask({k: 'transport', action: 'rate', value: 100})")
        page.until("telenano.store.source.playing === false", "the end of the recording")
        page.value("telenano.connection.ask({k: 'transport', action: 'rate', value: 1})")
        for playing in ("true", "false"):
            assert "acknowledged" in page.answered(lambda: keys.press("Space"))
            page.until(f"telenano.store.source.playing === {playing}", "a recording that plays or stands")
    with step("the jump by the key e"):
        go_to_the_jump(page)
        # at an event it stands, to be looked at
        page.until("telenano.store.source.playing === false", "a recording that stands there")
        assert page.value(PLACE) == pytest.approx(jump_s(page), abs=0.02)
    with step("every sample of half a second"):
        keys.choose("#span", "0.5")
        page.until(HALF_SECOND, "half a second")
        page.until(EVERY_SAMPLE, "every sample")
    with step("sample by sample by the key n"):
        # of the instrument, whose samples are 5 ms apart in this recording
        before_s = page.value(PLACE)
        # letters choose in a list that has the focus
        keys.press("Tab", "n", "n")
        assert page.value(PLACE) - before_s == pytest.approx(0.01, abs=0.0051)
        keys.press("E")
    with step("the force of the jump between two cursors"):
        # A where nothing was touched, B behind the jump
        keys.press("c")
        page.until("telenano.scopes.cursors", "two cursors")
        keys.reach(f".plot:nth-child({TIP_SCOPE + 1}) .area")
        wanted_s = jump_s(page) + DRAWN_S / 2
        for _ in range(200):
            b_s = page.value("telenano.scopes.cursors[1].time")
            if abs(b_s - wanted_s) < 0.005:
                break
            keys.press("Shift+ArrowLeft" if b_s > wanted_s else "Shift+ArrowRight")
        measured = page.measured("normal, nN")
        assert measured[0] == "0"
        assert float(measured[1]) == pytest.approx(DRAWN_NN, rel=1e-3)
    with step("what is shown is saved by Enter"):
        keys.reach("#save-png")
        assert saved(page, lambda: keys.press("Enter")).read_bytes()[:8] == PNG
        keys.reach("#save-csv")
        lines = saved(page, lambda: keys.press("Enter")).read_text().splitlines()
        rows = [line.split(",") for line in lines]
        forces_n = [float(row[3]) for row in rows if (row[0], row[2]) == ("tip", "force")]
        assert min(forces_n) == pytest.approx(DRAWN_NN * 1e-9, rel=1e-5)
        assert len(forces_n) == pytest.approx(0.5 / STEP_S, abs=3)
    keys.check()


def check_tabs(page: Page) -> None:
    """Check the rules of a document with cursors, a sheet and a whole summary, in light and dark."""
    page.click(".plot:nth-child(1) .more")
    # the events have a pane where there is room for one beside the scopes, and are a tab on a narrower screen
    assert page.page.locator("#tab-events").count() == 0
    assert page.page.locator("#watch > #events").is_visible()
    wide, narrow = {"width": 1360, "height": 850}, {"width": 1280, "height": 850}
    for _ in range(2):
        for tab, size in (("summary", wide), ("image", wide), ("nodes", wide), ("events", narrow)):
            page.page.set_viewport_size(size)
            page.page.wait_for_selector(f"#tab-{tab}", state="attached")
            page.click(f"#tab-{tab}")
            check_rules(page, tab)
        page.click("#theme")


def by_pointer(page: Page) -> None:
    page.until("telenano.scopes.plots[0].data[1]?.some((value) => value > 1.9)", "the curves of the whole")
    page.until("document.querySelector('#hand-force').innerText !== '–'", "the force of the hand at the end")
    # the panel is written some times a second, and so a little after the answer has come
    rows, holds = "document.querySelectorAll('#summary tbody tr')", "telenano.cockpit.document.about.holds"
    page.until(f"{holds}.length > 0 && {rows}.length === {holds}.length", "a row for each hold")
    page.value(f"telenano.cockpit.document.seek({jump_s(page)})")
    page.choose("#span", "0.5")
    page.page.keyboard.press("c")
    page.until("telenano.scopes.cursors", "two cursors")
    page.until(HALF_SECOND, "half a second")
    page.until(EVERY_SAMPLE, "every sample")
    click_at(page, jump_s(page) + DRAWN_S / 2)
    # B is the nearer of the two: from nothing before the jump to what is read there
    until(lambda: page.measured("normal, nN")[0] == "0" != page.measured("normal, nN")[1], "the force at a cursor")
    assert float(page.measured("normal, nN")[1]) == pytest.approx(DRAWN_NN, rel=1e-3)
    until(lambda: page.measured("normal, nN")[3] != "–", "what lies between the cursors")
    assert float(page.measured("normal, nN")[3]) == pytest.approx(-DRAWN_NN, rel=1e-3)
    # on the steep edge the pointer and the cursor read the same sample, which stays while another part is drawn
    click_at(page, jump_s(page))
    pointed = page.page.locator(".plot").nth(TIP_SCOPE).locator(".at-cursor").inner_text().split()
    time_s, force_nn = page.measured("time")[1], page.measured("normal, nN")[1]
    # the time, and then each curve by its name
    assert (pointed[0], pointed[pointed.index("normal") + 1]) == (time_s.removesuffix(" s"), force_nn)
    page.value(f"telenano.cockpit.document.seek({jump_s(page) + 1.0})")
    page.page.wait_for_timeout(500.0)
    assert (page.measured("time")[1], page.measured("normal, nN")[1]) == (time_s, force_nn)


def click_at(page: Page, time_s: float) -> None:
    """Click into the scope of the tip at a time of the recording [s]."""
    x = page.value(f"telenano.scopes.plots[{TIP_SCOPE}].plot.valToPos({time_s}, 'x')")
    box = page.page.locator(".plot").nth(TIP_SCOPE).locator(".u-over").bounding_box()
    page.page.mouse.click(box["x"] + x, box["y"] + box["height"] / 2)


def drag(page: Page, scope: int, onto: int, share: float) -> None:
    """Drag a scope by its name to a place in another one, at a share of its width."""
    names, plots = page.page.locator(".plot .name b"), page.page.locator(".plot")
    box = plots.nth(onto).bounding_box()
    place = {"x": share * box["width"], "y": 0.6 * box["height"]}
    names.nth(scope).drag_to(plots.nth(onto), target_position=place)


@pytest.mark.endurance
def test_scopes_are_dragged_laid_over_one_another_ranged_and_kept(chromium: Any, touch: View) -> None:
    page = open_read(chromium, touch)
    with step("a scope is dragged before another"):
        page.choose("#layout", "Loop")
        before = page.value(TITLES)
        drag(page, 2, 0, 0.1)
        page.until(f"{TITLES}[0] === {before[2]!r}", "the third scope at the beginning")
    with step("the hand's position is dragged onto the energies: two units, two axes"):
        drag(page, 5, 2, 0.8)
        page.until(f"{TITLES}.length === 5", "one scope less")
        assert page.page.locator(".plot").nth(2).locator(".u-axis").count() == 3
    with step("a third unit has no axis, and nothing changes"):
        drag(page, 0, 2, 0.8)
        page.until("/two axes/.test(document.querySelector('#answers').textContent)", "why not")
        assert len(page.value(TITLES)) == 5
    with step("the spectrum of the force on the tip has its swing"):
        check_spectrum(page)
    with step("a wrong range is said at its field"):
        page.choose("#layout", "Touch")
        page.click(".plot:nth-child(1) .more")
        for low, high in ((2, -2), (-2, 2)):
            page.fill("#scope-low", str(low))
            page.fill("#scope-high", str(high))
            page.click("#scope-fix")
            if low > high:
                page.until(has("#scope-high-fault", "above"), "what is wrong")
    with step("a range is fixed, and automatic again"):
        scale = "telenano.scopes.plots[0].plot.scales.y0"
        page.until(f"{scale}.min === -2 && {scale}.max === 2", "the range on the axis")
        page.click("#scope-auto")
        page.until(f"{scale}.max < 2 || {scale}.min > -2", "an automatic one")
        page.click("#scope-close")
    with step("one scope is enlarged, and the others come back"):
        for hidden in ("filter((plot) => !plot.hidden).length === 1", "every((plot) => !plot.hidden)"):
            page.click(".plot:nth-child(2) .enlarge")
            page.until(f"[...document.querySelectorAll('.plot')].{hidden}", "one scope alone, or all")
    with step("a layout is kept in the browser under a name"):
        drag(page, 2, 0, 0.1)
        mine = page.value(TITLES)
        page.click("#layout-save")
        page.fill("#layout-name", "mine")
        page.click("#layout-save")
        page.choose("#layout", "Loop")
        page.page.reload()
        page.until("window.telenano?.store.streams.size", "a page that was loaded again")
        page.choose("#layout", "mine")
        assert page.value(TITLES) == mine
    with step("a layout is removed"):
        page.click("#layout-remove")
        names = page.value("[...document.querySelector('#layout').options].map((option) => option.value)")
        assert "mine" not in names
        assert page.value("document.querySelector('#layout').value") == "Loop"
    assert page.faults == []
    page.page.context.close()


def check_spectrum(page: Page) -> None:
    page.choose("#layout", "Tip")
    page.choose("#span", "5")
    # five seconds in which it swings
    page.value(f"telenano.cockpit.document.seek({jump_s(page) + 6.0})")
    page.click(".plot:nth-child(1) .more")
    page.choose("#scope-kind", "spectrum")
    page.until("telenano.scopes.specs[0].kind === 'spectrum'", "a spectrum")
    page.until("telenano.scopes.plots[0].data[1]?.length > 100", "its values")
    hertz, amplitude = page.value("telenano.scopes.plots[0].data.slice(0, 2).map((found) => [...found])")
    peak = max(range(len(hertz)), key=lambda i: amplitude[i])
    assert hertz[peak] == pytest.approx(SWING_HZ, abs=2.0 * (hertz[1] - hertz[0]))
    # alpha_f F_s of 0.5 N is 5 nN at the tip
    assert amplitude[peak] == pytest.approx(5.0, rel=0.25)
    page.click("#scope-close")


def test_an_image_in_a_recording_grows_is_measured_and_saved(chromium: Any, tmp_path: Path) -> None:
    with closing(View(dict(os.environ), str(scanned(tmp_path)))) as view:
        page = open_page(chromium, view.operator)
        with step("the surface grows while the recording plays"):
            page.until("telenano.view.surface.greatest > 0", "the first lines of the surface")
            page.until("telenano.store.source.playing === false", "the end of the recording")
            least, greatest = page.value("[telenano.view.surface.least, telenano.view.surface.greatest]")
            assert greatest - least == pytest.approx(8.0, rel=0.2)
        with step("a point is picked in three dimensions"):
            check_pick(page)
        with step("heights are exaggerated, and the picked one stays as measured"):
            page.choose("#stretch", "5")
            page.until("telenano.view.surface.mesh.scale.z === 5", "heights five times as high")
            page.until(has("#scene > .note", "drawn 5 times as high"), "the factor in words")
            picked = page.value("telenano.view.mark.position.z / 5 + telenano.view.surface.base")
            assert picked == pytest.approx(page.value("telenano.view.markHeight"), abs=1e-6)
            page.choose("#stretch", "1")
            page.until(has("#scene > .note", "as measured, to scale"), "heights to scale")
        with step("the image from above is levelled, coloured, and a profile drawn over it"):
            draw_profile(page)
        with step("the image is saved for Gwyddion and as a picture"):
            # without its plane nothing rises from one side to the other
            means = saved_heights(page).height_m.mean(axis=0)
            assert abs(np.polyfit(np.linspace(0.0, 1.0, POINTS), means, 1)[0]) < 1e-12
            page.choose("#levelling", "none")
            found = saved_heights(page)
            assert found.height_m == pytest.approx(np.array([heights_m(line) for line in range(POINTS)]), abs=1e-14)
            assert (found.width_m, found.depth_m) == pytest.approx((SIZE_M, SIZE_M), rel=1e-6)
            assert saved(page, lambda: page.click("#save-image")).read_bytes()[:8] == PNG
        with step("the surface as it was half way, and whole again ten times as fast"):
            page.value(f"telenano.cockpit.document.seek({LINE_NS * 1e-9 * POINTS / 2})")
            page.until(f"{FILLED} === {POINTS // 2 + 1}", "the surface as it was half way")
            page.choose("#rate", "10")
            assert "acknowledged" in page.answered(lambda: page.click("#play"))
            page.until(f"{FILLED} === {POINTS}", "the whole surface again")
        assert page.faults == []
        page.page.context.close()


def saved_heights(page: Page) -> Surface:
    """Return what the page saves for Gwyddion."""
    path = saved(page, lambda: page.click("#save-gsf"))
    return read_surface(path.rename(path.with_suffix(".gsf")))


def check_pick(page: Page) -> None:
    """Double-click on the surface: the note has the measured point that is there."""
    box = page.page.locator("#scene .solid > canvas").bounding_box()
    page.page.mouse.dblclick(box["x"] + box["width"] / 2, box["y"] + 0.55 * box["height"])
    page.until(has("#scene > .note", "Measured point"), "a picked point")
    note = page.page.inner_text("#scene > .note")
    numbers = re.search(r"Measured point (\d+) of line (\d+): x (\S+) nm, y (\S+) nm, z (\S+) nm", note)
    assert numbers is not None, note
    point, line = int(numbers[1]), int(numbers[2])
    step_nm = SIZE_M * 1e9 / (POINTS - 1)
    expected = (-SIZE_M * 5e8 + point * step_nm, -SIZE_M * 5e8 + line * step_nm, 1e9 * heights_m(line)[point])
    assert [float(number) for number in numbers.groups()[2:]] == pytest.approx(expected, abs=1.1e-3)


def draw_profile(page: Page) -> None:
    """Level and colour the image from above, and draw a line of 100 nm over it with the pointer."""
    page.click("#show-both")
    page.until("!document.querySelector('.flat').hidden", "the image from above")
    page.choose("#levelling", "plane")
    page.choose("#palette", "grey")
    page.choose("#range", "0.01")
    page.until("telenano.view.surface.range[0] > telenano.view.surface.base", "colours without the ends of the heights")
    page.click("#section")
    box = page.page.locator("#scene .flat canvas").bounding_box()
    frame = page.value("telenano.view.flat.frame")
    x, y = box["x"] + frame["left"], box["y"] + frame["top"] + 60.0 * frame["scale"]
    page.page.mouse.move(x + 10.0 * frame["scale"], y)
    page.page.mouse.down()
    page.page.mouse.move(x + 110.0 * frame["scale"], y, steps=4)
    page.page.mouse.up()
    page.until("telenano.view.section.profile?.distance.at(-1) > 99", "a profile along the line")
    assert page.value("telenano.view.section.profile.distance.at(-1)") == pytest.approx(100.0, abs=2.0)


@pytest.mark.endurance
def test_a_judged_session_is_in_the_window_at_every_size(chromium: Any, rig: Rig) -> None:
    summary = rig.run("--no-view")
    with closing(View(dict(os.environ), str(rig.out / "session.mcap"))) as view:
        page = open_page(chromium, view.operator)
        page.until("telenano.cockpit.document.about?.summary", "a recording that was judged")
        theme(page, "light")
        page.click("#play")
        page.until("telenano.store.source.playing === false", "a recording that stands")
        # what the page says is what the report of the session says
        assert page.value("telenano.cockpit.document.about.summary.verdict") == summary["verdict"]
        with step("the jump by the key e"):
            go_to_the_jump(page)
        page.choose("#span", "2")
        # an event names the folder of this test, which is no part of a picture
        page.value("telenano.store.events = telenano.store.events.filter(({ text }) => !text.includes('/'))")
        page.page.wait_for_timeout(1000.0)
        look(page, "recording")
        assert page.faults == []
