from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ua_demo.simulators.ur.urscript import Machine, Pose, ProgramReceiver, ScriptError, read_program
from ua_demo.simulators.ur.urscript.values import shown


def add(a: int, b: int = 1) -> int:
    return a + b


class Steps:
    """What a program said, and in which step."""

    def __init__(self, source: str) -> None:
        program = read_program(source)
        self.now, self.said = 0, list[tuple[int, Any]]()
        functions: dict[str, Callable[..., Any]] = {"say": self.say, "sync": self.sync, "wait": self.wait, "add": add}
        self.machine = Machine(program.name, program.statements, functions)

    def say(self, value: object) -> None:
        self.said.append((self.now, value))

    def sync(self) -> Generator[None]:
        yield

    def wait(self, steps: int) -> Generator[None, None, int]:
        for _ in range(steps):
            yield
        return steps

    def run(self, most: int = 200) -> list[Any]:
        while not self.machine.is_over and self.now < most:
            self.machine.step()
            self.now += 1
        return [value for _, value in self.said]


def run(body: str) -> list[Any]:
    return Steps(f"def program():\n{body}\nend\n").run()


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("1 + 2 * 3", 7),
        ("(1 + 2) * 3", 9),
        ("-2 ^ 2", -4.0),
        ("7 % 4", 3),
        ("1 / 4", 0.25),
        ("1.5e1", 15.0),
        (".5", 0.5),
        ("2 < 3 and not 3 < 2", True),
        ("True xor True", False),
        ("False or 1 == 1", True),
        ('"a" + "b"', "ab"),
        ('"n = " + 3', "n = 3"),
        ("[1, 2, 3][1]", 2),
        ("[1, 2] + [3, 4]", [4, 6]),
        ("[1, 2] * 2", [2, 4]),
        ("p[1, 2, 3, 4, 5, 6]", [1, 2, 3, 4, 5, 6]),
        ("add(1)", 2),
        ("add(1, b=5)", 6),
        ("wait(3)", 3),
    ],
)
def test_expression_has_its_value(expression: str, value: object) -> None:
    assert run(f"say({expression})") == [value]


def test_pose_stays_a_pose() -> None:
    (value,) = run("x = p[1, 2, 3, 4, 5, 6]\nx[0] = 9\nsay(x)")
    assert isinstance(value, Pose)
    assert value == [9, 2, 3, 4, 5, 6]


def test_element_of_a_variable_called_p_is_no_pose() -> None:
    assert run("def double(p):\np[0] = p[0] * 2\nreturn p\nend\nsay(double([4, 5]))") == [[8, 5]]


def test_lists_are_values() -> None:
    assert run("a = [1, 2]\nb = a\nb[0] = 9\nsay(a)\nsay(b)") == [[1, 2], [9, 2]]


def test_branches_and_loops() -> None:
    body = """
    n = 0
    while True:
        n = n + 1
        if n == 2:
            continue
        elif n > 4:
            break
        else:
            say(n)
        end
    end
    say("over")"""
    assert run(body) == [1, 3, 4, "over"]


def test_functions_see_what_is_around_them_and_keep_their_own() -> None:
    body = """
    global count = 0
    def raised(by):
        count = count + by
        own = 5
        return count
    end
    say(raised(by=2))
    say(raised(3))
    say(count)"""
    assert run(body) == [2, 5, 5]
    with pytest.raises(ScriptError, match="no variable own"):
        run("def f():\nown = 1\nend\nf()\nsay(own)")


def test_value_may_stand_on_the_next_line_and_a_statement_after_another() -> None:
    """What ur-rtde's control program looks like after its registers were put in."""
    assert run("global a = # offset\n24    global b = # offset\n0    say(a + b)") == [24]


def test_threads_run_beside_each_other_and_are_killed() -> None:
    body = """
    thread ticking():
        while True:
            say("tick")
            sync()
        end
    end
    handle = run ticking()
    wait(3)
    kill handle
    kill 0
    wait(3)
    say(handle == 0)"""
    steps = Steps(f"def program():\n{body}\nend\n")
    assert steps.run() == ["tick", "tick", False]


def test_end_of_the_program_ends_its_threads() -> None:
    steps = Steps("def program():\nthread t():\nwhile True:\nsync()\nend\nend\nx = run t()\nwait(1)\nend\n")
    steps.run()
    assert steps.machine.is_over


def test_join_waits_for_a_thread() -> None:
    body = 'thread t():\nwait(3)\nsay("thread")\nend\nx = run t()\njoin x\nsay("after")'
    assert run(body) == ["thread", "after"]


def test_endless_loop_leaves_the_others_their_time() -> None:
    steps = Steps(
        "def program():\nthread spin():\nwhile True:\nx = 1\nend\nend\ny = run spin()\nwait(2)\nsay(1)\nend\n"
    )
    assert steps.run(10) == [1]


@pytest.mark.parametrize(
    ("source", "line", "reason"),
    [
        ("def p():\n  movej(\nend", 3, "a value was expected"),
        ("def p():\n  x = 1\n", 3, "'end' was expected"),
        ("def p():\nend\nx = 1", 3, "nothing may follow"),
        ('def p():\n  say("a\n")\nend', 2, "has no meaning"),
        ("def p():\n  3 = x\nend", 2, "only a variable"),
        ("def p():\n  x = p[1, 2]\nend", 2, "six numbers"),
        ("def p(a b):\nend", 1, "',' was expected"),
        ("x = $", 1, "has no meaning"),
        ("", 0, "no statement"),
        ("(" * 5000 + "1" + ")" * 5000, 0, "too deep"),
        ("def p():\n" + "if True:\n" * 150 + "end\n" * 151, 101, "too deep"),
    ],
)
def test_what_is_no_program_says_where_and_why(source: str, line: int, reason: str) -> None:
    with pytest.raises(ScriptError, match=reason) as caught:
        read_program(source)
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("x = y", "no variable y"),
        ("fly()", "no function fly"),
        ("x = 1 / 0", "zero"),
        ("x = [1][3]", "no element 3"),
        ("x = [1][True]", "integer"),
        ("if 1:\nend", "True or False"),
        ('x = "a" - 1', "a number was expected"),
        ("add(1, 2, 3)", "add: too many"),
        ("add(1, c=2)", "add: .*unexpected"),
        ("def f(a):\nend\nf()", r"f takes \(a\)"),
        ("def f():\nf()\nend\nf()", "calls itself"),
        ("x = (0 - 8) ^ 0.5", "root of a negative"),
        ('x = "a"\nwhile True:\nx = x + x\nend', "65536"),
        ("thread t():\nwhile True:\nsync()\nend\nend\nwhile True:\nx = run t()\nend", "50 threads"),
    ],
)
def test_mistake_ends_the_program_with_its_line(body: str, reason: str) -> None:
    steps = Steps(f"def program():\n{body}\nend\n")
    with pytest.raises(ScriptError, match=reason) as caught:
        steps.run()
    assert caught.value.line > 1
    assert steps.machine.is_over


def test_integers_do_not_grow_without_end() -> None:
    (value,) = run("x = 2\nn = 0\nwhile n < 9:\nx = x * x\nn = n + 1\nend\nsay(x)")
    assert isinstance(value, float)


def test_texts_are_as_textmsg_writes_them() -> None:
    assert shown(Pose([0.25, 1, 2, 3, 4, 5])) == "p[0.25, 1, 2, 3, 4, 5]"
    assert [shown(value) for value in (True, 1.0, [1, "a"])] == ["True", "1", "[1, a]"]


PIECES = st.sampled_from(
    [
        "def a():",
        "end",
        "if",
        "while",
        "x",
        "=",
        "1",
        "p[",
        "[",
        "]",
        "(",
        ")",
        ",",
        ":",
        "\n",
        '"a"',
        "run",
        "^",
        "-",
        "or",
    ]
)


@given(st.lists(PIECES, max_size=40).map(" ".join) | st.text(max_size=80))
def test_whatever_comes_is_a_program_or_a_script_error(source: str) -> None:
    with contextlib.suppress(ScriptError):
        read_program(source)


PROGRAM = "def a():\n  if True:\n    say(1)  # end\n  end\nend\n"


@given(st.lists(st.integers(1, 60), max_size=10))
def test_programs_are_found_however_tcp_cuts_them(cuts: list[int]) -> None:
    data = (PROGRAM + "set_digital_out(1, True)\n\n" + PROGRAM).encode()
    receiver, found, at = ProgramReceiver(), list[str](), 0
    for cut in [*cuts, len(data)]:
        found += receiver.feed(data[at : at + cut])
        at += cut
    found += receiver.feed(data[at:])
    assert found == [PROGRAM, "set_digital_out(1, True)\n", PROGRAM]


def test_program_without_end_is_not_kept_for_ever() -> None:
    receiver = ProgramReceiver()
    receiver.feed(b"def a():\n" + b" " * 900_000 + b"\n")
    with pytest.raises(ValueError, match="more than"):
        receiver.feed(b" " * 200_000)
