"""URScript text to a program: tokens, then statements by recursive descent.

Blocks end with `end`; indentation says nothing. A line ends an expression, but only one that is complete, and a
statement needs no line of its own: ur-rtde sends `global x =`, and on the next line the value and another statement.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from ua_demo.simulators.ur.urscript import nodes, statements
from ua_demo.simulators.ur.urscript.nodes import Expression, Flow, Statement
from ua_demo.simulators.ur.urscript.values import ScriptError

__all__ = ["Program", "read_program"]

_TOKEN: Final = re.compile(
    r"""(?P<space>[ \t\r]+|\#[^\n]*)
      | (?P<line>\n|;)
      | (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)
      | (?P<text>"[^"\n]*")
      | (?P<name>[A-Za-z_]\w*)
      | (?P<sign><=|>=|==|!=|[-+*/%^<>=()\[\],:])""",
    re.VERBOSE,
)
_KEYWORDS: Final = re.compile(
    "def|thread|sec|end|global|local|while|if|elif|else|return|break|continue|run|kill|join|halt|and|or|xor|not"
    "|enter_critical|exit_critical|pass|True|False"
)
_DEEPEST: Final = 100


class Program(NamedTuple):
    """A program that can be run."""

    name: str
    is_secondary: bool
    """`sec`: it runs beside the program that is there, and does not move the arm."""
    statements: tuple[Statement, ...]


class _Token(NamedTuple):
    kind: str
    text: str
    line: int
    touches: bool
    """Whether no space is before it."""


def _tokens(source: str) -> list[_Token]:
    tokens: list[_Token] = []
    position, line, touches = 0, 1, False
    while position < len(source):
        match = _TOKEN.match(source, position)
        if match is None:
            raise ScriptError(f"{source[position]!r} has no meaning here", line)
        kind, text = match.lastgroup or "", match.group()
        if kind != "space":
            if kind == "name" and _KEYWORDS.fullmatch(text):
                kind = "keyword"
            tokens.append(_Token(kind, text, line, touches))
        touches = kind != "space"
        line += text.count("\n")
        position = match.end()
    tokens.append(_Token("line", "\n", line, False))
    tokens.append(_Token("end", "", line, False))
    return tokens


def read_program(source: str) -> Program:
    """A whole program: one `def` or `sec`, or single statements.

    Raises:
        ScriptError: it is none; with the line.
    """
    try:
        return _Reader(_tokens(source)).program()
    except RecursionError:
        raise ScriptError("expressions within expressions are too deep") from None


class _Reader:
    def __init__(self, tokens: list[_Token]) -> None:
        self._tokens, self._at, self._depth = tokens, 0, 0

    # Tokens

    @property
    def _next(self) -> _Token:
        return self._tokens[self._at]

    def _take(self) -> _Token:
        token = self._tokens[self._at]
        if token.kind != "end":
            self._at += 1
        return token

    def _is(self, *texts: str) -> bool:
        return self._next.text in texts and self._next.kind not in ("text", "end")

    def _accept(self, *texts: str) -> bool:
        if self._is(*texts):
            self._at += 1
            return True
        return False

    def _expect(self, text: str) -> None:
        if not self._accept(text):
            raise ScriptError(f"{text!r} was expected, and there is {self._next.text!r}", self._next.line)

    def _name(self) -> str:
        token = self._take()
        if token.kind != "name":
            raise ScriptError(f"a name was expected, and there is {token.text!r}", token.line)
        return token.text

    def _skip_lines(self) -> None:
        while self._next.kind == "line":
            self._at += 1

    # Statements

    def program(self) -> Program:
        self._skip_lines()
        if self._is("def", "sec"):
            is_secondary = self._next.text == "sec"
            whole = self._definition()
            self._skip_lines()
            if self._next.kind != "end":
                raise ScriptError("nothing may follow the program", self._next.line)
            return Program(whole.name, is_secondary, whole.body)
        block = self._block()
        if self._next.kind != "end":
            raise ScriptError(f"{self._next.text!r} ends no block", self._next.line)
        if not block:
            raise ScriptError("there is no statement")
        return Program("unnamed", False, block)

    def _block(self) -> tuple[Statement, ...]:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise ScriptError("blocks within blocks are too deep", self._next.line)
        block: list[Statement] = []
        self._skip_lines()
        while self._next.kind != "end" and not self._is("end", "elif", "else"):
            block.append(self._statement())
            self._skip_lines()
        self._depth -= 1
        return tuple(block)

    def _statement(self) -> Statement:
        line = self._next.line
        if self._is("def", "thread", "sec"):
            return self._definition()
        if self._accept("global"):
            return self._assignment("global")
        if self._accept("local"):
            return self._assignment("local")
        if self._accept("while"):
            condition, body = self._expression(), self._indented()
            self._expect("end")
            return statements.While(line, condition, body)
        if self._accept("if"):
            return self._condition(line)
        if self._accept("return"):
            ends = self._next.kind in ("line", "end")
            return statements.Return(line, None if ends else self._expression())
        if self._accept("break"):
            return statements.Leave(line, Flow.BREAK)
        if self._accept("continue"):
            return statements.Leave(line, Flow.CONTINUE)
        if self._accept("kill"):
            return statements.Kill(line, self._expression(), waits=False)
        if self._accept("join"):
            return statements.Kill(line, self._expression(), waits=True)
        if self._accept("enter_critical", "exit_critical", "pass"):
            return statements.Pass(line)
        if self._accept("halt"):
            return statements.Evaluate(line, nodes.Call("halt", ()))
        return self._simple(line)

    def _simple(self, line: int) -> Statement:
        """An assignment, or an expression."""
        if self._next.kind == "name" and self._tokens[self._at + 1].text == "=":
            return self._assignment("")
        expression = self._expression()
        if not self._accept("="):
            return statements.Evaluate(line, expression)
        if not (isinstance(expression, nodes.Index) and isinstance(expression.of, nodes.Name)):
            raise ScriptError("only a variable, or an element of one, can be assigned to", line)
        return statements.AssignItem(line, expression.of.name, expression.at, self._expression())

    def _assignment(self, kind: str) -> Statement:
        line, name = self._next.line, self._name()
        if kind == "local" and not self._is("="):
            return statements.Assign(line, name, nodes.Constant(False), kind)
        self._expect("=")
        return statements.Assign(line, name, self._expression(), kind)

    def _definition(self) -> statements.Define:
        line = self._take().line
        name = self._name()
        self._expect("(")
        parameters: list[str] = []
        while not self._accept(")"):
            parameters.append(self._name())
            if not self._is(")"):
                self._expect(",")
        body = self._indented()
        self._expect("end")
        return statements.Define(line, name, tuple(parameters), body)

    def _indented(self) -> tuple[Statement, ...]:
        self._expect(":")
        return self._block()

    def _condition(self, line: int) -> Statement:
        branches = [(self._expression(), self._indented())]
        while self._accept("elif"):
            branches.append((self._expression(), self._indented()))
        otherwise = self._indented() if self._accept("else") else ()
        self._expect("end")
        return statements.If(line, tuple(branches), otherwise)

    # Expressions, from the loosest binding to the tightest

    def _expression(self) -> Expression:
        parts = [self._exclusive()]
        while self._accept("or"):
            parts.append(self._exclusive())
        return nodes.Logic(False, tuple(parts)) if len(parts) > 1 else parts[0]

    def _exclusive(self) -> Expression:
        left = self._conjunction()
        while self._accept("xor"):
            left = nodes.Binary("xor", left, self._conjunction())
        return left

    def _conjunction(self) -> Expression:
        parts = [self._negation()]
        while self._accept("and"):
            parts.append(self._negation())
        return nodes.Logic(True, tuple(parts)) if len(parts) > 1 else parts[0]

    def _negation(self) -> Expression:
        if self._accept("not"):
            return nodes.Not(self._negation())
        return self._comparison()

    def _comparison(self) -> Expression:
        left = self._sum()
        while self._is("==", "!=", "<", "<=", ">", ">="):
            sign = self._take().text
            left = nodes.Binary(sign, left, self._sum())
        return left

    def _sum(self) -> Expression:
        left = self._term()
        while self._is("+", "-"):
            sign = self._take().text
            left = nodes.Binary(sign, left, self._term())
        return left

    def _term(self) -> Expression:
        left = self._signed()
        while self._is("*", "/", "%"):
            sign = self._take().text
            left = nodes.Binary(sign, left, self._signed())
        return left

    def _signed(self) -> Expression:
        if self._accept("-"):
            return nodes.Negative(self._signed())
        if self._accept("+"):
            return self._signed()
        base = self._postfix()
        return nodes.Binary("^", base, self._signed()) if self._accept("^") else base

    def _postfix(self) -> Expression:
        expression = self._primary()
        while self._accept("["):
            expression = nodes.Index(expression, self._expression())
            self._expect("]")
        return expression

    def _items(self, closing: str) -> tuple[Expression, ...]:
        items: list[Expression] = []
        self._skip_lines()
        while not self._accept(closing):
            items.append(self._expression())
            self._skip_lines()
            if not self._is(closing):
                self._expect(",")
        return tuple(items)

    def _primary(self) -> Expression:
        self._skip_lines()
        token = self._take()
        if token.kind == "number":
            return nodes.Constant(float(token.text) if set(token.text) & set(".eE") else int(token.text))
        if token.kind == "text":
            return nodes.Constant(token.text[1:-1])
        if token.text in ("True", "False") and token.kind == "keyword":
            return nodes.Constant(token.text == "True")
        if token.text == "run" and token.kind == "keyword":
            name = self._name()
            self._expect("(")
            return nodes.Run(self._call(name))
        if token.kind == "sign" and token.text == "(":
            expression = self._expression()
            self._expect(")")
            return expression
        if token.kind == "sign" and token.text == "[":
            return nodes.Items(self._items("]"))
        if token.kind == "name":
            return self._named(token)
        raise ScriptError(f"a value was expected, and there is {token.text!r}", token.line)

    def _named(self, token: _Token) -> Expression:
        if self._accept("("):
            return self._call(token.text)
        if token.text == "p" and self._is("[") and self._next.touches:
            line = self._take().line
            items = self._items("]")
            if len(items) == 1:  # an element of a variable that is called p
                return nodes.Index(nodes.Name("p"), items[0])
            if len(items) != 6:
                raise ScriptError(f"a pose has six numbers, and this has {len(items)}", line)
            return nodes.Items(items, is_pose=True)
        return nodes.Name(token.text)

    def _call(self, name: str) -> nodes.Call:
        arguments: list[Expression] = []
        named: list[tuple[str, Expression]] = []
        self._skip_lines()
        while not self._accept(")"):
            if self._next.kind == "name" and self._tokens[self._at + 1].text == "=":
                key = self._name()
                self._expect("=")
                named.append((key, self._expression()))
            else:
                arguments.append(self._expression())
            self._skip_lines()
            if not self._is(")"):
                self._expect(",")
                self._skip_lines()
        return nodes.Call(name, tuple(arguments), tuple(named))
