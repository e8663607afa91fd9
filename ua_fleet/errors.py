"""The error tree. Every error carries the OPC UA StatusCode that a client gets for it.

    UaFleetError(ua_status)
      ConfigError(file, line, key, suggestion)   one problem of a configuration file
      ConfigInvalid(problems)                    all problems of a file, reported together
      TopicInvalid(text)                         a name that is no `ua_<space>_<ns>_<id>`
      WireError
        LocalWireError                           we tried to send something that cannot be encoded: our bug
          MessageTooLarge                        a robot, or a file, says more than one message may have
        RemoteWireError(cause)                   a peer sent bytes that break the rules: count, drop, go on
      TransportError
        NotConnected
        SendTimeout
      SkillError
        SkillRejected | SkillTimeout | SkillFailed | RobotOffline
          RobotBusy                              a SkillRejected: what is refused now may be taken later
          NotAnnounced                           a RobotOffline: its Action is asked for, and may come soon
      ScenarioError
        ScenarioInvalid(problems) | NoCandidate | JudgementsInvalid(problems)
      BridgeUnavailable(extra)                   a package or service that a bridge needs is missing
      FieldMissing                               messages have no field of a name that fleet.yaml gives their DataSet
      DriverFailed                               a mistake of our own ended a bridge's driver: start the bridge again
      ServerStartError                           the server cannot or must not start
      StorageUnavailable                         what must be recorded cannot be: it is then not done either
      KeySourceUnavailable                       nobody can be asked for keys now: go on with those there are
      KeysRefused(group_id)                      the source answers, but has no keys of this group for us
      AccessRefused(ua_status)                   a client may not do this, or not with this value
      LeaseRefused(ua_status)                    a robot is not given out to be driven by hand, or the lease is over

An error's text is one line: what is wrong, where, and what to do about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ua_fleet.values import StatusCode

__all__ = [
    "UPGRADE",
    "AccessRefused",
    "BridgeUnavailable",
    "ConfigError",
    "ConfigInvalid",
    "DriverFailed",
    "FieldMissing",
    "JudgementsInvalid",
    "KeySourceUnavailable",
    "KeysRefused",
    "LeaseRefused",
    "LocalWireError",
    "MessageTooLarge",
    "NoCandidate",
    "NotAnnounced",
    "NotConnected",
    "RemoteWireError",
    "RobotBusy",
    "RobotOffline",
    "ScenarioError",
    "ScenarioInvalid",
    "SendTimeout",
    "ServerStartError",
    "SkillError",
    "SkillFailed",
    "SkillRejected",
    "SkillTimeout",
    "StorageAway",
    "StorageUnavailable",
    "TopicInvalid",
    "TransportError",
    "UaFleetError",
    "WireError",
    "add_extra",
    "newer_version",
]

UPGRADE: Final = "upgrade ua-fleet (docs/install.md)"
"""What to do about a file of a newer version."""


def add_extra(extra: str) -> str:
    """What to do where a package is missing that this extra brings."""
    return f"install ua-fleet with its extra {extra} (docs/install.md)"


def newer_version(found: object, known: int) -> str:
    """What is wrong with a file of version `found`; the empty text unless a newer program than this one wrote it.

    What a newer program has written is refused whole: half understood, it would be misread, or written over.
    """
    if isinstance(found, bool) or not isinstance(found, int) or found <= known:
        return ""
    return f"has version {found}, and this ua-fleet reads version {known}"


class UaFleetError(Exception):
    """Base of every error that this project raises on purpose."""

    ua_status: int = StatusCode.BAD_INTERNAL_ERROR
    remedy: str = ""
    """What helps where the text does not say it; docs/troubleshooting.md is made from it."""


class ConfigError(UaFleetError):
    """One problem in a configuration file, with the place and, where there is one, the remedy."""

    ua_status = StatusCode.BAD_CONFIGURATION_ERROR
    remedy = "Correct the file at the line that the message names, then run `ua-fleet config check FILE`."

    def __init__(self, message: str, *, file: str = "", line: int = 0, key: str = "", suggestion: str = "") -> None:
        self.message, self.file, self.line, self.key, self.suggestion = message, file, line, key, suggestion
        place = ":".join(str(part) for part in (file, line or "", key) if part)
        text = f"{place}: {message}" if place else message
        super().__init__(f"{text}; {suggestion}" if suggestion else text)


class ConfigInvalid(UaFleetError):
    """A configuration file with one or more problems, in the order of their lines."""

    ua_status = StatusCode.BAD_CONFIGURATION_ERROR
    remedy = "Correct each line that is named; `ua-fleet config check FILE` tells all problems at once."

    def __init__(self, problems: Sequence[ConfigError]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class TopicInvalid(UaFleetError):
    """A name or triple that is no UA topic. `text` is the offender."""

    ua_status = StatusCode.BAD_NODE_ID_INVALID
    remedy = "Write `ua_<space>_<ns>_<id>` with decimal numbers (docs/topics.md)."

    def __init__(self, text: str, reason: str) -> None:
        self.text, self.reason = text, reason
        super().__init__(f"{text!r} is not a UA topic: {reason}")


class WireError(UaFleetError):
    """A message that breaks the rules of OPC 10000-14 or OPC 10000-6."""


class LocalWireError(WireError):
    """We were asked to encode what cannot be encoded: a mistake on our side."""

    ua_status = StatusCode.BAD_ENCODING_ERROR
    remedy = "Report it: a program of ours built a message that cannot be encoded."


class MessageTooLarge(LocalWireError):
    """More than one message may have; nothing of it is sent."""

    ua_status = StatusCode.BAD_ENCODING_LIMITS_EXCEEDED
    remedy = "Send less in one message, or raise `pubsub.max_message_bytes` in fleet.yaml."


class RemoteWireError(WireError):
    """A peer's bytes cannot be decoded. `cause` is the counter that the drop goes to."""

    ua_status = StatusCode.BAD_DECODING_ERROR
    remedy = "Find the sender with `ua-fleet pubsub probe`, and open its message with `ua-fleet pubsub decode`."

    def __init__(self, cause: str, detail: str = "", offset: int = -1) -> None:
        self.cause, self.detail, self.offset = cause, detail, offset
        where = f" at byte {offset}" if offset >= 0 else ""
        super().__init__(f"{cause}{where}: {detail}" if detail else f"{cause}{where}")


class TransportError(UaFleetError):
    """The network side failed: no route, no permission, no such interface."""

    ua_status = StatusCode.BAD_COMMUNICATION_ERROR
    remedy = "Check `pubsub.url`, the interface and the rights of the process."


class NotConnected(TransportError):
    """There is no connection to send on."""

    ua_status = StatusCode.BAD_NOT_CONNECTED
    remedy = "Start the other side, or wait: connections are made again by themselves."


class SendTimeout(TransportError):
    """The peer or the kernel did not take the message in time."""

    ua_status = StatusCode.BAD_TIMEOUT
    remedy = "Check the network and the load of the machine; values are sent again, commands are told as failed."


class SkillError(UaFleetError):
    """A skill did not do what was asked."""

    remedy = "See `ua-fleet skill list ROBOT` and the log of the robot's bridge."


class FieldMissing(UaFleetError):
    """A DataSet's messages have no field of a name that `fleet.yaml` gives it."""

    ua_status = StatusCode.BAD_CONFIGURATION_ERROR
    remedy = "Give the field in fleet.yaml the name that the messages have, by `path` (docs/fleet-yaml.md)."


class SkillRejected(SkillError):
    """The robot refused to start the skill."""

    ua_status: int = StatusCode.BAD_REQUEST_NOT_ALLOWED
    remedy = "Correct the arguments, or do what the message says; nothing was begun."
    argument: str = ""
    """The argument that is wrong, where it is one."""


class RobotBusy(SkillRejected):
    """The robot is at something else: what it does not take now it may take later."""

    ua_status: int = StatusCode.BAD_TOO_MANY_OPERATIONS
    remedy = "Wait until the robot has ended what it does, or halt that, and call again."


class SkillTimeout(SkillError):
    """The skill did not end in time."""

    ua_status = StatusCode.BAD_TIMEOUT
    remedy = "See what the robot does, and raise `timeout_s` of the skill if that takes longer."


class SkillFailed(SkillError):
    """The robot started the skill and reported that it failed."""

    ua_status: int = StatusCode.BAD_UNEXPECTED_ERROR
    remedy = "Read the robot's own message, remove its cause, and start the skill again."


class RobotOffline(SkillError):
    """The robot cannot be reached."""

    ua_status = StatusCode.BAD_NO_COMMUNICATION
    remedy = "See with `ua-fleet status` whether the bridge runs and hears its robot."


class NotAnnounced(RobotOffline):
    """No bridge has announced the Action; it is asked for, so that a later call may find it."""


class ScenarioError(UaFleetError):
    """A scenario cannot be loaded or cannot go on."""

    remedy = "See `ua-fleet scenario list`, which has the runs too."


class ScenarioInvalid(ScenarioError):
    """A scenario with one or more problems."""

    ua_status = StatusCode.BAD_INVALID_ARGUMENT
    remedy = "Correct the lines that are named; `ua-fleet scenario validate FILE` tells all problems at once."

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("; ".join(self.problems))


class NoCandidate(ScenarioError):
    """No robot of the fleet can take the task over."""

    ua_status = StatusCode.BAD_RESOURCE_UNAVAILABLE
    remedy = "Bring a robot with the needed capacities back, or end the run."


class JudgementsInvalid(ScenarioError):
    """Pairwise comparisons that no weights can be made of."""

    ua_status = StatusCode.BAD_INVALID_ARGUMENT
    remedy = "Correct the comparisons that are named; docs/resilience.md tells what makes a ranking."

    def __init__(self, problems: Sequence[str], *, consistency_ratio: float | None = None) -> None:
        self.problems, self.consistency_ratio = tuple(problems), consistency_ratio
        super().__init__("; ".join(self.problems))


class BridgeUnavailable(UaFleetError):
    """A bridge cannot run here; `extra` names what has to be installed."""

    ua_status = StatusCode.BAD_NOT_SUPPORTED
    remedy = "Install what is missing on the machine of the bridge (docs/install.md)."

    def __init__(self, message: str, *, extra: str = "") -> None:
        self.extra = extra
        super().__init__(f"{message}; {add_extra(extra)}" if extra else message)


class DriverFailed(UaFleetError):
    """A mistake of our own ended a bridge's driver; what the log says of it is worth a report."""

    remedy = "Start the bridge again, and report what its log says."


class ServerStartError(UaFleetError):
    """The server cannot start, or must not start with this configuration."""

    remedy = "Correct what the message names, and start the server again."


class StorageUnavailable(UaFleetError):
    """A file that a process must record something in is locked, broken, or its disk is full."""

    ua_status = StatusCode.BAD_RESOURCE_UNAVAILABLE
    remedy = "Give the process a `state_dir` of its own on a disk with room, readable and writable by it alone."


class StorageAway(StorageUnavailable):
    """A database on the network is not there now; it is worth trying again."""

    remedy = "See whether the database runs and can be reached; the process tries again by itself."


class KeySourceUnavailable(UaFleetError):
    """The source of keys cannot be asked now; it is worth asking again."""

    ua_status = StatusCode.BAD_COMMUNICATION_ERROR
    remedy = "Start the server that gives the keys; the process asks again by itself, with the keys it has."


class KeysRefused(UaFleetError):
    """The source of keys answers, and gives us none of this SecurityGroup: it has none, or we may not have them."""

    ua_status = StatusCode.BAD_SECURITY_CHECKS_FAILED
    remedy = "See `ua-fleet cert list`: the certificate must be trusted for that bridge (docs/security.md)."

    def __init__(self, group_id: str, reason: str) -> None:
        self.group_id, self.reason = group_id, reason
        super().__init__(f"no keys of {group_id}: {reason}")


class AccessRefused(UaFleetError):
    """A client may not do this; `ua_status` says why in the protocol's words."""

    remedy = "Log in as a user who may do it; `ua-fleet user list` shows the roles."

    def __init__(self, ua_status: int, reason: str) -> None:
        self.ua_status = ua_status
        super().__init__(reason)


class LeaseRefused(UaFleetError):
    """A robot is not given out to be driven by hand, or what was asked for needs a lease that is over."""

    remedy = "Wait until the robot is free, and see who drives it on its page or with `ua-fleet status`."

    def __init__(self, ua_status: int, reason: str) -> None:
        self.ua_status = ua_status
        super().__init__(reason)
