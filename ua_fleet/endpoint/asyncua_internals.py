"""Start-up check: what we use of asyncua beyond its public interface is there, in exactly the version we know."""

from __future__ import annotations

import importlib
import importlib.metadata
import inspect
from collections.abc import Mapping
from typing import Final

from ua_fleet.errors import ServerStartError, add_extra

__all__ = ["ASYNCUA_VERSION", "check_internals"]

ASYNCUA_VERSION: Final = "2.1.0"

_USED: Final[Mapping[str, tuple[str, ...]]] = {
    "asyncua.common.connection": (
        "SecureConnection._check_incoming_chunk(chunk)",
        "SecureConnection._check_sym_header(security_hdr)",
        "SecureConnection._drop_incoming_parts()",
        "SecureConnection._receive(msg)",
        "SecureConnection.receive_from_header_and_body(header, body)",
        "SecureConnection.message_to_binary(message, message_type, request_id)",
        "SecureConnection.open(params, server)",
        "SecureConnection.revolve_tokens()",
        "SecureConnection.select_policy(uri, peer_certificate, mode)",
        "SecureConnection.set_policy_factories(policies)",
        "TransportLimits(max_recv_buffer, max_send_buffer, max_chunk_count, max_message_size)",
    ),
    "asyncua.common.utils": ("Buffer(data, start_pos, size)", "ServiceError(code)"),
    "asyncua.crypto.security_policies": (
        "Cryptography(mode)",
        "CryptographyNone()",
        "DecryptorAesCbc(key, init_vec)",
        "EncryptorAesCbc(key, init_vec)",
        "SecurityPolicyFactory(cls, mode, certificate, private_key, permission_ruleset, certificate_chain)",
        "SecurityPolicyFactory.create(peer_certificate)",
        "SignerHMac256(key)",
        "VerifierHMac256(key)",
    ),
    "asyncua.server.address_space": (
        "AddressSpace.add_datachange_callback(nodeid, attr, callback)",
        "AddressSpace.delete_datachange_callback(handle)",
        "AddressSpace.read_attribute_value(nodeid, attr)",
        "AddressSpace.write_attribute_value(nodeid, attr, value)",
        "AddressSpace.get(nodeid)",
        "AttributeValue(value)",
        "NodeData(nodeid)",
    ),
    "asyncua.server.internal_server": (
        "InternalServer.get_endpoints(params, sockname)",
        "InternalServer.get_new_channel_id()",
        "InternalServer.find_servers(params, sockname)",
        "InternalServer.stop()",
    ),
    "asyncua.server.monitored_item_service": ("WhereClauseEvaluator._eval_el(index, event)",),
    "asyncua.server.server": ("Server._setup_server_nodes()", "Server._set_endpoints(policy, mode, level)"),
    "asyncua.server.subscription_service": (
        "SubscriptionService(aspace, iserver)",
        "SubscriptionService.trigger_event(event, subscription_id)",
        "SubscriptionService.condition_refresh(parent, subscription_id, mid)",
    ),
    "asyncua.ua.ua_binary": (
        "create_list_serializer(uatype)",
        "create_type_serializer(uatype)",
        "extensionobject_to_binary(obj)",
        "from_binary(uatype, data)",
        "get_safe_type_hints(cls, extra_ns)",
        "header_from_binary(data)",
        "nodeid_from_binary(data)",
        "nodeid_to_binary(nodeid)",
        "resolve_uatype(ftype)",
        "struct_to_binary(obj)",
        "uatcp_to_binary(message_type, message)",
        "variant_to_binary(var)",
    ),
    "asyncua.ua.uatypes": (
        "type_allow_subclass(uatype)",
        "type_from_list(uatype)",
        "type_from_optional(uatype)",
        "type_is_list(uatype)",
        "type_is_optional(uatype)",
        "type_is_union(uatype)",
        "types_or_list_from_union(uatype)",
    ),
}
"""Module to the functions and classes that we hook or call, each with its parameters."""


def check_internals(used: Mapping[str, tuple[str, ...]] = _USED, version: str = ASYNCUA_VERSION) -> None:
    """Raise ServerStartError in one line when asyncua is not the one that this server was written for."""
    remedy = f"run: pip install 'asyncua=={version}'"
    try:
        found = importlib.metadata.version("asyncua")
    except importlib.metadata.PackageNotFoundError as error:
        raise ServerStartError(f"asyncua is not installed; {add_extra('server')}") from error
    if found != version:
        raise ServerStartError(f"asyncua {found} is installed, the server hooks {version} and no other; {remedy}")
    for module_name, signatures in used.items():
        module = importlib.import_module(module_name)
        for signature in signatures:
            if (problem := _problem(module, signature)) is not None:
                raise ServerStartError(f"asyncua {found}: {module_name}.{signature} {problem}; {remedy}")


def _problem(module: object, signature: str) -> str | None:
    path, _, rest = signature.partition("(")
    target: object = module
    for part in path.split("."):
        target = getattr(target, part, None)
        if target is None:
            return "does not exist"
    expected = [name for name in rest.rstrip(")").split(", ") if name]
    if not callable(target):
        return "cannot be called"
    parameters = [name for name in inspect.signature(target).parameters if name != "self"]
    return None if parameters[: len(expected)] == expected else f"has the parameters {', '.join(parameters)}"
