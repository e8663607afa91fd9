"""The application: its commands, and how an error ends it.

Data goes to stdout, messages to stderr. Exit codes: 0 done, 1 failed, 2 usage or configuration, 3 not found, 4
unreachable, 5 timeout, 130 interrupted.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Annotated, Final, NoReturn

import typer

from ua_fleet import __version__
from ua_fleet.cli import EXIT_INTERRUPTED
from ua_fleet.cli.command_group import add_command as _add
from ua_fleet.cli.command_group import command_group
from ua_fleet.cli.completion import prepare_completion
from ua_fleet.cli.endings import UsageProblems, exit_code_of, storage_error
from ua_fleet.cli.output import message
from ua_fleet.cli.plug_ins import ExtensibleGroup
from ua_fleet.errors import ConfigInvalid, JudgementsInvalid, ScenarioInvalid, UaFleetError

__all__ = ["app", "main"]

_HELP: Final = """A mixed fleet of robots as one OPC UA server, with UA bridges over OPC UA PubSub.

\b
A first fleet:
  ua-fleet config init fleet.yaml           write a commented file, then edit it
  ua-fleet config check fleet.yaml          find its mistakes
  ua-fleet config assign-ids fleet.yaml     give each data source its address
  ua-fleet user add anna --role operator    nobody gets in without a user
  ua-fleet up                               the OPC UA server and all bridges, for trying
  ua-fleet serve, ua-fleet bridge cell      each of them alone
  ua-fleet login --user anna                once, with the password
  ua-fleet browse                           look at it
"""

_GROUPS: Final = {
    "config": "The configuration file: write, check and show it, assign ids, add topics, its schema for editors.",
    "user": "Users of the server, and their roles.",
    "keys": "Key files of message security, for fleets without a key service.",
    "audit": "The server's audit log.",
    "state": "Backups of all that the processes of a fleet have stored.",
    "cert": "Certificates of server, bridges and clients, and the trust in them.",
    "scenario": "Scenarios and their runs.",
    "fault": "Faults of robots.",
    "decision": "Decisions: which robot takes over when a robot fails.",
    "robot": "The robots of a fleet: list, hold and release, register and unregister them.",
    "skill": "Skills of robots: list, call and offer them.",
    "modbus": "The fleet as a Modbus device, for PLCs.",
    "pubsub": "OPC UA PubSub between the server and the bridges.",
}
"""Groups whose commands stand in one module each."""


def _build() -> typer.Typer:
    whole = command_group(_HELP, cls=ExtensibleGroup)
    from ua_fleet.cli import (
        add_topics,
        audit,
        bridge,
        browse,
        cert,
        completion,
        config,
        console,
        decision,
        drive,
        healthcheck,
        history,
        keys,
        login,
        modbus,
        offer,
        pubsub,
        pubsub_decode,
        pubsub_probe,
        pubsub_record,
        pubsub_relay,
        pubsub_replay,
        read,
        robot,
        scenario,
        serve,
        show_config,
        skill,
        state,
        status,
        up,
        user,
        watch,
        write,
    )

    _add(whole, "serve", serve.serve, serve.EXAMPLES)
    _add(whole, "bridge", bridge.bridge, bridge.EXAMPLES)
    _add(whole, "up", up.up, up.EXAMPLES)
    _add(whole, "login", login.login, login.LOGIN_EXAMPLES)
    _add(whole, "logout", login.logout, login.LOGOUT_EXAMPLES)
    _add(whole, "contexts", login.contexts, login.CONTEXTS_EXAMPLES)
    _add(whole, "completion", completion.completion, completion.EXAMPLES)
    _add(whole, "status", status.status, status.EXAMPLES)
    _add(whole, "browse", browse.browse, browse.EXAMPLES)
    _add(whole, "read", read.read, read.EXAMPLES)
    _add(whole, "write", write.write, write.EXAMPLES)
    _add(whole, "watch", watch.watch, watch.EXAMPLES)
    _add(whole, "history", history.history, history.EXAMPLES)
    _add(whole, "drive", drive.drive, drive.EXAMPLES)
    _add(whole, "console", console.console, console.EXAMPLES)
    _add(whole, "healthcheck", healthcheck.healthcheck, healthcheck.EXAMPLES)
    groups = {name: command_group(help_text) for name, help_text in _GROUPS.items()}
    _add(groups["config"], "init", config.init, config.INIT_EXAMPLES)
    _add(groups["config"], "check", config.check, config.CHECK_EXAMPLES)
    _add(groups["config"], "assign-ids", config.assign, config.IDS_EXAMPLES)
    _add(groups["config"], "add-topics", add_topics.add_topics, add_topics.EXAMPLES)
    _add(groups["config"], "show", show_config.show, show_config.SHOW_EXAMPLES)
    _add(groups["config"], "schema", config.schema, config.SCHEMA_EXAMPLES)
    _add(groups["user"], "add", user.add, user.ADD_EXAMPLES)
    _add(groups["user"], "list", user.show, user.LIST_EXAMPLES)
    _add(groups["user"], "remove", user.remove, user.REMOVE_EXAMPLES)
    _add(groups["user"], "keys", user.keys, user.KEYS_EXAMPLES)
    _add(groups["user"], "logout", user.logout, user.LOGOUT_EXAMPLES)
    _add(groups["cert"], "create", cert.create, cert.CREATE_EXAMPLES)
    _add(groups["cert"], "trust", cert.trust_certificate, cert.TRUST_EXAMPLES)
    _add(groups["cert"], "revoke", cert.revoke_certificate, cert.REVOKE_EXAMPLES)
    _add(groups["cert"], "forget", cert.forget, cert.FORGET_EXAMPLES)
    _add(groups["cert"], "list", cert.show, cert.LIST_EXAMPLES)
    _add(groups["audit"], "verify", audit.verify, audit.VERIFY_EXAMPLES)
    _add(groups["state"], "backup", state.backup, state.BACKUP_EXAMPLES)
    _add(groups["state"], "check", state.check, state.CHECK_EXAMPLES)
    _add(groups["state"], "restore", state.restore, state.RESTORE_EXAMPLES)
    _add(groups["keys"], "create", keys.create, keys.CREATE_EXAMPLES)
    _add(groups["keys"], "rotate", keys.rotate, keys.ROTATE_EXAMPLES)
    _add(groups["keys"], "list", keys.show, keys.LIST_EXAMPLES)
    _add(groups["pubsub"], "listen", pubsub.listen, pubsub.EXAMPLES)
    _add(groups["pubsub"], "probe", pubsub_probe.probe, pubsub_probe.EXAMPLES)
    _add(groups["pubsub"], "decode", pubsub_decode.decode, pubsub_decode.EXAMPLES)
    _add(groups["pubsub"], "record", pubsub_record.record, pubsub_record.RECORD_EXAMPLES)
    _add(groups["pubsub"], "replay", pubsub_replay.replay, pubsub_replay.EXAMPLES)
    _add(groups["pubsub"], "relay", pubsub_relay.relay, pubsub_relay.EXAMPLES)
    _add(groups["pubsub"], "export", pubsub_record.export, pubsub_record.EXPORT_EXAMPLES)
    _add(groups["modbus"], "serve", modbus.serve, modbus.SERVE_EXAMPLES)
    _add(groups["modbus"], "map", modbus.show_map, modbus.MAP_EXAMPLES)
    _add(groups["scenario"], "list", scenario.show, scenario.LIST_EXAMPLES)
    _add(groups["scenario"], "validate", scenario.validate, scenario.VALIDATE_EXAMPLES)
    _add(groups["scenario"], "run", scenario.run, scenario.RUN_EXAMPLES)
    _add(groups["scenario"], "dryrun", scenario.dryrun, scenario.DRYRUN_EXAMPLES)
    _add(groups["scenario"], "tell", scenario.tell, scenario.TELL_EXAMPLES)
    _add(groups["scenario"], "watch", scenario.watch, scenario.WATCH_EXAMPLES)
    _add(groups["scenario"], "pause", scenario.pause, scenario.PAUSE_EXAMPLES)
    _add(groups["scenario"], "resume", scenario.resume, scenario.RESUME_EXAMPLES)
    _add(groups["scenario"], "abort", scenario.abort, scenario.ABORT_EXAMPLES)
    _add(groups["scenario"], "answer", scenario.answer, scenario.ANSWER_EXAMPLES)
    _add(groups["scenario"], "adopt", scenario.adopt, scenario.ADOPT_EXAMPLES)
    _add(groups["fault"], "list", decision.faults, decision.FAULT_EXAMPLES)
    _add(groups["fault"], "ack", decision.ack, decision.ACK_EXAMPLES)
    _add(groups["fault"], "raise", decision.raise_fault, decision.RAISE_EXAMPLES)
    _add(groups["fault"], "clear", decision.clear_fault, decision.CLEAR_EXAMPLES)
    _add(groups["decision"], "list", decision.show, decision.LIST_EXAMPLES)
    _add(groups["decision"], "confirm", decision.confirm, decision.CONFIRM_EXAMPLES)
    _add(groups["decision"], "mode", decision.set_mode, decision.MODE_EXAMPLES)
    _add(groups["decision"], "judge", decision.judge, decision.JUDGE_EXAMPLES)
    _add(groups["decision"], "whatif", decision.whatif, decision.WHATIF_EXAMPLES)
    _add(groups["skill"], "list", skill.show, skill.LIST_EXAMPLES)
    _add(groups["skill"], "call", skill.call, skill.CALL_EXAMPLES)
    _add(groups["skill"], "halt", skill.halt, skill.HALT_EXAMPLES)
    _add(groups["skill"], "suspend", skill.suspend, skill.SUSPEND_EXAMPLES)
    _add(groups["skill"], "resume", skill.resume, skill.RESUME_EXAMPLES)
    _add(groups["skill"], "offer", offer.offer, offer.OFFER_EXAMPLES)
    _add(groups["robot"], "list", robot.show, robot.LIST_EXAMPLES)
    _add(groups["robot"], "register", robot.register, robot.REGISTER_EXAMPLES)
    _add(groups["robot"], "unregister", robot.unregister, robot.UNREGISTER_EXAMPLES)
    _add(groups["robot"], "hold", robot.hold, robot.HOLD_EXAMPLES)
    _add(groups["robot"], "release", robot.release, robot.RELEASE_EXAMPLES)
    for name, group in groups.items():
        whole.add_typer(group, name=name)
    whole.callback()(_common)
    return whole


def _print_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"ua-fleet {__version__}\n")
        raise typer.Exit


def _common(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log more; the same as UA_FLEET_LOG=debug.")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    if verbose:
        os.environ["UA_FLEET_LOG"] = "debug"


app = _build()


def _end(code: int) -> NoReturn:
    """End with a code, also when nobody reads stdout any more."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def _tell(error: UaFleetError) -> None:
    """Print an error: one line, or one for each problem of a file."""
    if isinstance(error, ConfigInvalid | ScenarioInvalid | JudgementsInvalid | UsageProblems):
        for problem in error.problems:
            message(str(problem))
    else:
        message(f"ua-fleet: {error}")


def _interrupt(_number: int, _frame: object) -> NoReturn:
    raise KeyboardInterrupt


def main() -> NoReturn:
    """Run the command that the arguments name, and exit."""
    # Ended by a supervisor is ended in order, as with Ctrl-C.
    signal.signal(signal.SIGTERM, _interrupt)
    prepare_completion()
    try:
        app(prog_name="ua-fleet")
    except SystemExit as ending:
        _end(ending.code if isinstance(ending.code, int) else 0)
    except KeyboardInterrupt:
        _end(EXIT_INTERRUPTED)
    except UaFleetError as error:
        _tell(error)
        _end(exit_code_of(error))
    except OSError as error:
        if (told := storage_error(error)) is None:
            raise
        _tell(told)
        _end(exit_code_of(told))
    _end(0)
