"""Skills that a client calls in a server and that a bridge does, with JSON between the two: as over UDP."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.integration.mqtt.broker import Broker
from tests.integration.skills.conftest import Hall
from tests.integration.skills.test_methods import (
    test_a_skill_is_halted_where_the_robot_can_stop,
    test_a_skill_is_started_followed_and_brings_its_results,
    test_a_skill_is_suspended_goes_on_and_is_halted_while_its_robot_stands,
    test_an_immediate_skill_answers_with_its_results,
    test_what_the_robot_refuses_is_told,
)
from tests.system import Processes

__all__ = [
    "test_a_skill_is_halted_where_the_robot_can_stop",
    "test_a_skill_is_started_followed_and_brings_its_results",
    "test_a_skill_is_suspended_goes_on_and_is_halted_while_its_robot_stands",
    "test_an_immediate_skill_answers_with_its_results",
    "test_what_the_robot_refuses_is_told",
]

pytestmark = pytest.mark.needs("mosquitto")


@pytest.fixture
def hall(tmp_path: Path, broker: Broker, tcp_port: int, processes: Processes) -> Hall:
    """What these tests have over UDP, over JSON and mosquitto."""
    return Hall(tmp_path, broker.url, tcp_port, processes, security="broker", encoding="json", actions=True)
