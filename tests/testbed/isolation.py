"""That a robot reaches the server through its bridge alone, and that containers have nothing that they do not need.

Each attempt is made from a bridge, too, where it has to succeed: else a failure would prove nothing.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any, Final

from tests.testbed.bed import Bed
from tests.testbed.broker import broker_problems
from tests.testbed.engine import CommandFailed, Container, docker

__all__ = ["check_hardening", "check_isolation", "check_yard"]

ROBOTS: Final = {
    "ridgeback": "ridgeback-bridge",
    "rosmaster": "ridgeback-bridge",
    "pioneer-1": "pioneer-1-bridge",
    "ur3": "ur3-bridge",
    "conveyor": "conveyor-bridge",
    "drone": "drone-bridge",
}
"""Robots and machines, with the bridge of each."""
_GROUP: Final = "224.0.2.14"
_OPC_UA: Final = 4840
_MONITORING: Final = 9464
_CONSOLE: Final = 8080
_BROKER: Final = 8883

# Tries all ways that are given as JSON at once, and prints those that were open. What it says to the group is no
# message: the server counts it as malformed where it gets there.
_TRY: Final = """
import concurrent.futures, json, os, socket, struct, sys
asked = json.loads(sys.argv[1])
group = (asked["group"], 4840)

def connect(place):
    host, port = place
    try:
        with socket.create_connection((host, port), 2) as link:
            if port in (9464, 8080, 8883):
                return f"TCP {host}:{port}"
            url = b"opc.tcp://server:4840/"
            body = struct.pack("<IIIIII", 0, 65535, 65535, 0, 0, len(url)) + url
            link.sendall(b"HELF" + struct.pack("<I", 8 + len(body)) + body)
            return f"OPC UA at {host}:{port}" if link.recv(3) == b"ACK" else None
    except OSError:
        return None

def look_up(name):
    try:
        return f"the name {name} ({socket.gethostbyname(name)})"
    except OSError:
        return None

def listen(_):
    ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ear.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    ear.bind(group)
    for index, _ in socket.if_nameindex():
        joined = struct.pack("4s4si", socket.inet_aton(group[0]), b"\\0" * 4, index)
        try:
            ear.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)
            ear.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, joined)
            ear.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 0)
            for _ in range(5):
                ear.sendto(b"\\xffno message", group)
        except OSError:
            pass
    for host in asked["udp"]:
        try:
            ear.sendto(b"\\xffno message", (host, 4840))
        except OSError:
            pass
    ear.settimeout(3)
    try:
        while (heard := ear.recvfrom(65535))[0] == b"\\xffno message":
            pass  # our own, or that of another try
        return "PubSub of " + heard[1][0]
    except OSError:
        return None

pool = concurrent.futures.ThreadPoolExecutor(100)
tries = [pool.submit(connect, place) for place in asked["tcp"]]
tries += [pool.submit(look_up, name) for name in asked["names"]]
tries.append(pool.submit(listen, None))
ended, _ = concurrent.futures.wait(tries, timeout=8)
print(json.dumps([way for one in ended if (way := one.result())]), flush=True)
os._exit(0)  # a name that nobody knows takes a resolver half a minute
"""
_METRICS: Final = """
import urllib.request
print(urllib.request.urlopen("http://127.0.0.1:9464/metrics", timeout=5).read().decode())
"""
_MALFORMED: Final = re.compile(r"^ua_fleet_malformed_total\{.*\} (\S+)", re.MULTILINE)
_WRITE: Final = """
import os, sys
for folder in ("/", "/opt/ua-fleet", "/usr/local/bin", "/etc", "/var/lib/ua-fleet"):
    try:
        with open(os.path.join(folder, ".written"), "w"):
            print(folder)
        os.unlink(os.path.join(folder, ".written"))
    except OSError:
        pass
"""
_SECRET: Final = re.compile(r"(?i)(password|secret|token|_key|BEGIN [A-Z ]*PRIVATE KEY)")
# Private keys and password files in an image, outside of what Debian brings.
_LOOK: Final = """
import os
for folder in ("/opt", "/var/lib/ua-fleet", "/tmp", "/root", "/home", "/src", "/etc/ua-fleet"):
    for place, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(place, name)
            if name in ("password", "users.json", "fleet.yaml") or name.endswith((".key", "-key.pem", ".der")):
                print(path)
"""


def _ways(bed: Bed, containers: Mapping[str, Container], robot: Container) -> dict[str, Any]:
    """By which ways a robot may try: addresses of others in its own space, gateways, names."""
    network = bed.options["UA_FLEET_NET"]
    own = [joined["IPAddress"] for joined in robot.inspect()["NetworkSettings"]["Networks"].values()]
    bridges = [
        joined["IPAddress"]
        for service in {*ROBOTS.values(), "plc-gateway", "console", "temperature-sensor-bridge"}
        for joined in containers[service].inspect()["NetworkSettings"]["Networks"].values()
    ]
    gateways = [f"{network}.{last}" for last in (1, 65, 129, 193)]
    hosts = [f"{network}.2", "server", *sorted({*bridges, *gateways} - set(own))]
    tcp = [(host, port) for host in hosts for port in (_OPC_UA, _MONITORING, _CONSOLE)]
    tcp += [(host, bed.port) for host in gateways]
    return {"tcp": tcp, "udp": hosts, "names": ["server", "console", "tasks"], "group": _GROUP}


def check_isolation(bed: Bed, containers: Mapping[str, Container]) -> list[str]:
    """Which robot reaches the server in another way than its bridge, and which bridge does not reach it."""
    found: list[str] = []
    server = containers["server"]
    known = {"tcp": [("server", _OPC_UA)], "udp": [], "names": ["server"], "group": _GROUP}
    for name, bridge in ROBOTS.items():
        before = _malformed(server)
        found += [f"{name} reaches {way}" for way in _try(containers[name], _ways(bed, containers, containers[name]))]
        between = _malformed(server)
        reached = _try(containers[bridge], known)
        after = _malformed(server)
        if between != before:
            found.append(f"{name} sends datagrams to the server")
        open_ways = {
            "the server by TCP": "OPC UA at server:4840" in reached,
            "its name": any(way.startswith("the name server") for way in reached),
            "its messages": any(way.startswith("PubSub") for way in reached),
            "its group": after > between,
        }
        lacks = [way for way, is_open in open_ways.items() if not is_open]
        if lacks:
            found.append(f"{bridge} does not reach {', '.join(lacks)}: what robots do not reach proves nothing")
    return found


def check_yard(bed: Bed, containers: Mapping[str, Container]) -> list[str]:
    """Which way leads from the yard to the server but the broker, and which does not lead there that has to."""
    found: list[str] = []
    network, server = bed.options["UA_FLEET_NET"], containers["server-brokered"]
    in_the_hall = [f"{network}.{last}" for last in (4, 22, 35, 36)]
    gateways = [f"{network}.{last}" for last in (1, 193, 225, 241)]
    tcp = [(host, port) for host in ("server", *in_the_hall, *gateways) for port in (_OPC_UA, _MONITORING, _CONSOLE)]
    tcp += [(host, bed.port) for host in gateways]
    names = ["server", "server-brokered", "hall-side", "console-brokered", "flights"]
    ways = {"tcp": tcp, "udp": [*in_the_hall, *gateways], "names": names, "group": _GROUP}
    before = _malformed(server)
    at_the_broker = {"tcp": [("broker", _BROKER), (f"{network}.5", _BROKER), (f"{network}.226", _BROKER)]}
    found += [f"yard-side reaches {way}" for way in _try(containers["yard-side"], ways)]
    found += [
        f"quadcopter reaches {way}"
        for way in _try(containers["quadcopter"], {**ways, "tcp": [*tcp, *at_the_broker["tcp"]]})
    ]
    if _malformed(server) != before:
        found.append("the yard sends datagrams to the server")
    known = {"tcp": [("server", _OPC_UA)], "udp": [], "names": ["server"], "group": _GROUP}
    if len(reached := _try(containers["hall-side"], known)) != 3:  # its port, its name, and its messages
        found.append(f"hall-side reaches {reached} alone: what the yard does not reach proves nothing")
    reached = _try(containers["yard-side"], {**ways, "tcp": at_the_broker["tcp"], "udp": [], "names": ["broker"]})
    if f"TCP broker:{_BROKER}" not in reached:
        found.append("yard-side does not reach the broker")
    if f"TCP {network}.5:{_BROKER}" in reached:
        found.append("yard-side reaches the broker's address in the hall")
    return [*found, *broker_problems(containers)]


def _malformed(server: Container) -> float:
    return sum(float(count) for count in _MALFORMED.findall(server.python(_METRICS)))


def _try(container: Container, ways: Mapping[str, Any]) -> list[str]:
    read: list[str] = json.loads(container.python(_TRY, json.dumps(ways), timeout_s=60))
    return read


def check_hardening(containers: Mapping[str, Container]) -> list[str]:
    """What containers and images have that they do not need."""
    found: list[str] = []
    images: dict[str, str] = {}
    for name, container in sorted(containers.items()):
        known = container.inspect()
        host = known["HostConfig"]
        images[known["Image"]] = name
        if not known["State"]["Running"]:
            continue
        user = container.execute("id", "-u").strip()
        if user == "0":
            found.append(f"{name} runs as root")
        if not host["ReadonlyRootfs"]:
            found.append(f"{name} has a root file system that can be written")
        if written := container.python(_WRITE).split():
            found.append(f"{name} can write in {', '.join(written)}")
        capabilities = container.execute("sh", "-c", "grep CapEff /proc/1/status").split()[1]
        if int(capabilities, 16):
            found.append(f"{name} has capabilities: {capabilities}")
        if host["Privileged"] or host["NetworkMode"] == "host" or "docker.sock" in str(host["Binds"]):
            found.append(f"{name} is privileged, in the host's network, or has the engine's socket")
        if len(known["NetworkSettings"]["Networks"]) > 1:
            forwards = container.execute("cat", "/proc/sys/net/ipv4/ip_forward").strip()
            if forwards != "0":
                found.append(f"{name} stands in two networks, and would forward packets between them")
        variables = [line.partition("=")[0] for line in known["Config"]["Env"] if _SECRET.search(line)]
        found += [f"{name} has a secret in its environment: {variable}" for variable in variables]
    for image, name in images.items():
        found += _image_problems(image, name)
    return found


def _image_problems(image: str, name: str) -> list[str]:
    found: list[str] = []
    history = docker("history", "--no-trunc", "--format", "{{.CreatedBy}}", image)
    if "BEGIN CERTIFICATE" in history or "PRIVATE KEY" in history:
        found.append(f"the image of {name} tells a build argument in its history")
    run = ("run", "--rm", "--network", "none", "--entrypoint", "python3", image)
    if files := docker(*run, "-c", _LOOK).split():
        found.append(f"the image of {name} holds {', '.join(files[:3])}")
    for tool in ("gcc", "cc", "pip", "pip3"):
        try:
            docker(*run, "-c", f"import shutil, sys; sys.exit(shutil.which({tool!r}) is not None)")
        except CommandFailed:
            found.append(f"the image of {name} has {tool}")
    return found
