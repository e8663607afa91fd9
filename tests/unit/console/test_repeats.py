"""What a command was answered, for a page that asks again: once carried out, kept for a while, and bounded."""

from __future__ import annotations

from ua_fleet.console.repeats import NOT_KNOWN, KeptAnswers

START = ("key", "hall", "oscar", "skill.start", "hash")


async def test_an_answer_is_kept_for_two_minutes() -> None:
    answers = KeptAnswers()
    assert answers.find(START, 0.0) is None
    assert answers.begin(START)
    waiting = answers.find(START, 1000.0)  # it is still carried out
    assert waiting is not None
    assert not waiting.done()
    answers.end(START, (200, '{"result":1}'), 1000.0)
    assert waiting.result() == (200, '{"result":1}')
    assert answers.find((*START[:-1], "other parameters"), 1001.0) is None
    assert answers.find(START, 1119.9) is waiting
    assert answers.find(START, 1120.0) is None
    assert len(answers) == 0


async def test_a_large_answer_is_not_kept_but_that_there_was_one() -> None:
    answers = KeptAnswers()
    answers.begin(START)
    answers.end(START, (200, "x" * 100_000), 0.0)
    kept = answers.find(START, 1.0)
    assert kept is not None
    status, text = kept.result()
    assert (status, "was answered; load the page again" in text, len(text) < 300) == (409, True, True)


async def test_the_oldest_is_forgotten_for_the_newest_and_who_waits_for_it_is_told() -> None:
    answers = KeptAnswers()
    answers.begin(START)
    waiting = answers.find(START, 0.0)
    assert waiting is not None
    begun = [answers.begin((str(number),)) for number in range(32)]
    assert begun == [True] * 31 + [False]
    assert waiting.result() == NOT_KNOWN
    answers.end(START, (200, "late"), 1.0)
    assert (answers.find(START, 1.0), len(answers)) == (None, 32)
