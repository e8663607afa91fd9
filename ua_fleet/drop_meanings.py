"""What the causes of dropped messages mean, in the words of `ua_fleet.counters`."""

from __future__ import annotations

import ast
import inspect
from functools import cache

from ua_fleet.counters import NO_LOSS, Drop

__all__ = ["drop_meanings", "is_loss"]


@cache
def drop_meanings() -> dict[str, str]:
    """By cause; the words stand below each member, where a reader of the code finds them too."""
    (definition,) = ast.parse(inspect.getsource(Drop)).body
    assert isinstance(definition, ast.ClassDef)
    meanings: dict[str, str] = {}
    for member, text in zip(definition.body, definition.body[1:], strict=False):
        if isinstance(member, ast.Assign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
            name = member.targets[0]
            assert isinstance(name, ast.Name)
            meanings[Drop[name.id].value] = " ".join(str(text.value.value).split())
    return meanings


def is_loss(cause: str) -> bool:
    """Whether somebody may miss what was dropped for this cause: it was neither there already nor unwanted."""
    return cause not in NO_LOSS and "Normal" not in drop_meanings().get(cause, "")
