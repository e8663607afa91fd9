# pyright: basic, reportMissingImports=false
"""Message types of ROS 1: installed ones, and those made from the definition that a publisher sends along.

genpy turns a definition into Python code and runs it. It does not check all of what it copies into that code (the
name of a constant, for one), so a definition from the network is first brought into a form in which nothing but
declarations is left.
"""

from __future__ import annotations

import contextlib
import importlib.machinery
import re
import shutil
import sys
import threading
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import genpy.dynamic
import genpy.message

from ua_bridges.ros.schema import MessageSchema, schema_from_definition
from ua_bridges.ros1.layout import Layout, TooMany, layout_of
from ua_fleet.errors import UaFleetError
from ua_fleet.values import StatusCode

__all__ = [
    "MessageType",
    "TypeUnavailable",
    "installed_type",
    "needed_service",
    "needed_type",
    "sanitized",
    "type_from_definition",
    "type_of_publisher",
]

MAX_DEFINITION_CHARS: Final = 100_000
"""The longest definition that a class is made of; the longest of the common ones has about 12,000."""
CACHED_TYPES: Final = 512
"""Classes that are kept for the next topic of their type; those that a topic reads stay in any case."""

MAX_SECTIONS: Final = 100
"""Types in one definition. genpy's time grows with their square and more."""

_generating = threading.Lock()
"""genpy changes the process's list of folders to import from."""

_GENERATION_ERRORS = (
    genpy.dynamic.genmsg.InvalidMsgSpec,
    genpy.dynamic.genmsg.msg_loader.MsgNotFound,
    genpy.dynamic.genmsg.MsgGenerationException,
    SyntaxError,
    NameError,
    ValueError,
    TypeError,
    KeyError,
    RecursionError,
)
"""What genpy and the code that it makes raise on a definition with a mistake in it."""
_TYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_FIELD = re.compile(
    r"(?P<type>[A-Za-z][A-Za-z0-9_]*(?:/[A-Za-z][A-Za-z0-9_]*)?(?:\[\d{0,6}\])?)\s+(?P<name>[A-Za-z][A-Za-z0-9_]*)",
    re.ASCII,
)
_CONSTANT = re.compile(
    r"(?P<type>bool|byte|char|u?int(?:8|16|32|64)|float(?:32|64))\s+(?P<name>[A-Za-z][A-Za-z0-9_]*)\s*=\s*"
    r"(?P<value>True|False|[+-]?[0-9.][0-9A-Za-z.+-]{0,39})",
    re.ASCII,
)
_SEPARATOR = "=" * 80
_HEADER: Final = "std_msgs/Header"
_TIMES: dict[str, type[Any]] = {"time": genpy.Time, "duration": genpy.Duration}


class _NoExit:
    """In place of genpy's `atexit`: what it would remove at the end is removed at once."""

    @staticmethod
    def register(*_: object) -> None:
        """Nothing is left to do."""


genpy.dynamic.atexit = _NoExit


class TypeUnavailable(UaFleetError):
    """A message type that is not installed here, or a definition that no class can, or may, be made of."""

    ua_status = StatusCode.BAD_NOT_SUPPORTED
    remedy = "Install the package of the message type beside rospy, as `python3-<package>`."


def sanitized(definition: str) -> str:
    """The definition with its fields and numeric constants alone, one to a line; raises TypeUnavailable.

    String constants and comments go: neither is in the messages.
    """
    if len(definition) > MAX_DEFINITION_CHARS:
        raise TypeUnavailable(f"the definition has {len(definition)} characters, at most {MAX_DEFINITION_CHARS}")
    if definition.count("MSG: ") > MAX_SECTIONS:
        raise TypeUnavailable(f"the definition has more than {MAX_SECTIONS} types in it")
    lines: list[str] = []
    for raw in definition.splitlines():
        if raw.strip() == _SEPARATOR:
            lines.append(_SEPARATOR)
            continue
        if raw.startswith("MSG: "):
            name = raw[5:].strip()
            if _TYPE.fullmatch(name) is None:
                raise TypeUnavailable(f"{name[:80]!r} is not the name of a message type")
            lines.append(f"MSG: {name}")
            continue
        if re.match(r"\s*string\s+[A-Za-z]\w*\s*=", raw, re.ASCII):
            continue
        line = raw.split("#", 1)[0].strip()
        if not line:
            continue
        match = _FIELD.fullmatch(line) or _CONSTANT.fullmatch(line)
        if match is None:
            raise TypeUnavailable(f"{line[:80]!r} is neither a field nor a constant")
        lines.append(
            f"{match['type']} {match['name']}" + (f"={match['value']}" if "value" in match.groupdict() else "")
        )
    return "\n".join(lines) + "\n"


class MessageType(NamedTuple):
    """A ROS 1 message type of this process. See `ua_bridges.ros.serialized.MessageKind`."""

    name: str
    cls: type[Any]
    make: Callable[[str], Any]
    """Makes an empty message of a type that stands in this one, also `time` and `duration`."""
    layout: Layout
    """How many elements its messages have."""

    @property
    def definition(self) -> str:
        """The full definition, with the types that it needs."""
        return str(self.cls._full_text)  # noqa: SLF001 - genpy's name for it

    @property
    def schema(self) -> MessageSchema:
        """See MessageKind."""
        return schema_from_definition(self.name, self.definition)

    @property
    def header(self) -> str | None:
        """See MessageKind."""
        types: list[str] = list(self.cls._slot_types)  # noqa: SLF001 - genpy's name for it
        return str(self.cls.__slots__[types.index(_HEADER)]) if _HEADER in types else None

    def message_reader(self) -> Callable[[bytes], Any]:
        """See MessageKind; it raises what genpy raises."""
        return lambda content: self.cls().deserialize(content)

    @property
    def md5sum(self) -> str:
        """What both ends of a link compare."""
        return str(self.cls._md5sum)  # noqa: SLF001


@lru_cache(maxsize=CACHED_TYPES)
def _generate(message_type: str, definition: str) -> MessageType:
    layout = _layout(message_type, definition)
    try:
        classes = _generated(message_type, definition)
    except _GENERATION_ERRORS as error:
        raise TypeUnavailable(f"no class can be made of the definition of {message_type}: {error}") from error
    makers = _TIMES | classes
    return MessageType(message_type, classes[message_type], lambda name: makers[name](), layout)


def _generated(message_type: str, definition: str) -> dict[str, type[Any]]:
    """The classes of a definition. What genpy leaves behind for ever goes: a folder, and an imported module."""
    with _generating:
        folders = len(sys.path)
        known = set(sys.modules)
        try:
            classes: dict[str, type[Any]] = genpy.dynamic.generate_dynamic(message_type, definition)
        finally:
            for folder in sys.path[folders:]:
                shutil.rmtree(folder, ignore_errors=True)
            del sys.path[folders:]
            for name in [each for each in sys.modules if each not in known and each.startswith("tmp")]:
                del sys.modules[name]
    return classes


def _layout(message_type: str, definition: str) -> Layout:
    try:
        return layout_of(message_type, definition)
    except (TooMany, ValueError) as error:
        raise TypeUnavailable(f"{message_type} is not read: {error}") from error


def type_from_definition(message_type: str, definition: str) -> MessageType:
    """The message type that a definition describes; raises TypeUnavailable."""
    if _TYPE.fullmatch(message_type) is None:
        raise TypeUnavailable(f"{message_type[:80]!r} is not the name of a message type")
    return _generate(message_type, sanitized(definition))


def _make_installed(name: str) -> Any:
    if name in _TIMES:
        return _TIMES[name]()
    found = installed_type(name)
    if found is None:
        raise TypeUnavailable(f"the message type {name} is not installed")
    return found.cls()


@lru_cache(maxsize=CACHED_TYPES)
def installed_type(message_type: str) -> MessageType | None:
    """The type of an installed message package, or None.

    The name may come from the network, so nothing is imported that is not a package of messages.
    """
    if _TYPE.fullmatch(message_type) is None:
        return None
    package, name = message_type.split("/")
    spec = importlib.machinery.PathFinder.find_spec(package)
    places = (spec.submodule_search_locations if spec else None) or ()
    if not any((Path(place) / "msg" / f"_{name}.py").is_file() for place in places):
        return None
    found: type[Any] | None = genpy.message.get_message_class(message_type)
    if found is None:
        return None
    layout = _layout(message_type, sanitized(str(found._full_text)))  # noqa: SLF001 - genpy's name for it
    return MessageType(message_type, found, _make_installed, layout)


def needed_type(message_type: str) -> MessageType:
    """The installed type; raises TypeUnavailable with the package to install."""
    kind = installed_type(message_type)
    if kind is None:
        raise _missing("message", message_type)
    return kind


def needed_service(service_type: str) -> type[Any]:
    """The class of an installed service type; raises TypeUnavailable with the package to install."""
    found: type[Any] | None = None
    with contextlib.suppress(ImportError):
        found = genpy.message.get_service_class(service_type)
    if found is None:
        raise _missing("service", service_type)
    return found


@lru_cache(maxsize=CACHED_TYPES)
def response_layout(service_class: Any) -> Layout:
    """How many elements responses of an installed service have; raises TypeUnavailable where nothing bounds them."""
    response: Any = service_class._response_class  # noqa: SLF001 - genpy's name for it
    return _layout(str(response._type), sanitized(str(response._full_text)))  # noqa: SLF001


def _missing(what: str, name: str) -> TypeUnavailable:
    package = name.split("/", 1)[0].replace("_", "-")
    return TypeUnavailable(f"the {what} type {name} is not installed; install python3-{package}")


def type_of_publisher(message_type: str, md5sum: str, definition: str) -> MessageType:
    """The type that reads a publisher's messages: the installed one when it is the same, else one made for it."""
    installed = installed_type(message_type)
    return installed if installed and installed.md5sum == md5sum else type_from_definition(message_type, definition)
