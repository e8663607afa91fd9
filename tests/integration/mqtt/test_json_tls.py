"""A fleet over JSON, whose only protection is TLS and who may log in at the broker: by certificate, or by password."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.integration.mqtt.broker import Broker, mosquitto
from tests.integration.mqtt.certificates import authority, certificate
from tests.integration.mqtt.speaking import Speaking
from tests.integration.security.conftest import COUNTER_ONE, ONE, Site, heard
from tests.integration.server_model.harness import OBSERVER, reader, serving
from tests.integration.server_model.harness import until as until_read
from tests.system import Processes
from tests.waiting import until
from ua_fleet.transport.mqtt.credentials import Credentials

pytestmark = pytest.mark.needs("mosquitto")

NODE = f"ns=2;i={COUNTER_ONE.id}"
RIGHTS = f"""\
user fleet
topic readwrite #
user guest
topic read {COUNTER_ONE.name}
"""


class Guarded(NamedTuple):
    """A broker with TLS, how the fleet logs in there, and how others do."""

    broker: Broker
    fleet: dict[str, str]
    """For `pubsub.broker`."""
    guest: list[str]
    """Of mosquitto_sub, for somebody who may read one topic."""
    stranger: dict[str, str]
    """For `pubsub.broker`, of somebody whom the broker does not know."""

    @property
    def url(self) -> str:
        return self.broker.url.replace("mqtt://", "mqtts://")


def by_certificate(folder: Path) -> Guarded:
    """The name in a certificate of the authority is the user."""
    authority(folder, "other")
    for name, by in (("fleet", "ca"), ("guest", "ca"), ("stranger", "other")):
        certificate(folder, name, by)
    broker = broker_of(folder, "require_certificate true", "use_identity_as_username true")

    def files(name: str) -> dict[str, str]:
        return {"certificate_file": f"{name}.pem", "key_file": f"{name}.key"}

    guest = ["--cert", str(folder / "guest.pem"), "--key", str(folder / "guest.key")]
    return Guarded(broker, files("fleet"), guest, files("stranger"))


def by_password(folder: Path) -> Guarded:
    """Users and passwords of the broker's file."""
    users = folder / "users"
    users.touch()
    for name in ("fleet", "guest"):
        subprocess.run(["mosquitto_passwd", "-b", str(users), name, f"secret-{name}"], check=True)
        (folder / name).write_text(f"secret-{name}\n")
        (folder / name).chmod(0o600)
    (folder / "wrong").write_text("secret-guest\n")
    (folder / "wrong").chmod(0o600)
    broker = broker_of(folder, f"password_file {users}")
    fleet = {"user": "fleet", "password_file": "fleet"}
    return Guarded(broker, fleet, ["-u", "guest", "-P", "secret-guest"], fleet | {"password_file": "wrong"})


def broker_of(folder: Path, *login: str) -> Broker:
    certificate(folder, "broker", "ca")
    (folder / "rights").write_text(RIGHTS)
    files = [f"cafile {folder}/ca.pem", f"certfile {folder}/broker.pem", f"keyfile {folder}/broker.key"]
    return mosquitto(folder / "broker", *files, *login, "allow_anonymous false", f"acl_file {folder}/rights")


@pytest.fixture(params=[by_certificate, by_password])
def guarded(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Guarded]:
    authority(tmp_path, "ca")
    made: Guarded = request.param(tmp_path)
    made.broker.start()
    yield made
    made.broker.end()


async def test_values_go_over_json_with_tls_and_to_nobody_whom_the_broker_does_not_know(
    guarded: Guarded, tmp_path: Path, processes: Processes
) -> None:
    site = Site(tmp_path, guarded.url, processes)
    site.write_fleet(security="broker", encoding="json", broker={"ca_file": "ca.pem", **guarded.fleet})
    reading = ["-h", "127.0.0.1", "-p", str(guarded.broker.port), "--cafile", str(tmp_path / "ca.pem"), "-F", "%t %p"]
    guest = processes.start("mosquitto_sub", *reading, *guarded.guest, "-t", "#", whole=True)
    one, two = site.bridge("one"), site.bridge("two")
    async with serving(site.folder, site.config) as running, running.client(OBSERVER) as client:
        first = await until_read(reader(client, NODE), lambda data: data.StatusCode.is_good())
        await until_read(reader(client, NODE), lambda data: data.Value.Value > first.Value.Value)
    await until(lambda: heard(two, COUNTER_ONE))
    assert one.end() == two.end() == 0
    await until(lambda: guest.lines)
    topics = {line.partition(" ")[0] for line in guest.lines}
    assert topics == {COUNTER_ONE.name}, "the broker's rights hold"
    message: Any = json.loads(guest.lines[-1].partition(" ")[2])
    assert (message["MessageType"], message["PublisherId"]) == ("ua-data", str(ONE))
    anybody = subprocess.run(["mosquitto_sub", *reading, "-t", "#", "-W", "20"], capture_output=True, check=False)
    assert anybody.returncode not in (0, 27), "27 is that it has waited, so it was let in"
    plain = subprocess.run(["mosquitto_sub", *reading[:4], "-t", "#", "-W", "20"], capture_output=True, check=False)
    assert plain.returncode not in (0, 27)


async def test_a_certificate_or_password_that_the_broker_does_not_take_is_told(
    guarded: Guarded, tmp_path: Path
) -> None:
    files: Any = {"ca_file": "ca.pem", **guarded.stranger}
    stranger = Speaking(guarded.url, 9, Credentials.read(tmp_path, has_tls=True, **files))
    await stranger.start(wait=False)
    try:
        await until(lambda: "not connected yet" not in stranger.transport.stats.problem)
        problem = stranger.transport.stats.problem
        if "user" in guarded.stranger:
            assert "the broker refuses this user or certificate" in problem
        assert stranger.transport.stats.sent == 0
        assert "Connection Refused: not authorised" in guarded.broker.log or "certificate" in guarded.broker.log
    finally:
        await stranger.transport.close()
