"""Messages of each kind survive their way, and tasks wait for what comes of them."""

from pathlib import Path

import numpy as np
import pytest

from tests.localization.distributed.test_distributed import QUICK, grown
from tests.structures import NOISY
from tiswarm.localization.distributed import messages
from tiswarm.localization.distributed.messages import KINDS
from tiswarm.localization.distributed.waiting import Answers, Return, Tasks, Timeout, WhenPlaced
from tiswarm.localization.distributed.wire import Asked, JointShift, write_shift
from tiswarm.sensing import observe

PAGE = Path(__file__).parents[3] / "docs" / "notes" / "messages.md"
CONTENTS = [
    messages.Join([2, 3], 1, b"line"),
    messages.Join([2, 3], None, b""),
    messages.Task([4], b"line"),
    messages.Full([4]),
    messages.Ask.of({2: Asked(True, 77, 5), 3: Asked(False, 0, 0)}),  # noqa: FBT003
    messages.Answer([1], b"answer"),
    messages.Lines.of(1, {7: b"line", 300: b"another line"}),
    messages.Place.of({2: b"there", 5: b"here"}),
    messages.Moved([1, 2]),
    messages.Child([0]),
    messages.Left([1, 4], [2, 300]),
    messages.ReviewWalk([0], 4000, 7),
    messages.ReturnedWalk([0], 4000, 7),
    messages.Walking([0]),
    messages.Branch([6], b"shift"),
    messages.Shift([6, 7], b"shift"),
    messages.Hang([6], b"shift", b"pair"),
    messages.Lost([1]),
]


def test_all_kinds_are_tried_below():
    """A kind that is added gets an example."""
    assert {type(content) for content in CONTENTS} == {*KINDS.values()}


@pytest.mark.parametrize("content", CONTENTS, ids=lambda content: content.kind)
def test_a_message_that_is_read_packs_as_it_was_sent(content):
    """Robots pass on what they read, so each byte and each receiver stays."""
    sent = content.message(9)

    read = KINDS[sent.kind].read(sent)

    assert read.message(9) == sent


def test_lines_come_back_with_their_robots():
    """Numbers above one byte, too."""
    lines = messages.Lines.of(1, {7: b"line", 300: b"another line"})

    assert [*lines.lines()] == [(7, b"line"), (300, b"another line")]


def test_the_count_of_contacts_stays_within_a_byte():
    """The farthest robots count as equally far."""
    place = messages.Place([1], {1: b""}, contacts=254)

    assert [place.passed_on().contacts, place.passed_on().passed_on().contacts] == [255, 255]


def test_the_page_shows_each_kind_of_message():
    """The chart uses the names of the code."""
    page = PAGE.read_text()

    assert [kind.__name__ for kind in KINDS.values() if f" {kind.__name__}" not in page] == []


def test_a_task_drops_the_one_that_waits_for_the_same():
    """Tasks that wait for something else go on."""
    went_on = []

    def waits_for(wait, name):
        yield wait
        went_on.append(name)

    tasks = Tasks()
    tasks.start(waits_for(Answers({1}), "first"))
    tasks.start(waits_for(Return(5), "walk"))
    tasks.start(waits_for(Answers({2}), "second"))

    tasks.wake(Answers, Timeout(is_last=False))
    tasks.wake(Answers, Timeout(is_last=False))
    tasks.wake(Return, Timeout(is_last=False))

    assert went_on == ["second", "walk"]
    assert tasks.next_sort is None


def test_time_runs_out_for_answers_before_walks_and_places():
    """A robot repeats its questions first."""

    def waits_for(wait):
        yield wait

    tasks = Tasks()
    order = []
    for wait in (WhenPlaced(), Return(5), Answers({1})):
        tasks.start(waits_for(wait))
        order.append(tasks.next_sort)

    assert order == [WhenPlaced, Return, Answers]
    assert tasks.visited == 5
    assert tasks.answers == Answers({1})


def test_a_robot_passes_the_shift_of_a_body_on_once(towers):
    """After losses two robots may each hang on the other: a shift must not go around for ever."""
    robot = grown(observe(towers[0], NOISY), QUICK, 6).robots[2]
    robot.parent = 0
    robot.children = {4, 5}
    robot.bodies = {3}
    shift = write_shift(JointShift(1, np.ones(3), body=3, joined=0, sd=0.1), QUICK.bits)

    for parent in (0, 1, 0):
        robot.hear(messages.Shift([2], shift).message(parent))

    passed_on = [message for message in robot.outbox if message.kind == "shift"]
    assert [{*message.parts} for message in passed_on] == [{4, 5}]


def test_a_shift_of_another_body_ends_at_a_robot(towers):
    """It would go around in a body that does not move, and change what hangs on whom."""
    robot = grown(observe(towers[0], NOISY), QUICK, 6).robots[2]
    before = robot.parent, {*robot.children}
    shift = write_shift(JointShift(1, np.ones(3), body=3, joined=0, sd=0.1), QUICK.bits)

    robot.hear(messages.Shift([2], shift).message(5))

    assert not robot.outbox
    assert (robot.parent, robot.children) == before
