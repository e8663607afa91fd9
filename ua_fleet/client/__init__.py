"""A typed OPC UA client: connect, browse, read, write and watch nodes by NodeId, UA topic or path.

async with FleetClient.connect("opc.tcp://127.0.0.1:4840/ua_fleet", user="anna", password=...) as client:
async for change in client.watch(["ua_1_2_1001"]):
print(change.value, change.status_text)
"""

from ua_fleet.client.all_events import EventInfo
from ua_fleet.client.attributes import NodeAttribute
from ua_fleet.client.browsing import NodeInfo
from ua_fleet.client.cards import CardNode, card_nodes
from ua_fleet.client.charges import ChargeNode, charge_nodes
from ua_fleet.client.condition_methods import ConditionClient
from ua_fleet.client.conditions import ConditionInfo, ConditionsKnown, DeclaredAlarm
from ua_fleet.client.details import ValueDetails
from ua_fleet.client.events import (
    DecisionTold,
    FaultTold,
    RankedRobot,
    RankingInfo,
    RunTold,
    StepTold,
    Told,
    ranking_of,
)
from ua_fleet.client.finding import SelectedNode
from ua_fleet.client.fleet_client import POLICIES, AnotherServer, Change, FleetClient, Reading
from ua_fleet.client.identity import ClientIdentity, default_identity_folder
from ua_fleet.client.methods import NotDone
from ua_fleet.client.model_changes import ModelChanges
from ua_fleet.client.offers import OfferedSkill, SkillRequest
from ua_fleet.client.positions import PositionNodes, known_places, position_nodes, yaw_of
from ua_fleet.client.recent_messages import MessagesHeard, PubSubMessage, recent_messages
from ua_fleet.client.robot_nodes import ArgumentNode, DataNode, RobotNodes, SkillNodes, robot_nodes
from ua_fleet.client.robots import RobotClient, RobotInfo, RobotInvalid
from ua_fleet.client.scenarios import (
    DecisionInfo,
    DryRunInfo,
    FaultInfo,
    Forecast,
    JudgementsContradict,
    Problem,
    RunInfo,
    ScenarioClient,
    ScenarioInfo,
    ScenarioRefused,
    WouldHappen,
)
from ua_fleet.client.session_keys import IssuedKey, issue_session_key, revoke_session_key
from ua_fleet.client.skills import SkillArgument, SkillEvent, SkillExecution, SkillInfo
from ua_fleet.client.status import (
    BridgeNodes,
    BridgeStatus,
    FaultStatus,
    FleetStatus,
    NamespaceStatus,
    OpenDecision,
    RobotStatus,
    RunStatus,
    ServerStatus,
    bridge_nodes,
    fleet_status,
    server_status,
)
from ua_fleet.client.summaries import RobotSummary, SummariesChanged
from ua_fleet.client.teleoperation import (
    AxisInfo,
    DrivingLease,
    TeleoperationInfo,
    TeleoperationStatus,
    driving,
    teleoperation_info,
    watch_teleoperation,
)
from ua_fleet.client.translated import NodeNotFound
from ua_fleet.client.trends import Trend

__all__ = [
    "POLICIES",
    "AnotherServer",
    "ArgumentNode",
    "AxisInfo",
    "BridgeNodes",
    "BridgeStatus",
    "CardNode",
    "Change",
    "ChargeNode",
    "ClientIdentity",
    "ConditionClient",
    "ConditionInfo",
    "ConditionsKnown",
    "DataNode",
    "DecisionInfo",
    "DecisionTold",
    "DeclaredAlarm",
    "DrivingLease",
    "DryRunInfo",
    "EventInfo",
    "FaultInfo",
    "FaultStatus",
    "FaultTold",
    "FleetClient",
    "FleetStatus",
    "Forecast",
    "IssuedKey",
    "JudgementsContradict",
    "MessagesHeard",
    "ModelChanges",
    "NamespaceStatus",
    "NodeAttribute",
    "NodeInfo",
    "NodeNotFound",
    "NotDone",
    "OfferedSkill",
    "OpenDecision",
    "PositionNodes",
    "Problem",
    "PubSubMessage",
    "RankedRobot",
    "RankingInfo",
    "Reading",
    "RobotClient",
    "RobotInfo",
    "RobotInvalid",
    "RobotNodes",
    "RobotStatus",
    "RobotSummary",
    "RunInfo",
    "RunStatus",
    "RunTold",
    "ScenarioClient",
    "ScenarioInfo",
    "ScenarioRefused",
    "SelectedNode",
    "ServerStatus",
    "SkillArgument",
    "SkillEvent",
    "SkillExecution",
    "SkillInfo",
    "SkillNodes",
    "SkillRequest",
    "StepTold",
    "SummariesChanged",
    "TeleoperationInfo",
    "TeleoperationStatus",
    "Told",
    "Trend",
    "ValueDetails",
    "WouldHappen",
    "bridge_nodes",
    "card_nodes",
    "charge_nodes",
    "default_identity_folder",
    "driving",
    "fleet_status",
    "issue_session_key",
    "known_places",
    "position_nodes",
    "ranking_of",
    "recent_messages",
    "revoke_session_key",
    "robot_nodes",
    "server_status",
    "teleoperation_info",
    "watch_teleoperation",
    "yaw_of",
]
