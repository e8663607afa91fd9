"""A scenario in the editor: its text with the server's problems, its blocks and its fields, which follow each other."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.console.conftest import Fleet
from tests.console.scenario_pages import PLACE, row, stored, text_of

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]


@pytest.fixture
def expected_complaints() -> list[str]:
    return ["409", "400"]


def test_a_text_is_checked_by_the_server_while_it_is_typed_and_stored(
    fleet: Fleet, open_page: Open, picture: Picture
) -> None:
    page = open_page("engineer", PLACE)
    page.get_by_role("button", name="New scenario").click()
    text = text_of(page, "new_scenario")
    problems = page.get_by_role("region", name="Problems")
    expect(problems).to_contain_text("It fits the fleet.")
    text.click()
    page.keyboard.press("Control+End")
    page.keyboard.insert_text("  # stays\n  - {task: a, skill: wrok, robot: left}\n")
    expect(problems).to_contain_text("1 problem")
    expect(problems.get_by_role("button")).to_have_text(
        "Line 7: task 'a': left has no skill 'wrok'; did you mean `work`?"
    )
    expect(page.get_by_role("button", name="Start…")).to_have_attribute("title", "Store it first.")
    picture(page, "editor-problems")
    problems.get_by_role("button").click()
    expect(text).to_be_focused()
    page.keyboard.press("End")
    page.keyboard.press("Shift+Home")
    page.keyboard.insert_text("- {task: a, ro")
    expect(page.get_by_role("option", name="robot")).to_have_count(0)
    page.keyboard.press("Control+Space")
    page.get_by_role("option", name="robot").click()
    page.keyboard.insert_text("left, skill: work}")
    expect(problems).to_contain_text("It fits the fleet.")
    page.keyboard.press("Control+s")
    expect(page.get_by_text("new_scenario was stored.")).to_be_visible()
    expect(page).to_have_url(page.url.split("#")[0] + "#/hall/scenarios/edit/new_scenario")
    stored = (fleet.plant.folder / "scenarios" / "new_scenario.yaml").read_text()
    assert stored.endswith("  - {wait: 1}\n  # stays\n  - {task: a, robot: left, skill: work}\n")


def test_a_new_scenario_is_named_and_written_by_blocks_alone(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    fleet.plant.scenario("taken", "  - {wait: 1}\n")
    page = open_page("engineer", PLACE)
    expect(row(page, "taken")).to_be_visible()
    page.get_by_role("button", name="New scenario").click()
    name, store = page.get_by_label("Name of the scenario"), page.get_by_role("button", name="Store")
    for wrong in ("2 words", ""):
        name.fill(wrong)
        page.keyboard.press("Tab")
        expect(name).to_have_accessible_description(re.compile("Begin with a letter"))
        expect(store).to_have_attribute("aria-disabled", "true")
    name.fill("taken")
    page.keyboard.press("Tab")
    expect(name).to_have_accessible_description("There is a scenario of this name.")
    picture(page, "editor-new")
    name.fill("by_blocks")
    # At once, while the blocks are still those of the text with the other name.
    put_in = page.get_by_role("group", name="Add a step").get_by_role("button", name="work")
    expect(page.get_by_role("treeitem")).to_have_count(1)
    put_in.evaluate("button => { document.activeElement.blur(); button.click(); button.click(); }")
    expect(page.get_by_role("heading", level=1, name="by_blocks")).to_be_visible()
    expect(page.get_by_role("treeitem").filter(has_text="work_2")).to_be_focused()
    store.click()
    expect(page.get_by_text("by_blocks was stored.")).to_be_visible()
    task = "  - {{task: {}, skill: work, capacity: weld}}\n"
    assert stored(fleet, "by_blocks") == "  - {wait: 1}\n" + task.format("work") + task.format("work_2")
    expect(name).to_have_count(0)


def test_who_stores_over_another_sees_what_differs(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    fleet.plant.scenario("shared", "  - {task: a, skill: work, robot: left}\n  - {wait: 1}\n")
    file = fleet.plant.folder / "scenarios" / "shared.yaml"
    page = open_page("engineer", PLACE + "/edit/shared")
    text_of(page, "shared").click()
    page.keyboard.press("Control+End")
    page.keyboard.insert_text("  # mine\n")
    file.write_text(file.read_text().replace("wait: 1", "wait: 2"))
    page.keyboard.press("Control+s")
    dialog = page.get_by_role("dialog", name="shared has changed")
    expect(dialog.get_by_role("region", name="What differs")).to_contain_text("wait: 2")
    picture(page, "editor-conflict")
    dialog.get_by_role("button", name="Store mine").click()
    expect(page.get_by_text("shared was stored.")).to_be_visible()
    assert file.read_text().endswith("  - {wait: 1}\n  # mine\n")
    page.keyboard.press("Escape")
    text_of(page, "shared").click()
    page.keyboard.press("Control+End")
    page.keyboard.insert_text("  # more\n")
    file.write_text(file.read_text().replace("wait: 1", "wait: 3"))
    page.keyboard.press("Control+s")
    dialog.get_by_role("button", name="Take the stored one").click()
    expect(text_of(page, "shared")).to_contain_text("wait: 3")
    expect(text_of(page, "shared")).not_to_contain_text("# more")


def test_blocks_are_put_in_moved_and_removed_by_keys_and_comments_stay(
    fleet: Fleet, open_page: Open, picture: Picture
) -> None:
    task = "  # of one\n  - {task: one, skill: work, robot: left}  # behind\n"
    fleet.plant.scenario("blocky", task + "  - repeat:\n      - {wait: 1}\n    times: 2\n")
    page = open_page("engineer", PLACE + "/edit/blocky")
    tree = page.get_by_role("tree", name="Blocks")
    one = tree.get_by_role("treeitem", name="one")
    expect(tree.get_by_role("treeitem")).to_have_count(3)
    one.focus()
    page.keyboard.press("Alt+ArrowDown")
    expect(one).to_be_focused()
    page.keyboard.press("Alt+ArrowRight")
    expect(one).to_have_attribute("aria-level", "2")
    palette = page.get_by_role("group", name="Add a step")
    palette.get_by_role("button", name="work").focus()
    page.keyboard.press("Enter")
    added = tree.get_by_role("treeitem", name="work → weld")
    expect(added).to_be_focused()
    expect(page.get_by_role("region", name="Problems")).to_contain_text("It fits the fleet.")
    picture(page, "editor-blocks")
    tree.get_by_role("treeitem", name="Wait").focus()
    page.keyboard.press("Delete")
    expect(tree.get_by_role("treeitem")).to_have_count(3)
    added.drag_to(tree.get_by_role("treeitem", name="Repeat"), target_position={"x": 30, "y": 4})
    expect(added).to_have_attribute("aria-level", "1")
    page.get_by_role("button", name="Store").click()
    expect(page.get_by_text("blocky was stored.")).to_be_visible()
    assert (fleet.plant.folder / "scenarios" / "blocky.yaml").read_text().partition("steps:\n")[2] == (
        "  - {task: work, skill: work, capacity: weld}\n"
        "  - repeat:\n      # of one\n      - {task: one, skill: work, robot: left}  # behind\n    times: 2\n"
    )


def test_a_long_text_is_read_in_a_thread_of_its_own(fleet: Fleet, open_page: Open) -> None:
    """So that a key which is pressed meanwhile does not wait for it. What follows it is right all the same."""
    tasks = "".join(f"  - {{task: t{number}, skill: work, robot: left}}\n" for number in range(200))
    fleet.plant.scenario("long", tasks)
    page = open_page("engineer", PLACE + "/edit/long")
    steps = page.get_by_role("tree", name="Blocks").get_by_role("treeitem")
    expect(steps).to_have_count(200)
    assert [worker.url for worker in page.workers if "reader" in worker.url]
    expect(page.get_by_role("region", name="Fields of t0")).to_be_visible()
    steps.nth(1).focus()
    expect(page.get_by_role("region", name="Fields of t1")).to_be_visible()
    text = text_of(page, "long")
    text.click()
    page.keyboard.press("Control+Home")
    page.keyboard.insert_text("# first\n")
    page.keyboard.press("Control+End")
    page.keyboard.insert_text("  - {wait: 1}\n")
    expect(steps).to_have_count(201)
    # Those that are as before stand at other lines, and in the text as it is now.
    steps.nth(1).press("Delete")
    expect(steps).to_have_count(200)
    expect(page.get_by_role("region", name="Fields of t0")).to_be_visible()
    page.get_by_role("region", name="Fields of t0").get_by_label("Retries").fill("3")
    page.keyboard.press("Control+s")
    expect(page.get_by_text("long was stored.")).to_be_visible()
    kept = tasks.replace("  - {task: t1, skill: work, robot: left}\n", "").replace("left}", "left, retries: 3}", 1)
    assert stored(fleet, "long") == f"{kept}  - {{wait: 1}}\n"
    text.click()
    page.keyboard.press("Control+Home")
    page.keyboard.insert_text("[")
    expect(page.get_by_role("alert").filter(has_text="The text cannot be read")).to_be_visible()
    page.keyboard.press("Backspace")
    expect(steps).to_have_count(200)


SLOW_READER = """
const Plain = window.Worker;
window.Worker = class extends Plain {
  postMessage(...all) { setTimeout(() => super.postMessage(...all), 400); }
};
"""


def slowly_read(name: str, fleet: Fleet, open_page: Open) -> tuple[list[str], Page]:
    """The lines of a scenario of four tasks, and its editor, which reads a text for 0.4 s."""
    tasks = [f"  - {{task: t{number}, skill: work, robot: left}}\n" for number in range(4)]
    fleet.plant.scenario(name, "".join(tasks))
    page = open_page("engineer", f"{PLACE}/edit/{name}")
    page.add_init_script(SLOW_READER)
    page.reload()
    return tasks, page


def test_edits_that_are_made_while_one_is_read_follow_it_and_none_is_lost(fleet: Fleet, open_page: Open) -> None:
    """However long a text takes that is read in the other thread."""
    tasks, page = slowly_read("slow", fleet, open_page)
    steps = page.get_by_role("tree", name="Blocks").get_by_role("treeitem")
    first, text = steps.filter(has_text="t0"), text_of(page, "slow")
    first.focus()
    for _ in range(3):
        page.keyboard.press("Alt+ArrowDown")
    expect(steps.nth(3)).to_contain_text("t0")
    expect(first).to_be_focused()
    fields = page.get_by_role("region", name="Fields of t0")
    fields.get_by_label("Retries").fill("3")
    fields.get_by_label("Skill").focus()
    page.keyboard.press("Control+s")
    expect(page.get_by_text("slow was stored.")).to_be_visible()
    kept = "".join((*tasks[1:], tasks[0].replace("left}", "left, retries: 3}")))
    assert stored(fleet, "slow") == kept
    fields.get_by_label("Retries").fill("4")
    page.get_by_role("button", name="Blocks").click()
    expect(text).to_contain_text("retries: 4")
    page.get_by_role("button", name="Blocks").click()
    first.focus()  # blocks that are opened anew begin with the first step
    fields.get_by_label("Retries").fill("5")
    page.get_by_role("link", name="Library").click()
    page.wait_for_timeout(600)  # nothing says that it was kept
    row(page, "slow").get_by_role("link").click()
    expect(text).to_contain_text("retries: 5")


def test_who_goes_on_to_another_step_stays_at_it_while_one_is_moved(fleet: Fleet, open_page: Open) -> None:
    """The keys pressed at the one before are for that one, and what is pressed next is for the other."""
    _, page = slowly_read("left_behind", fleet, open_page)
    steps = page.get_by_role("tree", name="Blocks").get_by_role("treeitem")
    first, last = steps.filter(has_text="t0"), steps.filter(has_text="t3")
    first.focus()
    for _ in range(2):
        page.keyboard.press("Alt+ArrowDown")
    last.focus()
    page.keyboard.press("Alt+ArrowUp")
    expect(steps).to_have_text([re.compile(name) for name in ("t1", "t2", "t3", "t0")])
    expect(last).to_be_focused()
    expect(page.get_by_role("region", name="Fields of t3")).to_be_visible()
    page.keyboard.press("Delete")
    page.keyboard.press("Delete")
    first.focus()
    expect(steps).to_have_text([re.compile(name) for name in ("t1", "t0")])
    expect(first).to_be_focused()


FORMS = """\
  # of one
  - {task: one, skill: work, robot: left}  # behind
  - task: two  # the second
    skill: work
    capacity: weld
  - parallel: [{wait: 1}, {wait: 2}]  # both
"""


def test_fields_of_a_step_change_its_lines_alone_and_say_what_the_server_finds_wrong(
    fleet: Fleet, open_page: Open, picture: Picture
) -> None:
    fleet.plant.scenario("formed", FORMS)
    page = open_page("engineer", PLACE + "/edit/formed")
    tree = page.get_by_role("tree", name="Blocks")
    problems = page.get_by_role("region", name="Problems")
    one = page.get_by_role("region", name="Fields of one")
    expect(one.get_by_label("Who does it")).to_have_value("robot left")
    seconds = one.get_by_label("seconds")
    expect(seconds).to_have_value("")
    seconds.fill("2.5")
    page.keyboard.press("Enter")
    expect(text_of(page, "formed")).to_contain_text("robot: left, arguments: {seconds: 2.5}}  # behind")
    seconds.fill("999")
    page.keyboard.press("Enter")
    expect(one).to_contain_text("Give")
    expect(text_of(page, "formed")).to_contain_text("seconds: 2.5")
    seconds.fill("=nothing.there")
    page.keyboard.press("Tab")
    expect(seconds).to_have_accessible_description(re.compile("no parameter, no result"))
    one.get_by_label("Skill").fill("wrok")
    one.get_by_label("Retries").fill("500")
    page.keyboard.press("Enter")
    expect(one.get_by_label("Skill")).to_have_accessible_description(re.compile("did you mean `work`"))
    expect(one.get_by_label("Retries")).to_have_accessible_description(re.compile("whole number from 0 to 100"))
    picture(page, "editor-form")
    page.get_by_role("button", name="Undo").click()
    expect(one.get_by_label("Retries")).to_have_value("")
    one.get_by_label("Skill").fill("work")
    seconds.fill("0.5 min")
    page.keyboard.press("Tab")
    expect(problems).to_contain_text("It fits the fleet.")
    tree.get_by_role("treeitem", name="two").focus()
    two = page.get_by_role("region", name="Fields of two")
    two.get_by_label("Who does it").select_option(label="right")
    two.get_by_label("If the outcome is unknown").select_option("retry")
    two.get_by_label("After").fill("one")
    page.keyboard.press("Control+s")
    expect(page.get_by_text("formed was stored.")).to_be_visible()
    assert stored(fleet, "formed") == (
        '  # of one\n  - {task: one, skill: work, robot: left, arguments: {seconds: "0.5 min"}}  # behind\n'
        "  - task: two  # the second\n    skill: work\n    robot: right\n    after: [one]\n    on_unknown: retry\n"
        "  - parallel: [{wait: 1}, {wait: 2}]  # both\n"
    )


def test_steps_in_brackets_are_moved_edited_and_put_in(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    fleet.plant.scenario("bracketed", FORMS + "  - repeat: [{wait: 3}, # why\n      {wait: 4}]\n    times: 2\n")
    page = open_page("engineer", PLACE + "/edit/bracketed?view=blocks")
    waits = page.get_by_role("treeitem", name="Wait")
    waits.nth(1).focus()
    page.keyboard.press("Alt+ArrowUp")
    expect(text_of(page, "bracketed")).to_contain_text("[{wait: 2}, {wait: 1}]  # both")
    page.get_by_role("group", name="Add a step").get_by_role("button", name="Repeat").click()
    expect(text_of(page, "bracketed")).to_contain_text("[{wait: 2}, {repeat: [{wait: 1}], times: 2}, {wait: 1}]")
    expect(page.get_by_role("treeitem", name="Repeat").first).to_be_focused()
    page.get_by_role("region", name="Fields of Repeat").get_by_label("Times").fill("3")
    page.keyboard.press("Enter")
    expect(text_of(page, "bracketed")).to_contain_text("{repeat: [{wait: 1}], times: 3}")
    page.get_by_role("treeitem", name="one").focus()
    for way in ("ArrowDown", "ArrowDown", "ArrowUp"):
        page.keyboard.press(f"Alt+{way}")
    commented = page.get_by_role("treeitem", name="Wait").last
    commented.focus()
    expect(page.get_by_role("button", name="Move up")).to_have_attribute("title", re.compile("Comments stand between"))
    page.get_by_role("region", name="Fields of Wait").get_by_label("Event").fill("door open")
    page.keyboard.press("Enter")
    expect(text_of(page, "bracketed")).to_contain_text("{wait: null, event: door open}]")
    picture(page, "editor-brackets")


def test_an_observer_reads_the_fields_of_a_step_and_changes_none(fleet: Fleet, open_page: Open) -> None:
    fleet.plant.scenario("shown", FORMS)
    page = open_page("observer", PLACE + "/edit/shown")
    one = page.get_by_role("region", name="Fields of one")
    expect(one.get_by_label("Name")).to_have_value("one")
    expect(one.get_by_label("Name")).not_to_be_editable()
    expect(one.get_by_label("Who does it")).to_be_disabled()
    expect(page.get_by_role("button", name="Undo")).to_have_count(0)
